"""The depths that a window of a photograph can have, and which sources may be matched there, pixel by pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sirpy.rectangle import Rectangle
from sirpy.view_fields import ViewField

FloatMap = npt.NDArray[np.float32]


@dataclass(frozen=True)
class DepthRange:
    """Depths (z in the reference camera) that a window can have; they differ from place to place.

    Attributes:
        field: of the native image; its blocks say also which sources see a place.
        window: native pixels.
    """

    field: ViewField
    window: Rectangle

    @property
    def minimum(self) -> float:
        return float(self.field.min_depth[self.field.blocks(self.window)].min())

    @property
    def maximum(self) -> float:
        return float(self.field.max_depth[self.field.blocks(self.window)].max())

    def inverse(
        self, x: npt.NDArray[np.floating], y: npt.NDArray[np.floating]
    ) -> tuple[FloatMap, FloatMap]:
        """Inverse depths of the nearest and the farthest, (len(y), len(x)), at native pixel coordinates.

        Without steps: linear between the corners of the blocks, where the ranges of those that meet have
        something in common. A range of a block holds those of the blocks around it, so what is common
        holds what each of them needs; and it is no more than the range that the source windows hold.
        """
        near, far = (
            _between_corners(
                _at_corners(common, 1 / depths.astype(np.float64)), self.field.side, x, y
            )
            for common, depths in (
                (np.minimum, self.field.min_depth),
                (np.maximum, self.field.max_depth),
            )
        )
        return near, far

    def allowed(
        self, x: npt.NDArray[np.floating], y: npt.NDArray[np.floating], index: int
    ) -> npt.NDArray[np.bool_]:
        """Where a source may be matched, (len(y), len(x)), at native pixel coordinates."""
        side = self.field.side
        rows, columns = (np.clip(at, 0, None).astype(int) // side for at in (y, x))
        height, width = self.field.allowed.shape
        rows, columns = np.minimum(rows, height - 1), np.minimum(columns, width - 1)
        bits: npt.NDArray[np.uint32] = self.field.allowed[np.ix_(rows, columns)]
        return (bits >> np.uint32(index) & 1).astype(bool)


def _at_corners(common: np.ufunc, blocks: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(rows + 1, columns + 1): what the blocks that meet in a corner have in common."""
    padded = np.pad(blocks, 1, mode="edge")
    beside = common(padded[:, :-1], padded[:, 1:])
    found: npt.NDArray[np.float64] = common(beside[:-1], beside[1:])
    return found


def _between_corners(
    values: npt.NDArray[np.float64],
    side: int,
    x: npt.NDArray[np.floating],
    y: npt.NDArray[np.floating],
) -> FloatMap:
    """Bilinear between the corners of blocks, (len(y), len(x)); beyond the outermost their values."""
    for axis, at in ((0, y), (1, x)):
        last = values.shape[axis] - 1
        place = np.clip(at / side, 0, last)
        first = np.minimum(place.astype(int), last - 1)
        share = (place - first).reshape((-1, 1) if axis == 0 else (1, -1))
        values = values.take(first, axis) * (1 - share) + values.take(first + 1, axis) * share
    return values.astype(np.float32)
