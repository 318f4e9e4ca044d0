"""View windows: what of each source can be needed to match a window of a reference image.

The frustums of the window's parts, each between the depths of its block of the field (see `sirpy.view_fields`), are
projected into the source; so no match is lost at a border of the grid. Rectangles are in native pixels.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from sirpy.errors import InputError
from sirpy.native_images import SubImage
from sirpy.native_scene import NativeCamera, NativeScene
from sirpy.rectangle import Rectangle
from sirpy.view_fields import ViewField, frustum_corners, projected_boxes, view_field

# Pixels of a level: the largest reach of a patch in a source (kMaxReach in ncc.h), and interpolation.
PATCH_REACH = 18
HALO = 16  # pixels of each level that are estimated around a sub-image: the default
_MOST_WIDTH = 1 << 15  # pixels of a source window, as it is read (kMostSourceWidth)

_MOST_COARSE_PIXELS = 2_000_000  # of a whole photograph at the coarsest level
LEAST_COARSEST = 2
MOST_LEVEL = 7  # whose pixels are whole parts of a block (`view_fields`)
_LEAST_SHOWN = 24  # pixels of the shorter side of a photograph: less shows nothing to match


@dataclass(frozen=True)
class Source:
    """A native image to match against, and the rectangle of it (native pixels) that can be needed."""

    name: str
    window: Rectangle


@dataclass(frozen=True)
class SubImageViews:
    """The problem of one reference sub-image; no sources where too few sparse points are seen."""

    name: str
    window: Rectangle  # of the reference: what it stores and the halo, native pixels
    min_depth: (
        float  # z in the reference camera, world units, of all blocks that the window touches
    )
    max_depth: float
    sources: tuple[Source, ...]  # those that any of the blocks allows, in the order of the table


class ViewSelection:
    """The views of any sub-images of a scene; what does not depend on the grid is found once.

    Args:
        covered: by name what the sub-images of each native image hold of it; the others are no
            sources.
        num_sources: native images that each place is matched against, at most.
        halo: pixels of each level that are estimated around a sub-image.
    """

    def __init__(
        self, scene: NativeScene, covered: Mapping[str, Rectangle], num_sources: int, halo: int
    ) -> None:
        self.scene = scene
        self.coarsest = coarsest_level(scene.cameras[name] for name in covered)
        self.num_sources = num_sources
        self._covered, self._halo = covered, halo
        self._fields: dict[str, ViewField] = {}

    def field(self, name: str) -> ViewField:
        """Of a native image."""
        if name not in self._fields:
            self._fields[name] = view_field(
                self.scene, name, num_sources=self.num_sources, cut=self._covered
            )
        return self._fields[name]

    def sub_image(self, name: str, sub_image: SubImage) -> SubImageViews:
        """Of a sub-image of a native image.

        Raises:
            InputError: the window of a source is wider than stereo can address.
        """
        field = self.field(name)
        views = sub_image_views(
            self.scene,
            field,
            sub_image,
            halo=self._halo,
            coarsest=self.coarsest,
            covered=self._covered,
        )
        levels = {source.name: source.level for source in field.sources}
        for source in views.sources:
            if source.window.width >> levels[source.name] >= _MOST_WIDTH:
                raise InputError(
                    f"a sub-image of {name} needs {source.window.width} pixels of each row of "
                    f"{source.name}, and stereo can address {_MOST_WIDTH - 1}: cut more columns "
                    "(--columns)"
                )
        return views

    def pixels(self, name: str, sub_image: SubImage | None, least_halo: int = 0) -> tuple[int, int]:
        """Pixels that stereo estimates at once, with the halo, and those of all windows of their sources.

        Of a sub-image at the native level, or of all that is cut of a native image at the coarsest
        level; each pixel is one of the level at which it is read.
        """
        field, window = self.field(name), self._covered[name]
        level, halo = self.coarsest, max(self._halo, least_halo)
        if sub_image is not None:
            window, level = sub_image.stored.padded(halo).intersection(window), 0
        windows = source_windows(self.scene, field, window, level=level, covered=self._covered)
        sources = [
            found.area >> 2 * (level + field.sources[index].level)
            for index, found in windows.items()
        ]
        return window.area >> 2 * level, sum(sources)


def coarsest_level(cameras: Iterable[NativeCamera]) -> int:
    """The finest level of passes over whole photographs: 2 at least, and the largest has 2 megapixels there
    at most."""
    largest = max(camera.width * camera.height for camera in cameras)
    level = LEAST_COARSEST
    while largest > _MOST_COARSE_PIXELS * 4**level:
        level += 1
    return level


def top_level(sizes: Iterable[tuple[int, int]], coarsest: int) -> int:
    """The coarsest level at which the smallest photograph (width, height) still shows something, `coarsest` at
    least."""
    shortest = min(min(size) for size in sizes)
    level = coarsest
    while level < MOST_LEVEL and shortest >> (level + 1) >= _LEAST_SHOWN:
        level += 1
    return level


def aligned(window: Rectangle, image: Rectangle, step: int) -> Rectangle:
    """The smallest window around `window` that starts and ends on multiples of `step` pixels, cut to
    the image, whose end may be the window's; it may be empty."""
    inside = window.intersection(image)
    return inside.aligned(step).intersection(image) if inside.area else inside


def source_windows(
    scene: NativeScene,
    field: ViewField,
    window: Rectangle,
    *,
    level: int,
    covered: Mapping[str, Rectangle] | None = None,
) -> dict[int, Rectangle]:
    """What can be needed of each source to match a window of the reference, at a level and the finer ones.

    A source is read `field.sources[i].level` levels coarser than the reference, and its window starts and
    ends on whole pixels of that level (or at the end of the image). It holds what each part of the
    reference window, one for each block, projects to between the depths of its block, with the reach
    of a patch; where that lies behind the source in part, it is all that there is.

    Args:
        field: of the reference.
        window: of the reference, inside the image (native pixels): of a sub-image with its halo, or
            the whole photograph.
        level: the coarsest pyramid level of the pass, 0 for native pixels.
        covered: what the sub-images of each native image hold of it; all of it if None.

    Returns:
        Windows by index in `field.sources`, native pixels; of those sources alone that a block of the
        window allows and that hold something of it.
    """
    blocks = field.blocks(window)
    allowed = field.allowed[blocks].ravel()
    depths = np.column_stack([field.min_depth[blocks].ravel(), field.max_depth[blocks].ravel()])
    corners = frustum_corners(scene.cameras[field.name], field.parts(window), depths)
    windows: dict[int, Rectangle] = {}
    for index, source in enumerate(field.sources):
        matched = allowed >> np.uint32(index) & 1 == 1
        if not matched.any():
            continue
        camera = scene.cameras[source.name]
        boxes = projected_boxes(camera, corners[matched])
        low, high = np.floor(boxes[:, :2].min(axis=0)), np.ceil(boxes[:, 2:].max(axis=0))
        box = Rectangle.from_corners(int(low[0]), int(low[1]), int(high[0]), int(high[1]))
        step = 1 << (level + source.level)
        whole = Rectangle(0, 0, camera.width, camera.height)
        if covered is not None:
            whole = aligned(covered[source.name], whole, step)
        found = aligned(box.padded(PATCH_REACH * step), whole, step)
        if found.area:
            windows[index] = found
    return windows


def sub_image_views(
    scene: NativeScene,
    field: ViewField,
    sub_image: SubImage,
    *,
    halo: int,
    coarsest: int,
    covered: Mapping[str, Rectangle] | None = None,
) -> SubImageViews:
    """Windows, sources and depth range of one sub-image.

    Args:
        field: of the native image.
        coarsest: the level of the pass over whole photographs; sub-images are worked on from the
            level below it.
        covered: what the sub-images of each native image hold of it; all of it if None.
    """
    camera = scene.cameras[field.name]
    # Whole pixels of the coarsest level: what the pass over whole photographs found is cut out as it is.
    step = 1 << coarsest
    whole = Rectangle(0, 0, camera.width, camera.height)
    if covered is not None:
        whole = aligned(covered[field.name], whole, step)
    window = aligned(sub_image.stored.padded(halo), whole, step)
    windows = source_windows(scene, field, window, level=coarsest - 1, covered=covered)
    blocks = field.blocks(window)
    return SubImageViews(
        sub_image.name,
        window,
        float(field.min_depth[blocks].min()),
        float(field.max_depth[blocks].max()),
        tuple(Source(field.sources[index].name, found) for index, found in windows.items()),
    )
