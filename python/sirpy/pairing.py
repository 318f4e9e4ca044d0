"""Which pairs of photographs are matched."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pycolmap
from numpy.typing import NDArray

from sirpy.sfm_options import Matcher

Pairs = list[tuple[int, int]]  # of indices of photographs, the smaller first
Position = tuple[float, float]  # latitude and longitude, degrees

# All pairs cost count^2 / 2 times 0.5 CPU s: 15 minutes on one core for 60 photographs.
ALL_PAIRS = 60
NEIGHBOURS = 30  # nearest, or most alike, photographs that each is matched with, beyond that number
_SEQUENCE = 5  # and those before and after it, where positions are known
_OVERLAP = 10  # the same, where they are not; and those at distances of powers of two
COARSEST = 300  # features of a photograph that tell what it looks like
_RATIO = 0.8  # of the distances to the most similar feature and to the next


def chosen_matcher(matcher: Matcher, positions: Sequence[Position | None]) -> Matcher:
    """What `auto` means for photographs at these positions."""
    if matcher != "auto":
        return matcher
    if len(positions) <= ALL_PAIRS:
        return "exhaustive"
    return "sequential" if None in positions else "spatial"


def all_pairs(count: int) -> Pairs:
    return [(i, j) for i in range(count) for j in range(i + 1, count)]


def spatial_pairs(positions: Sequence[Position]) -> Pairs:
    """Near neighbours on the ground, and by sequence."""
    count = len(positions)
    on_ground = np.column_stack([np.array(positions), np.zeros(count)])
    metres: NDArray[np.float64] = pycolmap.GPSTransform().ellipsoid_to_ecef(on_ground)
    pairs = {(i, j) for i in range(count) for j in range(i + 1, min(count, i + 1 + _SEQUENCE))}
    for i in range(count):
        distance = np.linalg.norm(metres - metres[i], axis=1)
        for j in np.argsort(distance, kind="stable")[: NEIGHBOURS + 1].tolist():
            if i != j:
                pairs.add((min(i, j), max(i, j)))
    return sorted(pairs)


def sequential_pairs(
    descriptors: Sequence[NDArray[np.uint8]], advance: Callable[[], None]
) -> Pairs:
    """Neighbours by sequence, and wherever photographs look alike: other flight lines, loops.

    The likeness of two photographs is the number of their coarsest features that are each other's
    most similar (preemptive matching; Wu, Towards Linear-time Incremental Structure from Motion,
    3DV 2013), which needs no trained vocabulary: some ms a pair.

    Args:
        descriptors: SIFT of the `COARSEST` coarsest features of each photograph, (n, 128).
        advance: called once for each photograph.
    """
    count = len(descriptors)
    distances = {*range(1, _OVERLAP + 1), *(2**k for k in range(4, 10))}
    pairs = {(i, i + d) for i in range(count) for d in distances if i + d < count}
    directions = [_directions(of_image) for of_image in descriptors]
    likeness = np.zeros((count, count), np.int32)
    for i in range(count):
        for j in range(i + 1, count):
            likeness[i, j] = likeness[j, i] = _alike(directions[i], directions[j])
        advance()
    for i in range(count):
        for j in np.argsort(-likeness[i], kind="stable")[:NEIGHBOURS].tolist():
            if likeness[i, j] > 0:
                pairs.add((min(i, j), max(i, j)))
    return sorted(pairs)


def _directions(descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    values = descriptors.astype(np.float32)
    length = np.linalg.norm(values, axis=1, keepdims=True)
    return np.asarray(values / np.maximum(length, 1), np.float32)


def _alike(a: NDArray[np.float32], b: NDArray[np.float32]) -> int:
    """Features of `a` and `b` that are each other's nearest, and clearly nearer than the next."""
    if min(len(a), len(b)) < 2:
        return 0
    cosine = a @ b.T
    nearest = cosine.argmax(axis=1)
    rows = np.arange(len(a))
    mutual = cosine.argmax(axis=0)[nearest] == rows
    best = cosine[rows, nearest]
    cosine[rows, nearest] = -1
    squares = 2 - 2 * np.minimum(np.stack([best, cosine.max(axis=1)]), 1)  # of unit vectors
    return int((mutual & (squares[0] < _RATIO**2 * squares[1])).sum())
