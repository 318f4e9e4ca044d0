"""Where maps are sampled: along the rays of the reference in a source, and at neighbours in the reference.

Pixel centres lie at whole numbers. Maps are [C, H, W], in pixels of a stage.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

_NEAREST = 1e-3  # depth in a source: what is nearer, or behind, is not seen


@dataclass(frozen=True)
class SourceMap:
    """A source at one stage.

    Attributes:
        features: [C, h', w']; on the CPU it is best when the channels of a pixel lie side by side.
        source_from_reference: [3, 4] float32: homogeneous pixels of the source from (x d, y d, d, 1)
            with pixels (x, y) of the reference and the depth d there.
        behind: (x, y) that stands for what lies behind the source, outside of `features`.
        allowed: [h, w], which pixels of the reference it is matched against; all if None.
    """

    features: Tensor
    source_from_reference: Tensor
    behind: tuple[float, float]
    allowed: Tensor | None = None


@dataclass(frozen=True)
class Frame:
    """Where a map lies in that of the whole image: its corner there, and the size of the whole."""

    x0: int
    y0: int
    width: int
    height: int


def warped(source: SourceMap, depth: Tensor, first_row: int) -> Tensor:
    """The source's features [C, D, h, w] at what the reference sees in depths [D, h, w]; 0 outside.

    The rows of `depth` begin at `first_row` of the reference's map.
    """
    _, height, width = depth.shape
    matrix = source.source_from_reference
    x = torch.arange(width, device=depth.device, dtype=depth.dtype)
    y = torch.arange(first_row, first_row + height, device=depth.device, dtype=depth.dtype)[:, None]
    # [D, h, w] each: the product with the pixel first, then the depth, then the translation.
    u, v, z = ((row[0] * x + row[1] * y + row[2]) * depth + row[3] for row in matrix)
    seen = z > _NEAREST
    u = torch.where(seen, u / z, source.behind[0])
    v = torch.where(seen, v / z, source.behind[1])
    return _bilinear(source.features, u, v, "zeros")


def neighbour_positions(offsets: Tensor, fixed: Tensor, first_row: int) -> tuple[Tensor, Tensor]:
    """x and y [N, h, w] of N neighbours of each pixel of rows from `first_row` on.

    Args:
        offsets: [2 N, h, w], learned, in pixels: x and y of the first neighbour, then of the next.
        fixed: [N, 2] (x, y), pixels.
    """
    _, height, width = offsets.shape
    x = torch.arange(width, device=offsets.device, dtype=offsets.dtype)
    y = torch.arange(first_row, first_row + height, device=offsets.device, dtype=offsets.dtype)
    return (
        x + fixed[:, 0, None, None] + offsets[0::2],
        y[:, None] + fixed[:, 1, None, None] + offsets[1::2],
    )


def at_neighbours(maps: Tensor, x: Tensor, y: Tensor, frame: Frame) -> Tensor:
    """Maps [C, H, W] at positions x and y [N, h, w]: [C, N, h, w]; beyond the border what is next to it.

    The published network mixes two conventions of where a map begins, and was trained so: it samples at
    x W / (W - 1) - 1/2, half a pixel further left on the left of the image, right on the right. W is that of
    the whole image here, wherever the map lies in it, so a pixel is given the same in every window.
    """
    x, y = (
        ((position + corner) * (side / max(side - 1, 1)) - 0.5).clamp(0, side - 1) - corner
        for position, corner, side in (
            (x, frame.x0, frame.width),
            (y, frame.y0, frame.height),
        )
    )
    return _bilinear(maps, x, y, "border")


def _bilinear(maps: Tensor, x: Tensor, y: Tensor, padding: str) -> Tensor:
    """[C, *positions] of maps [C, H, W] at positions x and y of one shape, of 3 axes."""
    _, height, width = maps.shape
    # A map may be one pixel wide, where positions with aligned corners would be none.
    grid = torch.stack([(2 * x + 1) / width - 1, (2 * y + 1) / height - 1], dim=-1)
    flat = grid.reshape(1, -1, x.shape[-1], 2)
    found = F.grid_sample(maps[None], flat, "bilinear", padding, align_corners=False)
    return found.reshape(len(maps), *x.shape)
