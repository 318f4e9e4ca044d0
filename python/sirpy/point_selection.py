"""The points of a cloud, whole or of one tile, as they are or thinned to a spacing: some thousand at a time.

Thinning keeps the best point of each cube of a lattice that is fixed in the frame, so the result depends neither on
the order of the points nor on the tiles. The ground is worked off in square blocks of about a million points.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from sirpy.cloud import POINT, Cloud, Points, positions
from sirpy.errors import InputError
from sirpy.frame import Floats
from sirpy.progress import Steps
from sirpy.tiles import Tile, Tiling

_BLOCK = 1000.0  # GSD along its side: a million points where each pixel gives one
_MOST_TILES = 100_000
_TILE_MARGIN = (
    0.01  # of a tile: its sides are straight in the frame, those of a quadkey are not quite
)


class PointSelection:
    """The points of `cloud`, at most one in each cube of `spacing`; all of them if it is None."""

    def __init__(self, cloud: Cloud, spacing: float | None = None) -> None:
        """Raises InputError where the spacing is no length."""
        if spacing is not None and not 0 < spacing < float("inf"):
            raise InputError(f"--spacing {spacing:g} is not possible: give a length such as 0.1")
        self.cloud = cloud
        self._spacing = spacing
        wanted = _BLOCK * cloud.gsd
        extent = float((cloud.high - cloud.low)[:2].max())
        self._cube = spacing or wanted or extent or 1.0
        self._cubes = max(1, round(wanted / self._cube))  # along a block

    def all(self, steps: Steps) -> Iterator[Points]:
        """The points of the whole cloud; `steps` counts those that were looked at."""
        blocks = (self._block(block) for block in self._blocks)
        for points in self.cloud.runs() if self._spacing is None else blocks:
            yield self._thinned(points)
            steps.advance(len(points))

    def of(self, tile: Tile) -> Iterator[Points]:
        """The points that belong to a tile."""
        x0, y0, x1, y1 = tile.bounds
        for block, (left, bottom, right, top) in self._blocks.items():
            if left <= x1 and right >= x0 and bottom <= y1 and top >= y0:
                points = self._thinned(self._block(block))
                yield points[tile.contains(positions(points)[:, :2])]

    def tiles(self, tiling: Tiling) -> list[Tile]:
        """The tiles that may have a point, from the south-west on."""
        found: dict[str, Tile] = {}
        for x0, y0, x1, y1 in self._blocks.values():
            left, bottom, right, top = next(tiling.tiles(x0, y0, x1, y1)).bounds
            margin = _TILE_MARGIN * max(right - left, top - bottom)
            around = tiling.tiles(x0 - margin, y0 - margin, x1 + margin, y1 + margin)
            for tile in around:
                found[tile.name] = tile
                if len(found) > _MOST_TILES:
                    raise InputError(
                        f"--tiles makes more than {_MOST_TILES} tiles: choose larger ones"
                    )
        return sorted(found.values(), key=lambda tile: (tile.bounds[1], tile.bounds[0]))

    @cached_property
    def _blocks(self) -> dict[tuple[int, int], tuple[float, float, float, float]]:
        """(x0, y0, x1, y1) around the points of each block, by column and row; a far outlier costs one
        block, not all between."""
        found: dict[tuple[int, int], tuple[float, float, float, float]] = {}
        nowhere = (np.inf, np.inf, -np.inf, -np.inf)
        for points in self.cloud.runs():
            places = positions(points)[:, :2]
            blocks = self._cubes_of(places) // self._cubes
            for column, row in set(map(tuple, blocks.tolist())):
                here = places[(blocks == (column, row)).all(axis=1)]
                x0, y0, x1, y1 = found.get((column, row), nowhere)
                (left, bottom), (right, top) = here.min(axis=0), here.max(axis=0)
                around = min(x0, left), min(y0, bottom), max(x1, right), max(y1, top)
                found[column, row] = around
        return dict(sorted(found.items()))

    def _cubes_of(self, places: Floats) -> npt.NDArray[np.int64]:
        return np.floor(places / self._cube).astype(np.int64)

    def _block(self, block: tuple[int, int]) -> Points:
        side = self._cube * self._cubes
        margin = 1e-6 * side  # whose a point on the border is, the lattice decides
        x0, y0 = (index * side - margin for index in block)
        points = self.cloud.inside(x0, y0, x0 + side + 2 * margin, y0 + side + 2 * margin)
        here = (self._cubes_of(positions(points)[:, :2]) // self._cubes == block).all(axis=1)
        inside: Points = points[here]
        return inside

    def _thinned(self, points: Points) -> Points:
        if self._spacing is None:
            return points
        best: Points = points[_best(points, self._cubes_of(positions(points)))]
        return best


def _best(points: Points, cubes: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """The index of the best point of each cube (n, 3): the finest GSD or, if that is more, standard deviation, then
    the highest confidence, then by all else that a point has, since the order of the points must not matter."""
    rank = np.stack([np.maximum(points["gsd"], points["sigma"]), -points["confidence"]])
    order, first = _sorted(cubes, rank)
    best = rank[:, order[first]][:, np.cumsum(first) - 1]
    tied: npt.NDArray[np.int64] = order[(rank[:, order] == best).all(axis=0)]
    if len(tied) > first.sum():
        rest = [points[name][tied] for name in POINT.names or ()]
        order, first = _sorted(cubes[tied], rest)
        tied = tied[order[first]]
    return tied


def _sorted(
    cubes: npt.NDArray[np.int64], ranks: Iterable[npt.NDArray[Any]]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """The order by cube, then by the first rank, the next ..., and which of the ordered are the first of
    their cube."""
    order = np.lexsort([*reversed([*ranks]), *cubes.T])
    first = np.ones(len(order), bool)
    first[1:] = (cubes[order[1:]] != cubes[order[:-1]]).any(axis=1)
    return order, first
