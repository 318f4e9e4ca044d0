"""Sub-images for features: rectangles of the photograph as it is, each owning a core.

Cores cover every pixel once; a feature belongs to the sub-image whose core holds its centre. The
overlap is the reach of the largest features, so that they are found as in the whole photograph:
SIFT of `_OCTAVES` octaves has scales up to `largest_scale`, and a descriptor with the blur under it
reaches 16 times its scale. Sub-images begin on multiples of `_LATTICE`, since the pixels of the
coarsest octave are those of the photograph at such steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from sirpy.errors import BudgetError, InputError
from sirpy.memory import gigabytes
from sirpy.rectangle import Rectangle

_OCTAVES = 4  # COLMAP's
_REACH = 16  # of a feature, in its scale
_LATTICE = 16  # pixels
_SMALLEST_CORE = 128  # pixels
# Beyond it, a smaller share of overlap weighs less than what other cores could do meanwhile.
_LARGEST_SIDE = 3072
_PROCESSES = 0.35e9  # bytes of the two, with the rows that are cut and the features that are held
_SIFT = {0: 95, -1: 330}  # bytes per pixel of one extractor, by first octave


@dataclass(frozen=True)
class FeatureTile:
    """`core`: the pixels that it owns; `stored`: those and the overlap, inside the photograph."""

    core: Rectangle
    stored: Rectangle


def largest_scale(first_octave: int) -> int:
    """Of a feature, in pixels."""
    return int(2 * 2 ** (first_octave + _OCTAVES))


def overlap(first_octave: int) -> int:
    """Pixels around a core that its features depend on."""
    return _REACH * largest_scale(first_octave)


def tile_side(memory: int, first_octave: int) -> int:
    """The longest side of a sub-image, in pixels, that `memory` bytes allow.

    Raises:
        BudgetError: not even the smallest fits.
    """
    side = min(_LARGEST_SIDE, math.isqrt(max(0, int(_budget(memory)) // _SIFT[first_octave])))
    least = _least_side(first_octave)
    if side < least:
        needed = _PROCESSES + _SIFT[first_octave] * least**2
        raise BudgetError(
            f"features need {gigabytes(needed)}, more than --memory allows ({gigabytes(memory)}): "
            "allow more" + ("" if first_octave == 0 else ", or give --first_octave 0")
        )
    return side


def check_tile_side(side: int, memory: int, first_octave: int) -> None:
    """Raises InputError or BudgetError unless sub-images of that longest side are possible."""
    least = _least_side(first_octave)
    if side < least:
        raise InputError(
            f"--tile {side} is not possible: with {overlap(first_octave)} pixels of overlap on "
            f"each side it must be {least} or more"
        )
    if _SIFT[first_octave] * side**2 > _budget(memory):
        needed = _PROCESSES + _SIFT[first_octave] * side**2
        raise BudgetError(
            f"features in sub-images of {side}x{side} pixels need {gigabytes(needed)}, more than "
            f"--memory allows ({gigabytes(memory)}): allow more, or give a smaller --tile"
        )


def extractors(tiles: list[FeatureTile], memory: int, first_octave: int) -> int:
    """Sub-images whose features can be found at once; at least one."""
    largest = max(tile.stored.area for tile in tiles)
    return max(1, int(_budget(memory) // (_SIFT[first_octave] * largest)))


def feature_tiles(width: int, height: int, side: int, first_octave: int) -> list[FeatureTile]:
    """The sub-images of a photograph, row by row, none longer than `side`."""
    margin, whole = overlap(first_octave), Rectangle(0, 0, width, height)
    cores = [
        Rectangle.from_corners(x0, y0, x1, y1)
        for y0, y1 in _pieces(height, side, margin)
        for x0, x1 in _pieces(width, side, margin)
    ]
    return [FeatureTile(core, core.padded(margin).intersection(whole)) for core in cores]


def _pieces(length: int, side: int, margin: int) -> list[tuple[int, int]]:
    """The fewest even pieces that are no longer than `side` with their margins."""
    count = 1
    while True:
        cuts = [round(i * length / count / _LATTICE) * _LATTICE for i in range(count)] + [length]
        pieces = list(pairwise(cuts))
        if all(min(end + margin, length) - max(0, begin - margin) <= side for begin, end in pieces):
            return pieces
        count += 1


def _least_side(first_octave: int) -> int:
    return _SMALLEST_CORE + 2 * overlap(first_octave)


def _budget(memory: int) -> float:
    return memory - _PROCESSES
