"""What a raster is made of, block by block in files of a folder: memory does not grow with the raster."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sirpy.lattice import Lattice, aligned_blocks
from sirpy.npy import open_npy, write_npy
from sirpy.rectangle import Rectangle


def held(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Which cells (height, width) of bands (b, height, width) hold something: a number, or an alpha (the last
    band) above 0."""
    last = values[-1]
    full: NDArray[np.bool_] = ~np.isnan(last) if last.dtype.kind == "f" else last > 0
    return full


class BlockStore:
    """Cells of a lattice with `bands` values each, kept in aligned blocks of side x side cells.

    Attributes:
        window: the cells around all that hold something; of no area where none does.
        cells: how many hold something.
    """

    def __init__(
        self, folder: Path, lattice: Lattice, side: int, bands: int, dtype: np.dtype[Any]
    ) -> None:
        self.lattice, self.side, self.bands, self.dtype = lattice, side, bands, dtype
        self.window = Rectangle(0, 0, 0, 0)
        self.cells = 0
        self._blocks: dict[Rectangle, None] = {}  # that hold something, as they were written
        self._folder = folder

    def write(self, block: Rectangle, values: NDArray[Any]) -> None:
        """Keeps a block (bands, side, side), unless it is empty. Raises OutputError."""
        full = held(values)
        rows, columns = np.flatnonzero(full.any(axis=1)), np.flatnonzero(full.any(axis=0))
        if len(rows) == 0:
            return
        write_npy(self._path(block), values)
        part = Rectangle.from_corners(
            block.x0 + int(columns[0]),
            block.y0 + int(rows[0]),
            block.x0 + int(columns[-1]) + 1,
            block.y0 + int(rows[-1]) + 1,
        )
        self.window = _around(self.window, part)
        self.cells += int(full.sum())
        self._blocks[block] = None

    def read(self, window: Rectangle) -> NDArray[Any]:
        """The values (bands, height, width) of any window; NaN or 0 where there are none."""
        empty = np.nan if self.dtype.kind == "f" else 0
        values = np.full((self.bands, window.height, window.width), empty, self.dtype)
        for block in aligned_blocks(window, self.side):
            if block in self._blocks:
                shape = (self.bands, self.side, self.side)
                stored = open_npy(self._path(block), self.dtype, shape, "the same command")
                part = block.intersection(window)
                slices = slice(None), *part.slices_in(block)
                values[(slice(None), *part.slices_in(window))] = stored[slices]
        return values

    def blocks(self, margin: int = 0) -> list[Rectangle]:
        """Those that hold something, and those that lie within `margin` cells of one; in a fixed order."""
        near: dict[Rectangle, None] = {}
        for block in self._blocks:
            near |= dict.fromkeys(aligned_blocks(block.padded(margin), self.side))
        return sorted(near, key=lambda block: (block.y0, block.x0))

    def touches(self, window: Rectangle) -> bool:
        """Whether a window may hold something."""
        return any(block in self._blocks for block in aligned_blocks(window, self.side))

    def _path(self, block: Rectangle) -> Path:
        return self._folder / f"{block.x0 // self.side}_{block.y0 // self.side}.npy"


def _around(one: Rectangle, other: Rectangle) -> Rectangle:
    if one.area == 0:
        return other
    return Rectangle.from_corners(
        min(one.x0, other.x0),
        min(one.y0, other.y0),
        max(one.x1, other.x1),
        max(one.y1, other.y1),
    )
