"""Which pairs are matched; the whole is tested in test_sparse_model.py."""

from __future__ import annotations

import numpy as np
from sirpy.structure_from_motion import _pairs


def test_a_small_set_is_matched_exhaustively() -> None:
    assert _pairs([None] * 4) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    assert len(_pairs([(45.0, 7.0)] * 60)) == 60 * 59 // 2


def test_without_all_positions_every_pair_is_matched() -> None:
    positions: list[tuple[float, float] | None] = [(45.0, 7.0)] * 99
    assert len(_pairs([*positions, None])) == 100 * 99 // 2


def test_with_positions_neighbours_are_matched_on_the_ground_not_in_degrees() -> None:
    # A grid of 20 x 20 at 60 degrees north, where a degree of longitude is half as long as one of
    # latitude.
    step = 1e-3
    positions = [
        (60 + step * row, 7 + 2 * step * column) for row in range(20) for column in range(20)
    ]
    pairs = set(_pairs(list(positions)))
    assert pairs == set(_pairs(list(positions)))
    assert all(i < j for i, j in pairs)
    assert len(pairs) < 400 * 40
    middle = 10 * 20 + 10
    near = {
        (10 + row) * 20 + 10 + column
        for row in range(-2, 3)
        for column in range(-2, 3)
        if (row, column) != (0, 0)
    }
    partners = {j if i == middle else i for i, j in pairs if middle in (i, j)}
    assert near <= partners
    offsets = np.array([divmod(p, 20) for p in partners]) - 10
    assert np.abs(offsets[:, 0]).max() <= 5 and np.abs(offsets[:, 1]).max() <= 5
