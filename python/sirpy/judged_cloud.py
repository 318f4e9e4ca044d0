"""The cloud that is judged: its points in the frame of the model, and the photographs that it was made of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sirpy.colmap_dense import ColmapDense, open_workspace
from sirpy.coloured_points import Colours, Floats, read_coloured
from sirpy.common_ground import Observer, observers_of_model, observers_of_workspace
from sirpy.errors import InputError
from sirpy.frame import Frame
from sirpy.georeference import read_frame
from sirpy.model_arrays import SparseModel
from sirpy.posed_camera import PosedCamera
from sirpy.workspace import Workspace

_LEVELS_ABOVE = 2  # a workspace is above its own files, OUT/fused.laz and OUT/tiles/NAME.laz
_SAME_PLACE = 1e-3  # of the extent of the cameras


@dataclass(frozen=True)
class JudgedCloud:
    """A cloud in a file; `workspace` that made it, None where nothing tells."""

    path: Path
    workspace: Workspace | None
    frame: Frame  # of the file

    def points(self) -> Iterator[tuple[Floats, Colours]]:
        """Points (n, 3) in the frame of the model and RGB (n, 3), some at a time; raises InputError."""
        for places, colours in read_coloured(self.path):
            yield (places if self.frame.is_model else self.frame.model(places)), colours


def open_judged(path: Path) -> JudgedCloud:
    """The cloud of a workspace (its folder), or any file of points.

    Files that a workspace made of its cloud are in its own frame, all others in that of the model.

    Raises:
        InputError: there is no such file, or no cloud in the folder.
    """
    if path.is_dir():
        workspace = open_workspace(path)
        if not workspace.fused.is_file():
            raise InputError(
                f"there is no cloud in {path}: give the folder of a finished reconstruction, or a PLY or "
                "LAZ file"
            )
        return JudgedCloud(workspace.fused, workspace if _is_known(workspace) else None, Frame())
    if not path.is_file():
        raise InputError(f"there is no point cloud {path}: give a PLY or LAZ file, or a workspace")
    for folder in path.absolute().parents[:_LEVELS_ABOVE]:
        workspace = open_workspace(folder)
        if _is_known(workspace):
            is_fused = path.resolve() == workspace.fused.resolve()
            return JudgedCloud(path, workspace, Frame() if is_fused else read_frame(workspace))
    return JudgedCloud(path, None, Frame())


def _is_known(workspace: Workspace) -> bool:
    return workspace.index.is_file() or isinstance(workspace, ColmapDense)


def observers_within(
    workspace: Workspace | None, model: SparseModel, path: Path, held_out: set[str]
) -> list[Observer]:
    """The photographs that a cloud can be made of: those of `workspace`, else those of the model at `path`
    that are not held out.

    Raises:
        InputError: the workspace was not made of this model's cameras, or its model is damaged.
    """
    if workspace is None:
        return [one for one in observers_of_model(model) if one.view.name not in held_out]
    observers = observers_of_workspace(workspace)
    solved = {image.name: PosedCamera.of(model, image).centre for image in model.images}
    extent = np.linalg.norm(np.ptp(np.array([*solved.values()]), axis=0))
    away = [
        one.view.name
        for one in observers
        if one.view.name not in solved
        or np.linalg.norm(one.view.centre - solved[one.view.name]) > _SAME_PLACE * extent
    ]
    if away:
        raise InputError(
            f"{workspace.folder} was made with other cameras than those of {path} ({away[0]} and "
            f"{len(away) - 1} more differ): give the model that its photographs were held out of"
        )
    return observers
