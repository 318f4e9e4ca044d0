"""Tiles of the ground: squares of a metric grid, or Bing's tiles by quadkey, as quadrilaterals of the frame.

Every place belongs to exactly one tile: what lies on a border belongs to one side of it, and both sides
decide by the same sum.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sirpy.errors import InputError
from sirpy.frame import Floats, Frame

_QUADKEY = "quadkey:"
_LEVELS = range(1, 24)


@dataclass(frozen=True, eq=False)
class Tile:
    """A convex quadrilateral: `corners` (4, 2), counter-clockwise from the south-west, x and y of the frame."""

    name: str
    corners: Floats

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(x0, y0, x1, y1) around it."""
        (x0, y0), (x1, y1) = self.corners.min(axis=0), self.corners.max(axis=0)
        return float(x0), float(y0), float(x1), float(y1)

    def contains(self, xy: Floats) -> npt.NDArray[np.bool_]:
        """Which of the places (n, 2) belong to it."""
        inside = np.ones(len(xy), bool)
        for begin, end in zip(self.corners, np.roll(self.corners, -1, axis=0), strict=True):
            forward = tuple(begin) < tuple(end)
            low, high = (begin, end) if forward else (end, begin)
            along, out = high - low, xy - low
            left = along[0] * out[:, 1] - along[1] * out[:, 0] >= 0
            inside &= left if forward else ~left
        return inside


class Tiling(Protocol):
    """A way to cut the ground into tiles."""

    def tiles(self, x0: float, y0: float, x1: float, y1: float) -> Iterator[Tile]:
        """Those that touch a rectangle of the frame, from south to north and west to east."""


def tiling(text: str, frame: Frame) -> Tiling:
    """The tiling that a user named.

    Args:
        text: "quadkey:19", Bing's tiles of that level, or a length in the unit of the frame, "250".

    Raises:
        InputError: it is neither; or quadkeys of a frame without a CRS.
    """
    if text.startswith(_QUADKEY):
        level = text.removeprefix(_QUADKEY)
        if not (level.isdecimal() and int(level) in _LEVELS):
            raise InputError(
                f"--tiles {text} is not possible: choose a level from {_LEVELS[0]} to {_LEVELS[-1]}, "
                "such as quadkey:19"
            )
        if frame.crs is None:
            raise InputError(
                f"--tiles {text} needs a place on the Earth: run `sirpy georeference` first, or give a "
                "length such as --tiles 100"
            )
        return QuadkeyTiling(int(level), frame.crs)
    try:
        side = float(text)
    except ValueError:
        side = 0.0
    if not 0 < side < float("inf"):
        raise InputError(f"--tiles {text} is no tiling: give a length such as 100, or quadkey:19")
    return GridTiling(side)


@dataclass(frozen=True)
class GridTiling:
    """Squares whose corners lie on multiples of `side`; named by the lower left one, in sides."""

    side: float

    def tiles(self, x0: float, y0: float, x1: float, y1: float) -> Iterator[Tile]:
        columns = range(int(np.floor(x0 / self.side)), int(np.floor(x1 / self.side)) + 1)
        rows = range(int(np.floor(y0 / self.side)), int(np.floor(y1 / self.side)) + 1)
        for row in rows:
            for column in columns:
                low, high = np.array([column, row]), np.array([column + 1, row + 1])
                corners = [low, (high[0], low[1]), high, (low[0], high[1])]
                yield Tile(f"x{column}_y{row}", np.array(corners, np.float64) * self.side)


class QuadkeyTiling:
    """Bing's tiles (Web Mercator, https://learn.microsoft.com/bingmaps/articles/bing-maps-tile-system) of a level."""

    def __init__(self, level: int, crs: str) -> None:
        from pyproj import Transformer

        self.level = level
        self._frame_from_degrees = Transformer.from_crs("EPSG:4326", crs, always_xy=True)

    def tiles(self, x0: float, y0: float, x1: float, y1: float) -> Iterator[Tile]:
        import mercantile

        west, south, east, north = self._frame_from_degrees.transform_bounds(
            x0, y0, x1, y1, direction="INVERSE"
        )
        touched = list(mercantile.tiles(west, south, east, north, self.level))
        for one in sorted(touched, key=lambda tile: (-tile.y, tile.x)):
            yield Tile(mercantile.quadkey(one), self._corners(one.x, one.y))

    def _corners(self, x: int, y: int) -> Floats:
        """From the corners of the level's lattice, so that neighbours have the same."""
        import mercantile

        around = [(x, y + 1), (x + 1, y + 1), (x + 1, y), (x, y)]
        degrees = [mercantile.ul(column, row, self.level) for column, row in around]
        moved = self._frame_from_degrees.transform(
            [place.lng for place in degrees], [place.lat for place in degrees]
        )
        return np.column_stack(moved)
