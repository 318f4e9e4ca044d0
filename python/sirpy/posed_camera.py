"""A camera of a model as it took the photograph: pose and lens.

Pixels are those of the photograph, the centre of its first at (0.5, 0.5); depth is z in the camera frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import pycolmap

from sirpy.frame import rotated
from sirpy.model_arrays import PosedImage, SparseModel

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

_BORDER = 64  # rays along each side of the frame


@dataclass(frozen=True, eq=False)
class PosedCamera:
    """A photograph of a model: any camera model of COLMAP, and cam_from_world (3, 4)."""

    name: str
    camera: pycolmap.Camera
    cam_from_world: Floats

    @classmethod
    def of(cls, model: SparseModel, image: PosedImage) -> PosedCamera:
        return cls(image.name, model.camera_of(image), image.cam_from_world)

    @cached_property
    def centre(self) -> Floats:
        """Projection centre in the world, (3,)."""
        return -self.cam_from_world[:, :3].T @ self.cam_from_world[:, 3]

    def in_camera(self, world: Floats) -> Floats:
        """World points (n, 3) in the camera frame, (n, 3)."""
        in_camera: Floats = rotated(world, self.cam_from_world[:, :3]) + self.cam_from_world[:, 3]
        return in_camera

    def world(self, rays: Floats, depth: Floats) -> Floats:
        """World points (n, 3) on rays (n, 2), x/z and y/z, at depths (n,)."""
        in_camera = np.column_stack([rays, np.ones(len(rays))]) * depth[:, None]
        return rotated(in_camera - self.cam_from_world[:, 3], self.cam_from_world[:, :3].T)

    def rays(self, pixels: Floats) -> Floats:
        """(n, 2), x/z and y/z, of pixels (n, 2); not finite where the lens has no such ray."""
        return np.asarray(self.camera.cam_from_img(pixels), np.float64)

    def project(self, world: Floats) -> tuple[Indices, Floats, Floats]:
        """Which of the points (n, 3) may be in the photograph (m,), their pixels (m, 2) and depths (m,).

        A few of these pixels lie outside the frame.
        """
        in_camera = self.in_camera(world)
        x, y, z = in_camera.T
        # Far outside the frame the polynomials of a lens may fold back into it.
        near = (z > 0) & (x * x + y * y <= (self._reach * z) ** 2)
        found = np.flatnonzero(near)
        pixels = np.asarray(self.camera.img_from_cam(in_camera[found]), np.float64)
        finite = np.isfinite(pixels).all(axis=1)
        return found[finite], pixels[finite], z[found[finite]]

    def sees(self, world: Floats) -> tuple[Indices, Floats]:
        """Which of the points (n, 3) fall into the frame (m,), and their pixels (m, 2)."""
        found, pixels, _ = self.project(world)
        size = self.camera.width, self.camera.height
        inside = ((pixels >= 0) & (pixels < size)).all(axis=1)
        return found[inside], pixels[inside]

    @cached_property
    def _reach(self) -> float:
        """Distance from the optical axis, at depth 1, of what the frame's border sees farthest from it."""
        share = np.linspace(0, 1, _BORDER)
        along = np.stack([share, np.zeros(_BORDER)], axis=1)
        sides = np.concatenate([along, along[:, ::-1], 1 - along, 1 - along[:, ::-1]])
        rays = self.rays(sides * [self.camera.width, self.camera.height])
        seen = np.linalg.norm(rays[np.isfinite(rays).all(axis=1)], axis=1)
        return 1.01 * float(seen.max()) if len(seen) else np.inf
