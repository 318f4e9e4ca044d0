"""The input folder of MVSNet and its relatives, PatchmatchNet first among them.

images/00000000.jpg, cams/00000000_cam.txt (extrinsic 4x4 cam_from_world, intrinsic 3x3, depths) and
pair.txt (sources of each, the best first). Pixel centres lie at whole numbers, as PatchmatchNet and the
networks on PyTorch have them; COLMAP's principal point is half a pixel more. What the second number of
the line of depths means differs among the readers, so it is the caller's choice (`MvsnetDepths`).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sirpy.engine_options import CopyPolicy, MvsnetDepths
from sirpy.engine_views import (
    EngineView,
    engine_views,
    grey_note,
    place_images,
    precision_note,
    size_note,
)
from sirpy.files import write_text
from sirpy.native_scene import Floats
from sirpy.progress import Progress
from sirpy.workspace import Workspace

SIZE_MULTIPLE = 32  # pixels: what these networks would otherwise resample or crop the images to

_ENGINE = "MVSNet"
_DEPTH_PLANES = 192  # MVSNet's default


def write_mvsnet(
    workspace: Workspace,
    *,
    most_sources: int = 20,
    depths: MvsnetDepths = "range",
    copy_policy: CopyPolicy = "hard-link",
    progress: Progress = Progress(),
) -> None:
    """Writes cams/, pair.txt and the numbered images into a workspace that was cut.

    Args:
        most_sources: sub-images listed for each, at most.
        depths: what the line of depths holds.
        copy_policy: how the images get their numbers.

    Raises:
        InputError: this is no workspace, or its sub-images are no JPEGs.
        OutputError: the folder cannot be written.
    """
    views = engine_views(workspace, most_sources=most_sources, progress=progress)
    place_images(workspace, views, workspace.mvsnet_image, copy_policy, _ENGINE)
    for view in views:
        write_text(workspace.mvsnet_camera(view.number), _camera(view, depths))
    write_text(workspace.mvsnet_pairs, _pairs(views))
    notes = (
        size_note(views, _ENGINE),
        _multiple_note(views),
        precision_note(views, _ENGINE),
        grey_note(workspace, views, _ENGINE),
    )
    for note in notes:
        if note:
            progress.note(note)


def _multiple_note(views: Iterable[EngineView]) -> str:
    """What to know where the networks would resample or crop the images; empty if they do not."""
    for view in views:
        width, height = view.sub_image.stored.width, view.sub_image.stored.height
        if width % SIZE_MULTIPLE or height % SIZE_MULTIPLE:
            return (
                f"{_ENGINE} and its relatives resize or crop images whose sides are no multiple of "
                f"{SIZE_MULTIPLE} pixels, and {view.sub_image.name} has {width}x{height}: cut with "
                f"--same-size {SIZE_MULTIPLE}, and into more columns and rows where a photograph "
                "is not cut along a side"
            )
    return ""


def _camera(view: EngineView, depths: MvsnetDepths) -> str:
    cam_from_world = np.vstack([view.camera.cam_from_world, [0.0, 0.0, 0.0, 1.0]])
    numbers = [view.min_depth, view.max_depth]
    if depths == "interval":
        interval = (view.max_depth - view.min_depth) / (_DEPTH_PLANES - 1)
        numbers = [view.min_depth, interval, _DEPTH_PLANES, view.max_depth]
    lines = ["extrinsic", *_rows(cam_from_world), "", "intrinsic", *_rows(view.intrinsics), ""]
    return "\n".join([*lines, " ".join(map(repr, numbers)), ""])


def _rows(matrix: Floats) -> list[str]:
    return [" ".join(map(repr, row)) for row in matrix.tolist()]


def _pairs(views: Iterable[EngineView]) -> str:
    """A view without sources keeps its two lines: readers pass over it."""
    views = list(views)
    lines = [str(len(views))]
    for view in views:
        sources = [f"{number} {score:.6g}" for number, score in view.sources]
        lines += [str(view.number), " ".join([str(len(sources)), *sources])]
    return "\n".join(lines) + "\n"
