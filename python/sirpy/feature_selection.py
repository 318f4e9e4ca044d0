"""A photograph's features under a cap, spread evenly over it.

The photograph is divided into square cells. The features of a cell are ranked by their scale, the
largest first: COLMAP too keeps the largest. First every cell gives its first feature, then every
cell its second, and so on until the cap is reached: what a poor cell leaves of its share goes to
the others.

Selecting from a part of the features and then from what was selected and the rest is the same as
selecting from all: a feature that so many others precede, they still precede when more arrive. So
no more than the cap is ever held beside the features of one sub-image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_OF_A_CELL = 8  # features, where all cells give their share


@dataclass(frozen=True)
class Features:
    """`keypoints`: (n, 6) float32 as COLMAP has them: x, y and the shape a11, a12, a21, a22, which
    is scale times rotation, in pixels; `descriptors`: (n, 128) uint8."""

    keypoints: NDArray[np.float32]
    descriptors: NDArray[np.uint8]

    @classmethod
    def none(cls) -> Features:
        return cls(np.empty((0, 6), np.float32), np.empty((0, 128), np.uint8))

    def __len__(self) -> int:
        return len(self.keypoints)

    def joined(self, other: Features) -> Features:
        return Features(
            np.concatenate([self.keypoints, other.keypoints]),
            np.concatenate([self.descriptors, other.descriptors]),
        )

    def taken(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> Features:
        return Features(self.keypoints[chosen], self.descriptors[chosen])


def spread(features: Features, size: tuple[int, int], most: int) -> Features:
    """At most `most` of the features of a photograph of `size` (width, height), the largest first.

    The same for any order of `features`.
    """
    x, y = features.keypoints[:, 0], features.keypoints[:, 1]
    scale = np.hypot(features.keypoints[:, 2], features.keypoints[:, 4])
    # Of equal scale are the orientations of one keypoint; they all differ in their shape.
    by_scale = np.lexsort((*features.keypoints.T[::-1], -scale))
    features, x, y, scale = features.taken(by_scale), x[by_scale], y[by_scale], scale[by_scale]
    if len(features) <= most:
        return features
    cell = _cells(x, y, size, most)
    order = np.argsort(cell, kind="stable")
    begin = np.searchsorted(cell[order], cell[order])
    rank = np.empty(len(features), np.int64)
    rank[order] = np.arange(len(features)) - begin
    # Stable: of equal rank, the largest scale comes first.
    chosen = np.argsort(rank, kind="stable")[:most]
    return features.taken(np.sort(chosen))


def _cells(
    x: NDArray[np.float32], y: NDArray[np.float32], size: tuple[int, int], most: int
) -> NDArray[np.int64]:
    """The number of the cell that each position lies in."""
    width, height = size
    side = max(1.0, math.sqrt(width * height * _OF_A_CELL / most))
    columns, rows = max(1, round(width / side)), max(1, round(height / side))
    column = np.clip((x * (columns / width)).astype(np.int64), 0, columns - 1)
    row = np.clip((y * (rows / height)).astype(np.int64), 0, rows - 1)
    return row * columns + column
