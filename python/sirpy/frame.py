"""The frame of the products: z up, in metres of a CRS where there is one; a similarity away from the model."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Frame:
    """world = scale * rotation @ model + translation.

    `crs` as pyproj takes it ("EPSG:25832"), projected, axes x east and y north; None in a local frame, whose unit
    is the model's.
    """

    crs: str | None = None
    scale: float = 1.0
    rotation: Floats = field(default_factory=lambda: np.eye(3))
    translation: Floats = field(default_factory=lambda: np.zeros(3))

    def world(self, model: Floats) -> Floats:
        """Points (n, 3) of the model, in this frame."""
        points: Floats = self.scale * (model @ self.rotation.T) + self.translation
        return points

    def model(self, world: Floats) -> Floats:
        """Points (n, 3) of this frame, in the model."""
        points: Floats = (world - self.translation) @ self.rotation / self.scale
        return points
