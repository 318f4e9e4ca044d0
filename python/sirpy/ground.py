"""The ground where a photograph sees none of the sparse points.

At the rim of a survey only views of other directions meet, whose features do not match. Stereo finds the ground
there all the same, if it is told where to look for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sirpy.native_scene import Floats, Indices, NativeScene, Observations
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
    scene: NativeScene, name: str, ground: Ground, blocks: list[Rectangle]
) -> tuple[Floats, Indices, Indices]:
    """Points of the ground in blocks of a native image, POINTS_OF_A_BLOCK in each, and who would see them: world
    (p, 3), and pairs (point, index of a camera), those of a point together.

    Photographs that see no sparse point at all are not asked: nothing tells where they are.
    """
    steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    across = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    pixel = np.concatenate([(one.x0, one.y0) + across * (one.width, one.height) for one in blocks])
    world = scene.cameras[name].world(pixel, 1 / ground.inverse_depth(pixel))
    sees = np.array(
        [
            camera.sees(world) & (len(scene.observations[other].point) > 0)
            for other, camera in scene.cameras.items()
        ]
    )
    point, observer = np.nonzero(sees.T)
    return world, point, observer
