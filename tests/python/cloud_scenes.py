"""Clouds for tests of the products, in one part, at a place on the Earth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from sirpy.cloud import POINT, Cloud
from sirpy.frame import Frame
from sirpy.npy import write_npy

Floats = npt.NDArray[np.float64]

# Turned, scaled and far from the model's origin.
UTM = Frame(
    "EPSG:32614",
    2.0,
    np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    np.array([5e5, 3.3e6, 150.0]),
)


def cloud_of(
    path: Path,
    places: Floats,
    normals: Floats | tuple[float, float, float] = (0.0, 0.0, 1.0),
    gsd: float | Floats = 0.1,
    frame: Frame | None = None,
) -> Cloud:
    """The cloud of points (n, 3) that are given in the frame, with normals and GSD in it."""
    frame = frame or Frame()
    model = frame.model(places)
    points = np.zeros(len(places), POINT)
    normals = np.broadcast_to(np.asarray(normals, np.float64), places.shape) @ frame.rotation
    for axis, (place, direction) in enumerate(zip("xyz", ("nx", "ny", "nz"), strict=True)):
        points[place], points[direction] = model[:, axis], normals[:, axis]
    points["gsd"] = np.asarray(gsd) / frame.scale
    points["confidence"], points["views"] = 0.8, 3
    write_npy(path, points)
    return Cloud([path], frame)


def scattered(
    low: tuple[float, float], high: tuple[float, float], gsd: float, seed: int = 0
) -> Floats:
    """Places (n, 2), one in each square of `gsd`."""
    random = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(low[0], high[0], gsd), np.arange(low[1], high[1], gsd))
    places = np.column_stack([x.ravel(), y.ravel()])
    return places + random.uniform(0, gsd, places.shape)
