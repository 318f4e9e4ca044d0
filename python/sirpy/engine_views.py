"""What another engine needs to know of every sub-image: number, camera, depth range, sources.

Engines that number their images get the sub-images in the order of the workspace, from 0. Their pixel
centres lie at whole numbers, COLMAP's at .5: `intrinsics` and `img_from_world` are in theirs, half a
pixel less than ours. Depth is z in the camera frame. The principal point may lie outside the sub-image.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from sirpy.engine_options import CopyPolicy
from sirpy.errors import InputError
from sirpy.files import place
from sirpy.native_images import SubImage
from sirpy.native_scene import Floats, Indices, NativeCamera, NativeScene, read_native_scene
from sirpy.photographs import open_photograph
from sirpy.progress import Progress
from sirpy.rectangle import Rectangle
from sirpy.view_fields import MOST_OF_A_BLOCK, ViewField, source_scores, view_field
from sirpy.view_windows import SubImageViews, sub_image_views
from sirpy.workspace import Workspace

_FLOAT32_STEP = 2.0**-23  # relative
_TOLERATED_PIXELS = 0.1


@dataclass(frozen=True)
class EngineView:
    """A sub-image as a photograph of its own.

    `sources` are (number, score) of sub-images of other photographs that show the same surface, the
    best first; none, and depths of 0, where the photograph shares hardly a sparse point with others.
    """

    number: int
    camera: NativeCamera  # of the whole undistorted photograph
    sub_image: SubImage
    min_depth: float
    max_depth: float
    sources: tuple[tuple[int, float], ...]

    @cached_property
    def intrinsics(self) -> Floats:
        """(3, 3), in pixels of the sub-image, pixel centres at whole numbers."""
        return self.camera.window_intrinsics(self.sub_image.stored)

    @cached_property
    def img_from_world(self) -> Floats:
        """(3, 4): homogeneous pixels, centres at whole numbers, of homogeneous world points."""
        matrix: Floats = self.intrinsics @ self.camera.cam_from_world
        return matrix


def engine_views(
    workspace: Workspace,
    *,
    most_sources: int | None = None,
    only: Container[str] | None = None,
    scene: NativeScene | None = None,
    progress: Progress = Progress(),
) -> list[EngineView]:
    """The views of the sub-images of a workspace that was cut.

    Time is linear in the number of sub-images: only photographs that share points are compared.

    Args:
        most_sources: of a sub-image; None for all that a part of it can be seen in.
        only: names of the sub-images to describe; None for all. Numbers count all of them.
        scene: of the workspace, where it was read already.

    Raises:
        InputError: this is no workspace.
    """
    natives = workspace.natives
    if scene is None:
        scene = read_native_scene(workspace)
    parts: dict[str, _Parts] = {}
    first = 0
    for native in natives:
        parts[native.name] = _Parts(first, [sub.stored for sub in native.sub_images])
        first += len(native.sub_images)
    wanted = [
        (number, native, sub)
        for number, (native, sub) in enumerate(workspace.sub_images())
        if only is None or sub.name in only
    ]
    views: list[EngineView] = []
    field: ViewField | None = None
    with progress.stage("views", len(wanted), "sub-image") as steps:
        for number, native, sub in wanted:
            if field is None or field.name != native.name:
                field = view_field(scene, native.name, num_sources=MOST_OF_A_BLOCK)
            # Engines know of no other levels than that of the native pixels.
            found = sub_image_views(scene, field, sub, halo=0, coarsest=1)
            camera = scene.cameras[native.name]
            sources = _ranked_parts(scene, native.name, sub, found, parts)[:most_sources]
            depths = found.min_depth, found.max_depth
            views.append(EngineView(number, camera, sub, *depths, tuple(sources)))
            steps.advance()
    return views


def place_images(
    workspace: Workspace,
    views: Iterable[EngineView],
    path_of: Callable[[int], Path],
    policy: CopyPolicy,
    engine: str,
) -> None:
    """Gives every sub-image the path that an engine looks for by its number.

    Raises:
        InputError: a sub-image is no JPEG, which these engines ask for; nothing was written.
        OutputError: a file cannot be written.
    """
    views = list(views)
    for view in views:
        if Path(view.sub_image.name).suffix.lower() not in (".jpg", ".jpeg"):
            raise InputError(
                f"{engine} reads JPEG, and {workspace.image(view.sub_image)} is none: cut the "
                "photographs into JPEG (`colmap sir_undistorter` with this output type does, "
                "`sirpy cut` with --format jpg)"
            )
    for view in views:
        place(workspace.image(view.sub_image), path_of(view.number), policy)


def size_note(views: Iterable[EngineView], engine: str) -> str:
    """What to know before an engine that expects images of one size reads these; empty if they are."""
    sizes = {(view.sub_image.stored.width, view.sub_image.stored.height) for view in views}
    if len(sizes) == 1:
        return ""
    shown = ", ".join(f"{width}x{height}" for width, height in sorted(sizes)[:3])
    more = " ..." if len(sizes) > 3 else ""
    return (
        f"{engine} expects images of one size, and these have {len(sizes)} ({shown}{more}): cut "
        "photographs of one size with --same-size"
    )


def precision_note(views: Iterable[EngineView], engine: str) -> str:
    """What to know where the model's coordinates are too large for single precision; mostly empty."""
    for view in views:
        step = _FLOAT32_STEP * float(np.abs(view.camera.centre).max())
        pixel = view.min_depth / float(view.camera.intrinsics[0, 0])
        if 0 < _TOLERATED_PIXELS * pixel < step:
            return (
                f"{engine} holds cameras as 32-bit numbers, steps of {step:.2g} at the coordinates "
                f"of this model, where a pixel is {pixel:.2g}: shift the model to its origin first"
            )
    return ""


def grey_note(workspace: Workspace, views: Iterable[EngineView], engine: str) -> str:
    """What to know before an engine that takes only RGB reads these; empty if they are."""
    images = (workspace.image(view.sub_image) for view in views)
    grey = next((path for path in images if open_photograph(path).channels == 1), None)
    if grey is None:
        return ""
    return f"{grey.name} is grey, and {engine} reads RGB: make the photographs RGB first"


class _Parts:
    """The sub-images of a photograph: number of the first, stored rectangles as corners (n, 4)."""

    def __init__(self, first: int, stored: list[Rectangle]) -> None:
        self.first = first
        self.corners: Indices = np.array(
            [(one.x0, one.y0, one.x1, one.y1) for one in stored], np.int64
        ).reshape(-1, 4)

    def shares(self, window: Rectangle) -> Iterable[tuple[int, float]]:
        """(number, share of the window's area) of the sub-images that hold a part of it."""
        low = np.maximum(self.corners[:, :2], [window.x0, window.y0])
        high = np.minimum(self.corners[:, 2:], [window.x1, window.y1])
        share = np.clip(high - low, 0, None).prod(axis=1) / window.area
        return [(self.first + int(i), float(share[i])) for i in np.flatnonzero(share)]


def _ranked_parts(
    scene: NativeScene,
    native: str,
    sub: SubImage,
    found: SubImageViews,
    parts: dict[str, _Parts],
) -> list[tuple[int, float]]:
    """Sub-images by the score of their photograph and their share of what it shows of `sub`."""
    if not found.sources:
        return []
    scores = source_scores(scene, native, sub.core)
    ranked = [
        (number, scores.get(source.name, 0.0) * share)
        for source in found.sources
        if source.name in parts
        for number, share in parts[source.name].shares(source.window)
    ]
    return sorted(ranked, key=lambda one: (-one[1], one[0]))
