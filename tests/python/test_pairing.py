"""Which pairs are matched."""

from __future__ import annotations

import numpy as np
import pytest
from sirpy.pairing import all_pairs, chosen_matcher, sequential_pairs, spatial_pairs

HERE = (45.0, 7.0)


@pytest.mark.parametrize(
    ("positions", "expected"),
    [
        ([None] * 60, "exhaustive"),
        ([HERE] * 60, "exhaustive"),
        ([HERE] * 61, "spatial"),
        ([*[HERE] * 99, None], "sequential"),
    ],
)
def test_the_matcher_follows_from_number_and_positions(
    positions: list[tuple[float, float] | None], expected: str
) -> None:
    assert chosen_matcher("auto", positions) == expected
    assert chosen_matcher("exhaustive", positions) == "exhaustive"


def test_all_pairs_are_all() -> None:
    assert all_pairs(4) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]


def test_with_positions_neighbours_are_matched_on_the_ground_not_in_degrees() -> None:
    # A grid of 20 x 20 at 60 degrees north, where a degree of longitude is half as long as one of
    # latitude.
    step = 1e-3
    positions = [
        (60 + step * row, 7 + 2 * step * column) for row in range(20) for column in range(20)
    ]
    pairs = set(spatial_pairs(positions))
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


def test_flight_lines_without_positions_find_each_other_by_their_looks() -> None:
    # Four lines of 40 photographs, flown to and fro; each sees a window of the features of the
    # ground, with some noise, and neighbours on two lines see the same.
    random = np.random.default_rng(1)
    ground = random.integers(0, 256, (44, 40, 128)).astype(np.float64)
    descriptors, places = [], []
    for line in range(4):
        for step in range(40):
            along = step if line % 2 == 0 else 39 - step
            seen = np.concatenate([ground[along : along + 5].reshape(-1, 128)])
            kept = seen[random.permutation(len(seen))[:150]]
            noisy = np.clip(kept + random.normal(0, 10, kept.shape), 0, 255)
            descriptors.append(noisy.astype(np.uint8))
            places.append((line, along))
    steps: list[int] = []
    pairs = sequential_pairs(descriptors, lambda: steps.append(1))
    assert len(steps) == 160
    assert {(i, i + 1) for i in range(159)} <= set(pairs)
    assert len(pairs) < 160 * 45 < 160 * 159 / 2
    # The same place on each two lines, 79 and fewer photographs apart by name.
    index = {place: i for i, place in enumerate(places)}
    across = {
        (min(index[a, along], index[b, along]), max(index[a, along], index[b, along]))
        for along in range(40)
        for a in range(4)
        for b in range(a)
    }
    assert across <= set(pairs)


def test_photographs_without_features_are_alike_to_none() -> None:
    empty = np.empty((0, 128), np.uint8)
    assert sequential_pairs([empty] * 3, lambda: None) == [(0, 1), (0, 2), (1, 2)]


def test_neighbours_are_the_same_everywhere_on_earth() -> None:
    """At the antimeridian too, where longitudes jump."""

    def pairs_at(longitude: float) -> list[tuple[int, int]]:
        line = longitude + 1e-4 * np.arange(-60, 60)
        return spatial_pairs([(10.0, float(x) if x <= 180 else float(x) - 360) for x in line])

    assert pairs_at(180.00003) == pairs_at(20.00003)
