"""Layers of PatchmatchNet. Batch normalisation uses the running statistics, folded into the convolution."""

from __future__ import annotations

from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class ConvBnRelu(nn.Module):
    """Convolution without bias, batch normalisation, ReLU: [B, C, ...] to [B, C', ...]."""

    def __init__(
        self,
        inputs: int,
        outputs: int,
        kernel: int = 3,
        stride: int = 1,
        dimensions: Literal[2, 3] = 2,
    ) -> None:
        super().__init__()
        convolution = nn.Conv2d if dimensions == 2 else nn.Conv3d
        normalisation = nn.BatchNorm2d if dimensions == 2 else nn.BatchNorm3d
        self.conv = convolution(inputs, outputs, kernel, stride, kernel // 2, bias=False)
        self.bn = normalisation(outputs)

    def folded(self) -> tuple[Tensor, Tensor]:
        """Weight and bias of the convolution that does the same without batch normalisation."""
        return folded(self.conv.weight, self.bn, output_axis=0)

    def forward(self, x: Tensor) -> Tensor:
        weight, bias = self.folded()
        return F.conv2d(x, weight, bias, self.conv.stride[0], self.conv.padding[0]).relu_()


def folded(
    weight: Tensor, bn: nn.BatchNorm2d | nn.BatchNorm3d, *, output_axis: int
) -> tuple[Tensor, Tensor]:
    """Weight and bias of a convolution together with the batch normalisation after it."""
    assert bn.running_mean is not None and bn.running_var is not None
    scale = bn.weight / torch.sqrt(bn.running_var + bn.eps)
    shape = [1] * weight.ndim
    shape[output_axis] = -1
    return weight * scale.reshape(shape), bn.bias - bn.running_mean * scale


class PointwiseNet(nn.Module):
    """A number for every voxel from its G channels: [G, ...] to [...]. Nothing else has a say."""

    def __init__(self, groups: int, last: Literal["similarity", "conv2"] = "similarity") -> None:
        super().__init__()
        self.conv0 = ConvBnRelu(groups, 16, 1, dimensions=3)
        self.conv1 = ConvBnRelu(16, 8, 1, dimensions=3)
        self._last = last  # its name in the checkpoint
        self.add_module(last, nn.Conv3d(8, 1, 1))

    def forward(self, x: Tensor) -> Tensor:
        flat = x.reshape(len(x), -1)
        for layer in (self.conv0, self.conv1):
            weight, bias = layer.folded()
            flat = torch.addmm(bias[:, None], weight.flatten(1), flat).relu_()
        last = self.get_submodule(self._last)
        assert isinstance(last, nn.Conv3d) and last.bias is not None
        return torch.addmm(last.bias[:, None], last.weight.flatten(1), flat).reshape(x.shape[1:])
