"""The sparse scene of a workspace as arrays: whole undistorted cameras, sparse points, who sees what where."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sirpy.model_arrays import SparseModel, read_arrays
from sirpy.rectangle import Rectangle
from sirpy.workspace import Workspace

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class NativeCamera:
    """A whole undistorted native image. Pixel centres at .5 (COLMAP); depth is z in the camera frame."""

    name: str
    width: int
    height: int
    intrinsics: Floats  # (3, 3), pixels
    cam_from_world: Floats  # (3, 4)

    @cached_property
    def centre(self) -> Floats:
        """Projection centre in the world, (3,)."""
        return -self.cam_from_world[:, :3].T @ self.cam_from_world[:, 3]

    def window_intrinsics(self, window: Rectangle, level: int = 0) -> Floats:
        """(3, 3) of a window as an image of its own, pixel centres at whole numbers: half a pixel less than
        ours. The window is in pixels of the level, 2^level native ones each."""
        matrix = self.intrinsics.copy()
        matrix[:2] /= 1 << level
        matrix[:2, 2] -= [window.x0 + 0.5, window.y0 + 0.5]
        return matrix

    def in_camera(self, world: Floats) -> Floats:
        """World points (n, 3) in the camera frame, (n, 3)."""
        in_camera: Floats = world @ self.cam_from_world[:, :3].T + self.cam_from_world[:, 3]
        return in_camera

    def project(self, world: Floats) -> Floats:
        """Pixels (n, 2) of world points (n, 3) that lie in front of the camera."""
        homogeneous = self.in_camera(world) @ self.intrinsics.T
        pixels: Floats = homogeneous[:, :2] / homogeneous[:, 2:]
        return pixels

    def sees(self, world: Floats) -> npt.NDArray[np.bool_]:
        """Which of world points (n, 3) fall into the image, (n,)."""
        sees: npt.NDArray[np.bool_] = self.in_camera(world)[:, 2] > 0
        x, y = self.project(world[sees]).T
        sees[sees] = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        return sees

    def world(self, pixels: Floats, depth: Floats) -> Floats:
        """World points (n, 3) of pixels (n, 2) at depths (n,)."""
        rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(self.intrinsics).T
        in_camera = rays * depth[:, None]
        world: Floats = (in_camera - self.cam_from_world[:, 3]) @ self.cam_from_world[:, :3]
        return world


@dataclass(frozen=True)
class Observations:
    """The sparse points that one native image sees."""

    point: Indices  # (n,) index into NativeScene.points
    pixel: Floats  # (n, 2) native pixels
    depth: Floats  # (n,)


@dataclass(frozen=True)
class NativeScene:
    """Cameras by name, in order of their names; sparse points (p, 3); observations by camera name."""

    cameras: dict[str, NativeCamera]
    points: Floats
    observations: dict[str, Observations]

    @cached_property
    def observers(self) -> tuple[Indices, Indices]:
        """Who sees each point: (start (p + 1,), camera (m,)); camera[start[i]:start[i + 1]] see point i."""
        names = list(self.cameras)
        point = np.concatenate([self.observations[name].point for name in names])
        camera = np.repeat(np.arange(len(names)), [len(self.observations[n].point) for n in names])
        order = np.argsort(point, kind="stable")
        start = np.zeros(len(self.points) + 1, dtype=np.int64)
        np.cumsum(np.bincount(point, minlength=len(self.points)), out=start[1:])
        return start, camera[order]


def read_native_scene(workspace: Workspace) -> NativeScene:
    """The scene of the workspace's native model.

    Raises:
        InputError: the model is missing or damaged.
    """
    return native_scene(read_arrays(workspace.native_model))


def native_scene(model: SparseModel) -> NativeScene:
    """The scene of a model of whole undistorted images; observations behind their camera are left out."""
    cameras: dict[str, NativeCamera] = {}
    observations: dict[str, Observations] = {}
    for index, image in sorted(enumerate(model.images), key=lambda item: item[1].name):
        camera = model.camera_of(image)
        native = NativeCamera(
            image.name,
            camera.width,
            camera.height,
            np.asarray(camera.calibration_matrix(), dtype=np.float64),
            image.cam_from_world,
        )
        seen = model.seen(index)
        point, pixel = model.point[seen].astype(np.int64), model.xy[seen]
        depth = native.in_camera(model.points[point])[:, 2]
        front = depth > 0
        cameras[native.name] = native
        observations[native.name] = Observations(point[front], pixel[front], depth[front])
    return NativeScene(cameras, model.points, observations)
