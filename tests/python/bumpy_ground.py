"""Photographs of bumpy textured ground seen from above, with exact cameras: a scene for structure
from motion.

World: x east, y north, z up; ground z = height(x, y), about 1 unit high waves; cameras 10 units
above, looking down and a little towards the middle.
"""

from __future__ import annotations

import warnings
from functools import cache
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning
from scipy.ndimage import gaussian_filter, map_coordinates

WIDTH, HEIGHT, FOCAL = 480, 360, 450.0
_TEXELS_PER_UNIT = 48


def camera_centres(count: int) -> NDArray[np.float64]:
    """count x 3 positions along a bent strip."""
    s = np.linspace(-1, 1, count)
    return np.stack([2.5 * s, 0.8 * s**2, 10 + 0.3 * s], axis=1)


def towards_middle(centre: NDArray[np.float64]) -> NDArray[np.float64]:
    """3 x 3 rotation cam_from_world of a camera at `centre` that looks at the origin."""
    forward = -centre / np.linalg.norm(centre)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def photograph(
    centre: NDArray[np.float64], rotation: NDArray[np.float64] | None = None
) -> NDArray[np.uint8]:
    """HEIGHT x WIDTH grey values that a camera at `centre` sees; `rotation` is cam_from_world,
    towards the middle if not given."""
    right, down, forward = towards_middle(centre) if rotation is None else rotation
    u, v = np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(HEIGHT) + 0.5 - HEIGHT / 2)
    rays = (u[..., None] * right + v[..., None] * down) / FOCAL + forward
    depth = -centre[2] / rays[..., 2]
    for _ in range(30):  # converges, since the ground is flatter than the rays are steep
        points = centre + depth[..., None] * rays
        depth = (_height(points[..., 0], points[..., 1]) - centre[2]) / rays[..., 2]
    points = centre + depth[..., None] * rays
    rows = (points[..., 1] + 16) * _TEXELS_PER_UNIT
    columns = (points[..., 0] + 16) * _TEXELS_PER_UNIT
    grey = map_coordinates(_texture(), [rows, columns], order=1, mode="wrap")
    return np.asarray(grey, dtype=np.uint8)


def write_photographs(folder: Path, names: list[str]) -> None:
    """One JPEG for each name, in order along the strip."""
    for name, centre in zip(names, camera_centres(len(names)), strict=True):
        write_jpeg(folder / name, photograph(centre))


def write_jpeg(path: Path, grey: NDArray[np.uint8]) -> None:
    """Writes rows x columns grey values as an RGB photograph."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = grey.shape
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(
            path, "w", driver="JPEG", width=width, height=height, count=3, dtype="uint8", QUALITY=95
        ) as dataset:
            dataset.write(np.stack([grey] * 3))


def _height(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(0.5 * np.sin(0.9 * x) * np.cos(0.7 * y))


@cache
def _texture() -> NDArray[np.float64]:
    random = np.random.default_rng(7)
    side = 32 * _TEXELS_PER_UNIT
    noise = sum(
        gaussian_filter(random.standard_normal((side, side)), sigma, mode="wrap") * sigma
        for sigma in (3.0, 5.0, 12.0)
    )
    return np.asarray(np.clip(128 + 45 * noise / np.std(noise), 0, 255))
