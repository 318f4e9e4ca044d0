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
        return self.scale * rotated(model, self.rotation) + self.translation

    @property
    def is_model(self) -> bool:
        """Whether it is the model's own."""
        return self.scale == 1 and (self.rotation == np.eye(3)).all() and not self.translation.any()

    def model(self, world: Floats) -> Floats:
        """Points (n, 3) of this frame, in the model."""
        return rotated(world - self.translation, self.rotation.T) / self.scale


def rotated(points: Floats, rotation: Floats) -> Floats:
    """Points (n, 3) by a matrix; sums in one order, which a library of linear algebra does not promise."""
    x, y, z = points.T
    return np.column_stack([row[0] * x + row[1] * y + row[2] * z for row in rotation])
