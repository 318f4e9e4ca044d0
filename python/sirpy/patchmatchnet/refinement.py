"""The refinement of the half-size depths by the image (Wang et al., CVPR 2021, section 3.4)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from sirpy.patchmatchnet.bands import Bands
from sirpy.patchmatchnet.layers import ConvBnRelu, folded

_REACH = 5  # rows of the half-size map that have a say: two convolutions, the deconvolution, two at full size
_BYTES_PER_PIXEL = 400  # of the half-size map: 16 channels at full size twice, and smaller ones


class Refinement(nn.Module):
    """Adds what the image tells to the depth, at the size of the image."""

    def __init__(self) -> None:
        super().__init__()
        self.conv0 = ConvBnRelu(3, 8)
        self.conv1 = ConvBnRelu(1, 8)
        self.conv2 = ConvBnRelu(8, 8)
        self.deconv = nn.ConvTranspose2d(8, 8, 3, stride=2, padding=1, output_padding=1, bias=False)
        self.bn = nn.BatchNorm2d(8)
        self.conv3 = ConvBnRelu(16, 8)
        self.res = nn.Conv2d(8, 1, 3, padding=1, bias=False)

    def residual(self, image: Tensor, depth: Tensor) -> Tensor:
        """[1, 2 h, 2 w] of an image [3, 2 h, 2 w] and depths [1, h, w], normalised: 0 to 1."""
        of_image = self.conv0(image[None])
        weight, bias = folded(self.deconv.weight, self.bn, output_axis=1)
        of_depth = F.conv_transpose2d(
            self.conv2(self.conv1(depth[None])), weight, bias, stride=2, padding=1, output_padding=1
        ).relu_()
        found: Tensor = self.res(self.conv3(torch.cat([of_depth, of_image], dim=1)))[0]
        return found

    def forward(
        self, image: Tensor, depth: Tensor, nearest: Tensor, farthest: Tensor, bands: Bands
    ) -> Tensor:
        """Depths [2 h, 2 w].

        Args:
            image: [3, 2 h, 2 w], RGB, 8 bit or 0 to 1.
            depth: [h, w].
            nearest, farthest: depths [h, w].
        """
        height, width = depth.shape
        refined = depth.new_empty(2 * height, 2 * width)

        def band(rows: slice) -> None:
            first, end = max(0, rows.start - _REACH), min(height, rows.stop + _REACH)
            around, extent = depth[first:end], (farthest - nearest)[first:end]
            residual = self.residual(
                as_float(image[:, 2 * first : 2 * end]),
                ((around - nearest[first:end]) / extent)[None],
            )[0]
            found = doubled(around) + residual * doubled(extent)
            kept = slice(2 * (rows.start - first), 2 * (rows.stop - first))
            refined[2 * rows.start : 2 * rows.stop] = found[kept]

        bands.run(band, height, _BYTES_PER_PIXEL * width)
        return refined


def as_float(image: Tensor) -> Tensor:
    """0 to 1, of 8 bit or of floats already."""
    return image.float() / 255 if image.dtype == torch.uint8 else image


def doubled(maps: Tensor) -> Tensor:
    """[..., 2 h, 2 w]: every pixel four times."""
    return maps.repeat_interleave(2, dim=-2).repeat_interleave(2, dim=-1)
