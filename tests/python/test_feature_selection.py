"""The cap on features: even over the photograph, and the same however the features arrive."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from sirpy.feature_selection import Features, spread

SIZE = (400, 300)


def made(count: int, seed: int, *, left: float = 0.0, right: float = 400.0) -> Features:
    random = np.random.default_rng(seed)
    keypoints = np.zeros((count, 6), np.float32)
    keypoints[:, 0] = random.uniform(left, right, count)
    keypoints[:, 1] = random.uniform(0, SIZE[1], count)
    keypoints[:, 2] = random.integers(2, 9, count)  # many of equal scale
    return Features(keypoints, random.integers(0, 255, (count, 128)).astype(np.uint8))


def same(one: Features, other: Features) -> bool:
    return np.array_equal(one.keypoints, other.keypoints) and np.array_equal(
        one.descriptors, other.descriptors
    )


@given(
    st.integers(0, 300),
    st.integers(1, 150),
    st.lists(st.integers(0, 300), max_size=4),
    st.integers(0, 99),
)
@settings(max_examples=100, deadline=None)
def test_parts_give_what_the_whole_gives(count: int, most: int, cuts: list[int], seed: int) -> None:
    every = made(count, seed)
    whole = spread(every, SIZE, most)
    assert len(whole) == min(count, most)
    kept = Features.none()
    order = np.random.default_rng(seed).permutation(count)
    for part in np.split(order, sorted(min(cut, count) for cut in cuts)):
        kept = spread(kept.joined(every.taken(part)), SIZE, most)
    assert same(kept, whole)


def test_without_a_cap_all_stay_the_largest_first() -> None:
    every = made(50, 1)
    kept = spread(every, SIZE, 50)
    assert len(kept) == 50 and np.all(np.diff(kept.keypoints[:, 2]) <= 0)


def test_a_crowded_half_leaves_the_other_its_share() -> None:
    crowded, poor = made(5000, 1, right=200.0), made(500, 2, left=200.0)
    kept = spread(crowded.joined(poor), SIZE, 800)
    right = np.count_nonzero(kept.keypoints[:, 0] >= 200)
    assert 350 <= right <= 400  # a few of its cells have less than their share


def test_what_a_poor_cell_leaves_goes_to_the_others() -> None:
    crowded, poor = made(5000, 1, right=200.0), made(10, 2, left=200.0)
    kept = spread(crowded.joined(poor), SIZE, 800)
    assert len(kept) == 800
    assert np.count_nonzero(kept.keypoints[:, 0] >= 200) == 10


def test_the_largest_of_a_cell_stay() -> None:
    every = made(3000, 3)
    kept = spread(every, SIZE, 300)
    assert kept.keypoints[:, 2].mean() > every.keypoints[:, 2].mean() + 2
