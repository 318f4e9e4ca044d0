"""The lattice that rasters share: square cells on whole multiples of their side, so that rasters of one resolution
lie cell on cell.

Windows are rectangles of (column, row); columns go east, rows south. The centre of a cell is at
((column + 0.5) * cell, -(row + 0.5) * cell) in the frame (cpp/src/surface_model.h has the same).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sirpy.errors import InputError
from sirpy.frame import Floats
from sirpy.rectangle import Rectangle

_NICE = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
_FINEST = 0.1  # GSD: nothing more is to be seen
_MOST_CELLS = 10**12


@dataclass(frozen=True)
class Lattice:
    """Cells of the side `cell`, in the unit of the frame."""

    cell: float

    def around(self, x0: float, y0: float, x1: float, y1: float) -> Rectangle:
        """The cells that a rectangle of the frame touches."""
        return Rectangle.from_corners(
            math.floor(x0 / self.cell),
            math.floor(-y1 / self.cell),
            math.floor(x1 / self.cell) + 1,
            math.floor(-y0 / self.cell) + 1,
        )

    def box(self, window: Rectangle) -> tuple[float, float, float, float]:
        """(x0, y0, x1, y1) of a window in the frame."""
        cell = self.cell
        return window.x0 * cell, -window.y1 * cell, window.x1 * cell, -window.y0 * cell

    def centres(self, window: Rectangle) -> Floats:
        """(height, width, 2): x and y of the cells' centres in the frame."""
        x = (np.arange(window.x0, window.x1) + 0.5) * self.cell
        y = -(np.arange(window.y0, window.y1) + 0.5) * self.cell
        return np.stack(np.meshgrid(x, y), axis=-1)


def aligned_blocks(window: Rectangle, side: int) -> Iterator[Rectangle]:
    """Squares of side x side cells on whole multiples of the side that cover a window, row by row."""
    whole = window.aligned(side)
    for y0 in range(whole.y0, whole.y1, side):
        for x0 in range(whole.x0, whole.x1, side):
            yield Rectangle(x0, y0, side, side)


def choose_lattice(
    asked: float | None, gsd: float, low: Floats, high: Floats, option: str = "--resolution"
) -> Lattice:
    """The lattice of a resolution; if none is asked for, of the GSD rounded up to a number of few digits.

    Args:
        gsd: of the cloud; 0 where it is not known.
        low, high: corners of the box around the cloud, x and y first.

    Raises:
        InputError: the resolution is no length, or far from what the cloud can show.
    """
    if asked is None:
        if not gsd > 0:
            raise InputError(f"the GSD of the cloud is not known: give {option}")
        asked = nice_above(gsd)
    if not 0 < asked < math.inf:
        raise InputError(f"{option} {asked:g} is not possible: give a length above 0, such as 0.1")
    if asked < _FINEST * gsd:
        raise InputError(
            f"{option} {asked:g} is far below the GSD of the cloud, {gsd:.3g}: "
            f"choose {nice_above(gsd):g} or more"
        )
    width, height = high[:2] - low[:2]
    if asked > max(width, height, gsd):
        raise InputError(
            f"{option} {asked:g} is larger than the whole cloud, {width:.4g} x {height:.4g}: "
            "choose less"
        )
    if (width / asked + 1) * (height / asked + 1) > _MOST_CELLS:
        raise InputError(
            f"{option} {asked:g} makes too many cells of a cloud of {width:.4g} x {height:.4g}: "
            "choose more"
        )
    return Lattice(asked)


def nice_above(length: float) -> float:
    """The smallest number of few digits that is not below `length`: 0.12 for 0.1132."""
    power = 10.0 ** math.floor(math.log10(length))
    nice = next(step for step in _NICE if step * power >= length * (1 - 1e-6))
    return float(f"{nice * power:.2g}")
