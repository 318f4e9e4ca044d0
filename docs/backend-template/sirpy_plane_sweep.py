"""A plane sweep as a stereo backend of sirpy: it stands where a network of your own would.

`YOURS` marks what to change for it; docs/backends.md explains the words.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from sirpy.stereo_backend import (
    TORCH_BYTES,
    DepthMap,
    DepthRange,
    OutOfDeviceMemory,
    Prior,
    Setup,
    StereoBackend,
    View,
    torch_device,
    torch_device_bytes,
)
from torch import Tensor

PLANES = 64  # depths that are tried
RADIUS = 2  # pixels: 5 x 5 are compared
WORST = 30.0  # grey levels of difference: what is hidden in a source counts no more than that


class PlaneSweep(StereoBackend):
    """One pass at native resolution; sirpy then judges its depths by the sources and filters them."""

    margin: int = RADIUS  # YOURS: the receptive field, in pixels to each side
    halo: int = RADIUS  # YOURS: as much of it as is worth the time around a sub-image
    loaded_bytes: int = TORCH_BYTES  # YOURS: with the weights
    step: int = 1  # YOURS: sides of windows are multiples of it, for example 32

    def __init__(self, setup: Setup) -> None:
        # YOURS: check that the weights are there; read them at the first estimate: plans need none.
        self._device = torch_device(setup.options.device)
        if setup.options.threads:
            torch.set_num_threads(setup.options.threads)

    @property
    def device(self) -> str:
        return str(self._device)

    @property
    def device_bytes(self) -> int | None:
        return torch_device_bytes(self._device)

    def memory(self, reference_pixels: int, source_pixels: int) -> int:
        """YOURS: measure it at two sizes. Here costs and some maps, images as float32."""
        return 20_000_000 + (4 * PLANES + 180) * reference_pixels + 16 * source_pixels

    def estimate(
        self, reference: View, sources: Sequence[View], depth_range: DepthRange, prior: Prior
    ) -> DepthMap:
        window = reference.window  # at level 0 in native pixels, whose centres are at .5
        x, y = np.arange(window.x0, window.x1) + 0.5, np.arange(window.y0, window.y1) + 0.5
        try:
            with torch.inference_mode():
                near, far = (self._tensor(one) for one in depth_range.inverse(x, y))
                allowed = [depth_range.allowed(x, y, source.index) for source in sources]
                # YOURS: images, intrinsics, poses and depths are what a network is given.
                depth = plane_sweep(
                    self._image(reference),
                    [self._image(source) for source in sources],
                    [self._tensor(source_from_reference(reference, one)) for one in sources],
                    [self._tensor(one) for one in allowed],
                    near,
                    far,
                )
                return DepthMap(depth.cpu().numpy())
        except torch.OutOfMemoryError:
            raise OutOfDeviceMemory from None  # sirpy comes again with smaller windows

    def _image(self, view: View) -> Tensor:
        """[3, h, w], RGB from 0 to 255."""
        return self._tensor(view.image).permute(2, 0, 1).float()

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array).to(self._device)


def make(setup: Setup) -> StereoBackend:
    """What the entry point names."""
    return PlaneSweep(setup)


def source_from_reference(reference: View, source: View) -> np.ndarray:
    """(3, 4): homogeneous pixels of the source's window from (x, y, 1, inverse depth) of the reference's."""
    to_source, to_reference = (
        np.vstack([view.camera.cam_from_world, [0, 0, 0, 1]]) for view in (source, reference)
    )
    pose = (to_source @ np.linalg.inv(to_reference))[:3]
    rotation = source.intrinsics @ pose[:, :3] @ np.linalg.inv(reference.intrinsics)
    return np.column_stack([rotation, source.intrinsics @ pose[:, 3]]).astype(np.float32)


def plane_sweep(
    image: Tensor,
    sources: list[Tensor],
    matrices: list[Tensor],
    allowed: list[Tensor],
    near: Tensor,
    far: Tensor,
) -> Tensor:
    """YOURS: a network in place of this. Depths [h, w] of `image` [3, h, w]; 0 where no source sees a pixel.

    Args:
        sources: [3, h', w'] each.
        matrices: `source_from_reference`.
        allowed: [h, w] each: where a source may be used.
        near, far: inverse depths [h, w] of the nearest and the farthest surface.
    """
    _, height, width = image.shape
    x, y = torch.arange(width, device=image.device), torch.arange(height, device=image.device)
    costs = torch.zeros(PLANES, height, width, device=image.device)
    for plane in range(PLANES):
        inverse = torch.lerp(far, near, plane / (PLANES - 1))
        for source, matrix, use in zip(sources, matrices, allowed, strict=True):
            u, v, z = (
                row[0] * x + row[1] * y[:, None] + row[2] + row[3] * inverse for row in matrix
            )
            # `grid_sample` has the borders of the source at -1 and 1, not its outermost centres.
            u, v = (2 * u / z + 1) / source.shape[2] - 1, (2 * v / z + 1) / source.shape[1] - 1
            seen = use & (z > 0) & (u.abs() <= 1) & (v.abs() <= 1)
            grid = torch.stack([u, v], -1)
            warped = F.grid_sample(source[None], grid[None], align_corners=False)[0]
            difference = (warped - image).abs().mean(0).clamp(max=WORST)
            costs[plane] += torch.where(seen, difference, WORST)
        costs[plane] = F.avg_pool2d(
            costs[plane][None], 2 * RADIUS + 1, 1, RADIUS, count_include_pad=False
        )[0]
    # Between the planes: the lowest point of a parabola through the best one and those beside it.
    best = costs.argmin(0).clamp(1, PLANES - 2)
    before, here, after = (costs.gather(0, (best + one)[None])[0] for one in (-1, 0, 1))
    bend = before - 2 * here + after
    offset = torch.where(bend > 0, (before - after) / (2 * bend), 0).clamp(-1, 1)
    depth = 1 / torch.lerp(far, near, (best + offset) / (PLANES - 1))
    return torch.where(here < WORST * len(sources), depth, 0)
