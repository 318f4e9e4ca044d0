"""The flight over a synthetic scene: a camera and where it took its photographs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sirpy.errors import InputError

CameraModel = Literal["PINHOLE", "OPENCV"]

GSD = 0.1
"""Size of a pixel on level ground under a nadir photograph, in metres."""

_FOCAL_LENGTH = 0.9  # of the image's longer side
_OVERLAP, _SIDE_OVERLAP = 0.8, 0.6
_TILT = math.radians(30)  # of the oblique photographs, from the vertical


@dataclass(frozen=True)
class Shot:
    """One photograph: name, centre of projection (metres, world) and rotation cam_from_world (3,
    3).
    """

    name: str
    centre: NDArray[np.float64]
    cam_from_world: NDArray[np.float64]


def make_camera(model: CameraModel, size: tuple[int, int]) -> Any:
    """A pycolmap camera of `size` (width, height), its principal point a little off the middle."""
    import pycolmap

    width, height = size
    if model not in ("PINHOLE", "OPENCV"):
        raise InputError(f"no synthetic camera of model {model}: choose PINHOLE or OPENCV")
    if min(size) < 16:
        raise InputError(f"a photograph of {width}x{height} pixels is too small: 16 is the least")
    focal = _FOCAL_LENGTH * max(size)
    params = [focal, focal, width / 2 + 0.004 * width, height / 2 - 0.006 * height]
    if model == "OPENCV":
        params += [-0.06, 0.03, 4e-4, -3e-4]
    return pycolmap.Camera(model=model, width=width, height=height, params=params)


def flying_height(size: tuple[int, int]) -> float:
    """Of the nadir photographs above zero, in metres."""
    return _FOCAL_LENGTH * max(size) * GSD


def plan_flight(
    count: int,
    size: tuple[int, int],
    seed: int,
    middle: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> list[Shot]:
    """`count` photographs of one area: strips of nadir photographs with 80 % forward and 60 % side
    overlap, and a quarter of oblique ones that look at the middle from all around.

    Args:
        middle: of the area, metres; the overlap holds at its height.

    Raises:
        InputError: fewer than 2 photographs, or the middle is above them.
    """
    if count < 2:
        raise InputError(f"a flight needs at least 2 photographs, not {count}")
    random = np.random.default_rng(seed)
    above = flying_height(size) - middle[2]
    if above <= 0:
        raise InputError(f"a flight at {flying_height(size)} m cannot look down at {middle[2]} m")
    oblique = count // 4
    shots = _nadir(count - oblique, size, np.array(middle), random)
    for i in range(oblique):
        azimuth = math.radians(35) + 2 * math.pi * i / oblique
        target = middle + np.append(random.normal(0, 2.0, 2), 0.0)
        shots.append(_oblique(f"oblique_{i + 1:03d}.jpg", azimuth, target, 1.05 * above))
    return shots


def _nadir(
    count: int, size: tuple[int, int], middle: NDArray[np.float64], random: np.random.Generator
) -> list[Shot]:
    width, height = size
    strips = max(1, round(math.sqrt(count / 2)))
    pixel = GSD * (1 - middle[2] / flying_height(size))  # at the height of the middle, m
    along, across = (1 - _OVERLAP) * height * pixel, (1 - _SIDE_OVERLAP) * width * pixel
    shots = []
    for strip, members in enumerate(np.array_split(np.arange(count), strips)):
        for i in range(len(members)):
            forth = strip % 2 == 0
            y = (i - (len(members) - 1) / 2) * along * (1 if forth else -1)
            x = (strip - (strips - 1) / 2) * across
            place = np.array([middle[0] + x, middle[1] + y, flying_height(size)])
            centre = place + random.normal(0, [0.6, 0.6, 0.5])
            heading = (0 if forth else math.pi) + math.radians(random.normal(0, 1.5))
            # North is up in the image of a camera that flies north.
            look = np.array([math.radians(a) for a in random.normal(0, 1.2, 2)])
            down = np.array([look[0], look[1], -1.0])
            up = np.array([-math.sin(heading), math.cos(heading), 0.0])
            name = f"strip{strip + 1}_{i + 1:03d}.jpg"
            shots.append(Shot(name, centre, _cam_from_world(down, up)))
    return shots


def _oblique(name: str, azimuth: float, target: NDArray[np.float64], distance: float) -> Shot:
    outwards = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    centre = target + distance * (math.sin(_TILT) * outwards + [0, 0, math.cos(_TILT)])
    return Shot(name, centre, _cam_from_world(target - centre, np.array([0.0, 0.0, 1.0])))


def _cam_from_world(forward: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation of a camera that looks `forward`, with `up` towards the top of its image."""
    z = forward / np.linalg.norm(forward)
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])
