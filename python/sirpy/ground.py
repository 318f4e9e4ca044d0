"""The ground where a photograph sees none of the sparse points.

At the rim of a survey only views of other directions meet, whose features do not match. Stereo finds the ground
there all the same, if it is told where to look for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sirpy.native_scene import Floats, Indices, NativeCamera, NativeScene, Observations
from sirpy.rectangle import Rectangle

_PERCENTILES = (1.0, 99.0)  # of what stands out
_MOST_BEYOND = 2.0  # times nearer or farther than all points
_FOLLOWS = 4.0  # medians from the plane
_SAMPLES = 8  # along each side of a block

POINTS_OF_A_BLOCK = _SAMPLES**2


@dataclass(frozen=True)
class Ground:
    """A plane, on which inverse depth is linear in the pixel.

    Attributes:
        plane: (3,), inverse depth at pixel (0, 0) and its change by x and by y.
        out: least and greatest inverse depth over that of the plane, of what stands on it.
        limits: inverse depths between which the plane means anything.
    """

    plane: Floats
    out: tuple[float, float]
    limits: tuple[float, float]

    def inverse_depth(self, pixel: Floats) -> Floats:
        """(n,) of pixels (n, 2)."""
        inverse: Floats = np.clip(self.plane[0] + pixel @ self.plane[1:], *self.limits)
        return inverse

    def range_of(self, block: Rectangle) -> tuple[float, float]:
        """Least and greatest inverse depth of what stands in a block."""
        corners = [(x, y) for x in (block.x0, block.x1) for y in (block.y0, block.y1)]
        inverse = self.inverse_depth(np.array(corners, np.float64))
        low, high = np.clip(
            [inverse.min() + self.out[0], inverse.max() + self.out[1]], *self.limits
        )
        return float(low), float(high)


def find_ground(seen: Observations) -> Ground:
    """The plane that most of the points that a photograph sees follow."""
    inverse = 1 / seen.depth
    design = np.column_stack([np.ones(len(inverse)), seen.pixel])
    follows = np.ones(len(inverse), bool)
    plane = np.zeros(3)
    for _ in range(5):
        plane = np.linalg.lstsq(design[follows], inverse[follows], rcond=None)[0]
        off = np.abs(inverse - design @ plane)
        follows = off <= _FOLLOWS * np.median(off) + 1e-9 * inverse.max()
    limits = (float(inverse.min() / _MOST_BEYOND), float(inverse.max() * _MOST_BEYOND))
    low, high = np.percentile(inverse - design @ plane, _PERCENTILES)
    return Ground(plane, (float(low), float(high)), limits)


def ground_points(
    scene: NativeScene, name: str, ground: Ground, blocks: list[Rectangle], within: Floats
) -> tuple[Floats, Indices, Indices]:
    """Points of the ground in blocks of a native image, POINTS_OF_A_BLOCK in each, and who would see them: world
    (p, 3), and pairs (point, index of a camera), those of a point together.

    Photographs that see no sparse point at all are not asked: nothing tells where they are.

    Args:
        within: (blocks, 2), least and greatest inverse depth that a block can have.
    """
    steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    across = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    pixel = np.concatenate([(one.x0, one.y0) + across * (one.width, one.height) for one in blocks])
    low, high = np.repeat(within, POINTS_OF_A_BLOCK, axis=0).T
    inverse = np.clip(ground.inverse_depth(pixel), low, high)
    world = scene.cameras[name].world(pixel, 1 / inverse)
    cameras = list(scene.cameras.values())
    asked = _in_reach(scene, world)
    sees = np.zeros((len(cameras), len(world)), bool)
    for index in np.flatnonzero(asked):
        sees[index] = cameras[index].sees(world)
    point, observer = np.nonzero(sees.T)
    return world, point, observer


def _in_reach(scene: NativeScene, world: Floats) -> npt.NDArray[np.bool_]:
    """Which cameras may see one of the points: those whose cone of view touches the ball around them."""
    cameras = scene.cameras.values()
    middle = (world.min(axis=0) + world.max(axis=0)) / 2
    radius = np.linalg.norm(world - middle, axis=1).max()
    centres = np.array([camera.centre for camera in cameras])
    axes = np.array([camera.cam_from_world[2, :3] for camera in cameras])
    widest = np.array([_half_angle(camera) for camera in cameras])
    known = np.array([len(scene.observations[name].point) > 0 for name in scene.cameras])
    there = middle - centres
    distance = np.linalg.norm(there, axis=1)
    along = np.einsum("ij,ij->i", there, axes)
    angle = np.arccos(np.clip(along / np.maximum(distance, 1e-300), -1, 1))
    around = np.arcsin(np.clip(radius / np.maximum(distance, 1e-300), 0, 1))
    in_reach: npt.NDArray[np.bool_] = known & ((distance <= radius) | (angle <= widest + around))
    return in_reach


def _half_angle(camera: NativeCamera) -> float:
    """Largest angle between the axis of a camera and a ray of its image."""
    corners = np.array([(x, y, 1.0) for x in (0, camera.width) for y in (0, camera.height)])
    rays = corners @ np.linalg.inv(camera.intrinsics).T
    return float(np.arctan(np.hypot(rays[:, 0], rays[:, 1]).max()))
