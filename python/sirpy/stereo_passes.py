"""The passes of stereo: coarse to native, and the units and maps of each.

Level l has pixels of 2^l native ones, counted from the corner of the native image; rectangles here are in pixels of
their level. The coarsest level is worked on by whole photographs, the finer ones by sub-images. Every pass writes
what it finds, so the next one, of any unit, can start from it: the reach of a pass does not add to that of others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sirpy import _core
from sirpy.native_images import NativeImage, SubImage
from sirpy.npy import open_npy, write_npy
from sirpy.rectangle import Rectangle
from sirpy.windows import read_window
from sirpy.workspace import Pass, Workspace

_PLANES = {"depth": slice(0, 1), "normal": slice(1, 4), "views": slice(4, 5)}
_BAND_PIXELS = 8_000_000  # native ones, read at once to be shrunk


@dataclass(frozen=True)
class StereoPass:
    """One pass over all photographs at one level."""

    level: int
    kind: Pass
    iterations: int  # sweeps
    offers: int = 8  # planes of neighbours that a pixel tries
    largest_step: float = 2.0  # pixels of motion in the sources, of the first refinement
    complete: bool = False  # weak texture takes the planes around it; of whole photographs only

    @property
    def name(self) -> str:
        return f"level{self.level}.{self.kind}"

    @property
    def title(self) -> str:
        return f"stereo, 1/{1 << self.level}, {self.kind}" if self.level else f"stereo, {self.kind}"

    @property
    def is_last(self) -> bool:
        return self.level == 0 and self.kind == "geometric"

    @property
    def margin(self) -> int:
        """Pixels of the level around a pixel that its result depends on."""
        return int(_core.patch_match_margin(self.iterations))


@dataclass(frozen=True)
class Unit:
    """What a pass estimates at once: pixels of one native image that it keeps, in pixels of the level."""

    native: NativeImage
    sub_image: SubImage | None  # None: the whole photograph
    kept: Rectangle

    @property
    def name(self) -> str:
        return self.sub_image.name if self.sub_image else self.native.name


def at_level(rectangle: Rectangle, level: int) -> Rectangle:
    """The pixels of a level whose first native pixel is inside: rectangles that tile an image tile its
    levels."""
    step = 1 << level
    return Rectangle.from_corners(
        -(-rectangle.x0 // step),
        -(-rectangle.y0 // step),
        -(-rectangle.x1 // step),
        -(-rectangle.y1 // step),
    )


def native_pixels(rectangle: Rectangle, level: int, image: Rectangle) -> Rectangle:
    """The native pixels of a rectangle of a level."""
    x0, y0, width, height = (value << level for value in rectangle.as_tuple())
    return Rectangle(x0, y0, width, height).intersection(image)


def units(natives: tuple[NativeImage, ...], level: int, coarsest: int) -> Iterator[Unit]:
    """Whole photographs (what is cut of them) at the coarsest level, otherwise the cores of the
    sub-images; those without a pixel of the level are none."""
    for native in natives:
        whole = level == coarsest
        for sub in (None,) if whole else native.sub_images:
            kept = at_level(sub.core if sub else native.covered, level)
            if kept.area:  # what is narrower than a pixel of the level may own none
                yield Unit(native, sub, kept)


def read_grey(
    workspace: Workspace, native: NativeImage, rectangle: Rectangle, level: int
) -> npt.NDArray[np.uint8]:
    """The grey levels of a rectangle of a level, (height, width): means of blocks of native pixels."""
    if level == 0:
        return read_window(workspace, native.name, rectangle)
    grey = np.empty((rectangle.height, rectangle.width), np.uint8)
    rows = max(1, _BAND_PIXELS >> 2 * level) // rectangle.width + 1
    for y in range(0, rectangle.height, rows):
        band = Rectangle(
            rectangle.x0, rectangle.y0 + y, rectangle.width, min(rows, rectangle.height - y)
        )
        pixels = read_window(workspace, native.name, native_pixels(band, level, native.rectangle))
        grey[y : y + band.height] = _core.shrunk(pixels, 1 << level)
    return grey


def nothing_found(window: Rectangle) -> dict[str, npt.NDArray[Any]]:
    """What is found in a photograph without any source."""
    shape = window.height, window.width
    kinds = {"depth": np.float32, "views": np.uint32, "cost": np.float32, "texture": np.float32}
    found: dict[str, npt.NDArray[Any]] = {
        name: np.zeros(shape, kind) for name, kind in kinds.items()
    }
    found["normal"] = np.zeros((3, *shape), np.float32)
    found["num_seeing"] = found["num_consistent"] = np.zeros(shape, np.uint8)
    return found


def write_planes(path: Path, found: dict[str, npt.NDArray[Any]], kept: tuple[slice, slice]) -> None:
    """Writes what the next pass starts from of the rows and columns `kept`, whole or not at all."""
    bits = found["views"].view(np.float32)
    parts = found["depth"][None], found["normal"], bits[None]
    write_npy(path, np.concatenate([part[(slice(None), *kept)] for part in parts]))


class PassMaps:
    """The maps that a pass has written, read in any rectangle of its level."""

    def __init__(self, workspace: Workspace, of_pass: StereoPass, coarsest: int) -> None:
        self.level = of_pass.level
        self._workspace, self._pass = workspace, of_pass
        self._units: dict[str, list[Unit]] = {one.name: [] for one in workspace.natives}
        for unit in units(workspace.natives, of_pass.level, coarsest):
            self._units[unit.native.name].append(unit)
        self._extent = {one.name: at_level(one.covered, self.level) for one in workspace.natives}

    def read(
        self, native: str, rectangle: Rectangle, kind: Literal["depth", "normal", "views"]
    ) -> npt.NDArray[Any]:
        """Depth (height, width), normals (3, height, width) or sources as words of bits, uint32.

        0 where nothing was estimated.

        Raises:
            InputError: a file is missing or damaged.
        """
        planes = _PLANES[kind]
        count = planes.stop - planes.start
        window = np.zeros((count, rectangle.height, rectangle.width), np.float32)
        for unit in self._units[native]:
            part = unit.kept.intersection(rectangle)
            if part.area:
                found = self._open(unit)[planes]
                window[(slice(None), *part.slices_in(rectangle))] = found[
                    (slice(None), *part.slices_in(unit.kept))
                ]
        if kind == "views":
            window = window.view(np.uint32)
        return window if kind == "normal" else window[0]

    def read_coarser(
        self, native: NativeImage, rectangle: Rectangle, levels: int
    ) -> npt.NDArray[np.float32]:
        """Depths of a rectangle of a level that is coarser by `levels`: those next to the centres."""
        if levels == 0:
            return self.read(native.name, rectangle, "depth")
        image = at_level(native.rectangle, self.level)
        fine = native_pixels(rectangle, levels, image)
        depth = self.read(native.name, fine, "depth")
        half = 1 << (levels - 1)
        rows = np.minimum((np.arange(rectangle.height) << levels) + half, fine.height - 1)
        columns = np.minimum((np.arange(rectangle.width) << levels) + half, fine.width - 1)
        return np.ascontiguousarray(depth[np.ix_(rows, columns)])

    def start(self, native: str, rectangle: Rectangle, level: int) -> _core.StartMaps | None:
        """What a pass over a rectangle of a level starts from; the maps are of that level or one coarser.

        None where the pass before had no pixel of the native image.
        """
        image = self._extent[native]
        if not image.area:
            return None
        if self.level > level:  # the four nearest of each pixel
            x0, y0 = rectangle.x0 // 2, rectangle.y0 // 2
            x1, y1 = (rectangle.x1 + 1) // 2, (rectangle.y1 + 1) // 2
            rectangle = Rectangle.from_corners(x0, y0, x1, y1).padded(1).intersection(image)
        return _core.StartMaps(
            level=self.level,
            x0=rectangle.x0,
            y0=rectangle.y0,
            depth=self.read(native, rectangle, "depth"),
            normal=self.read(native, rectangle, "normal"),
            views=self.read(native, rectangle, "views"),
        )

    def _open(self, unit: Unit) -> npt.NDArray[np.float32]:
        path = self._workspace.pass_map(unit.name, self._pass.name)
        shape = 5, unit.kept.height, unit.kept.width
        return open_npy(path, np.float32, shape, "the stereo")
