"""Which part of a photograph the photographs that a cloud was made of see too: only there it can be judged.

The ground is the plane that most of the photograph's sparse points follow; what hides what is not asked. It
depends on the cameras and on the region that was reconstructed, not on the points of the cloud.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sirpy.errors import InputError
from sirpy.ground import find_ground
from sirpy.model_arrays import SparseModel, read_arrays
from sirpy.native_scene import Observations
from sirpy.posed_camera import Floats, PosedCamera
from sirpy.rectangle import Rectangle
from sirpy.workspace import Workspace

_CELL = 16  # native pixels along the side of a cell, which is seen or not as its centre is
_FEWEST_POINTS = 3  # of a plane


@dataclass(frozen=True)
class Observer:
    """A photograph that took part in a reconstruction, and the rectangles of it that did, in pixels of `view`;
    None for all of it."""

    view: PosedCamera
    parts: tuple[Rectangle, ...] | None = None

    def sees(self, world: Floats) -> npt.NDArray[np.bool_]:
        """Which of the points (n, 3) fall into the parts, (n,)."""
        found, pixels = self.view.sees(world)
        seen = np.zeros(len(world), bool)
        if self.parts is None:
            seen[found] = True
        for part in self.parts or ():
            low, high = (part.x0, part.y0), (part.x1, part.y1)
            seen[found[((pixels >= low) & (pixels < high)).all(axis=1)]] = True
        return seen


def observers_of_model(model: SparseModel) -> list[Observer]:
    return [Observer(PosedCamera.of(model, image)) for image in model.images]


def observers_of_workspace(workspace: Workspace) -> list[Observer]:
    """The undistorted photographs of a workspace, as far as its sub-images go.

    Raises:
        InputError: its model is missing or damaged.
    """
    parts = {one.name: tuple(sub.core for sub in one.sub_images) for one in workspace.natives}
    model = read_arrays(workspace.native_model)
    return [
        Observer(PosedCamera.of(model, image), parts[image.name])
        for image in model.images
        if image.name in parts
    ]


@dataclass(frozen=True)
class CommonGround:
    """Of the cells of a photograph of `width` x `height` pixels, 16 x 16 each, which are seen by enough others:
    (rows, columns)."""

    cells: npt.NDArray[np.bool_]
    width: int
    height: int

    def window(self, shrink: int, margin: int) -> Rectangle:
        """The pixels of the photograph, shrunk by a factor, that the cells and a margin around them touch."""
        whole = Rectangle(0, 0, self.width // shrink, self.height // shrink)
        rows, columns = (np.flatnonzero(self.cells.any(axis=axis)) for axis in (1, 0))
        if len(rows) == 0:
            return Rectangle(0, 0, 0, 0)
        x0, y0 = columns[0] * _CELL // shrink, rows[0] * _CELL // shrink
        x1, y1 = (-(-(last + 1) * _CELL // shrink) for last in (columns[-1], rows[-1]))
        seen = Rectangle.from_corners(int(x0), int(y0), int(x1), int(y1))
        return seen.padded(margin).intersection(whole)

    def at(self, window: Rectangle, shrink: int) -> npt.NDArray[np.bool_]:
        """Which pixels of a window of the shrunk photograph lie in the cells, (height, width)."""
        row, column = (
            ((np.arange(begin, end) + 0.5) * shrink / _CELL).astype(int)
            for begin, end in ((window.y0, window.y1), (window.x0, window.x1))
        )
        inside: npt.NDArray[np.bool_] = self.cells[np.ix_(row, column)]
        return inside


def common_ground(
    view: PosedCamera, points: Floats, observers: Iterable[Observer], min_views: int
) -> CommonGround:
    """What at least `min_views` of the observers, but for `view` itself, see of the ground of a photograph.

    Args:
        points: (n, 3), the sparse points that the photograph sees, world.

    Raises:
        InputError: they are too few to tell where the ground is.
    """
    x, y, z = view.in_camera(points).T
    front = z > 0
    rays, depth = np.column_stack([x[front] / z[front], y[front] / z[front]]), z[front]
    if len(depth) < _FEWEST_POINTS:
        raise InputError(
            f"{view.name} sees {len(depth)} sparse points of the model, which do not tell where its ground "
            "is: hold out another photograph"
        )
    ground = find_ground(Observations(np.arange(len(depth)), rays, depth))
    rows, columns = (-(-side // _CELL) for side in (view.camera.height, view.camera.width))
    places = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    centres = np.minimum((places + 0.5) * _CELL, [view.camera.width, view.camera.height])
    cell_rays = view.rays(centres)
    known = np.flatnonzero(np.isfinite(cell_rays).all(axis=1))
    world = view.world(cell_rays[known], 1 / ground.inverse_depth(cell_rays[known]))
    count = np.zeros(len(places), np.int64)
    for observer in observers:
        if observer.view.name != view.name:
            count[known] += observer.sees(world)
    cells = (count >= min_views).reshape(rows, columns)
    return CommonGround(cells, view.camera.width, view.camera.height)
