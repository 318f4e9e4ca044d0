"""Types of the bundle adjustment in C++ (Ceres). A pose is a row: quaternion x, y, z, w, then centre."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

def lens_names() -> list[str]:
    """COLMAP's camera models that can be adjusted."""

class Model:
    def __init__(
        self,
        *,
        cameras: Sequence[
            tuple[str, Sequence[float], Sequence[bool], Sequence[float], Sequence[float]]
        ],
        frames: NDArray[np.float64],
        sensors: NDArray[np.float64],
        images: NDArray[np.int32],
        points: NDArray[np.float64],
    ) -> None:
        """cameras: name of the model, parameters, which of them are free, what they are expected to be and
        how far from it (0: nothing is expected); frames (n, 7): rig from
        world; sensors (m, 7): sensor from rig; images (i, 3): indices of camera, frame, sensor (-1: the
        one of the frame's pose); points (p, 3)."""

class Observations:
    def __init__(
        self,
        *,
        image: NDArray[np.int32],
        point: NDArray[np.int32],
        xy: NDArray[np.float64],
        whitening: NDArray[np.float64],
    ) -> None:
        """image, point (o,): indices, points ascending; xy (o, 2), px; whitening (o, 4): W by rows,
        W^T W the inverse of the covariance."""

class Positions:
    def __init__(
        self, *, image: NDArray[np.int32], centre: NDArray[np.float64], sigma: NDArray[np.float64]
    ) -> None:
        """image (k,): indices; centre, sigma (k, 3)."""

def adjust(
    model: Model,
    observations: Observations,
    positions: Positions,
    *,
    loss_scale: float,
    deviations: bool,
) -> tuple[
    bool,
    str,
    list[tuple[list[float], list[float] | None]],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
]:
    """(usable, message, cameras, frames, sensors, points); of each camera its parameters and their
    standard deviations for whitened observations of 1, where asked for and determined."""

def residuals(model: Model, observations: Observations) -> NDArray[np.float64]:
    """(o, 2), observed minus projected, px."""
