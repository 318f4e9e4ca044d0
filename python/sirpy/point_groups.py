"""Points gathered by boxes of a lattice: what is nearest to a place, without a tree."""

from __future__ import annotations

from itertools import product

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

_AXIS = 1 << 20  # boxes along an axis, at most


class PointGroups:
    """Groups of the points that share a box of `size`, each with the means of its positions and values.

    Attributes:
        values: (groups, k).
    """

    def __init__(
        self, points: npt.NDArray[np.floating], values: npt.NDArray[np.generic], size: float
    ) -> None:
        """Takes points (n, 3), not all too far from each other (a million boxes), and values (n, k).

        The lattice has a node at the origin, whatever the points are.
        """
        self._size = size
        self._low = np.floor(points.min(axis=0) / size).astype(np.int64)
        self._keys, group, count = np.unique(
            self._key(self._box(points)), return_inverse=True, return_counts=True
        )

        def means(of: npt.NDArray[np.generic]) -> Floats:
            sums = [np.bincount(group, column, len(count)) for column in of.T]
            return np.column_stack(sums) / count[:, None] if sums else np.empty((len(count), 0))

        self._places, self.values = means(points), means(values)

    def nearest(self, places: npt.NDArray[np.floating]) -> tuple[Indices, Floats]:
        """For each place (n, 3) the group whose mean is nearest, and how far it is.

        Only the 27 boxes around a place are searched: all that is nearer than `size` is found; -1 and infinity
        where they hold nothing.
        """
        boxes = self._box(places)
        found, distance = np.full(len(places), -1), np.full(len(places), np.inf)
        for step in product((-1, 0, 1), repeat=3):
            key = self._key(boxes + step)
            at = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
            there = np.flatnonzero(self._keys[at] == key)
            away = np.linalg.norm(places[there] - self._places[at[there]], axis=1)
            nearer = away < distance[there]
            found[there[nearer]], distance[there[nearer]] = at[there[nearer]], away[nearer]
        return found, distance

    def _box(self, points: npt.NDArray[np.floating]) -> Indices:
        boxes: Indices = np.floor(points / self._size).astype(np.int64) - self._low
        return np.clip(boxes, -2, _AXIS - 4)

    @staticmethod
    def _key(boxes: Indices) -> Indices:
        x, y, z = (boxes + 2).T
        key: Indices = (x * _AXIS + y) * _AXIS + z
        return key
