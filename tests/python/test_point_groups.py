"""Nearest groups of points, beside a plain search."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from sirpy.point_groups import PointGroups


@given(st.integers(0, 1000), st.sampled_from([0.3, 1.0, 50.0]))
def test_the_nearest_group_is_found_where_it_is_near(seed: int, size: float) -> None:
    random = np.random.default_rng(seed)
    points = random.uniform(-3, 3, (200, 3)).astype(np.float32)
    places = random.uniform(-5, 5, (50, 3))
    groups = PointGroups(points, points, size)
    found, distance = groups.nearest(places)
    away = np.linalg.norm(places[:, None] - groups.values, axis=2)
    near = away.min(axis=1) < size
    assert np.allclose(distance[near], away.min(axis=1)[near], atol=1e-5)
    assert np.array_equal(found[near], away.argmin(axis=1)[near])
    assert (found[~np.isfinite(distance)] == -1).all()


def test_groups_are_the_same_whatever_else_there_is() -> None:
    """Neighbouring tiles see the same groups in the points that they share."""
    random = np.random.default_rng(0)
    points = random.uniform(0, 8, (500, 3)).astype(np.float32)
    shared = (points[:, 0] >= 4) & (points[:, 0] < 6)
    some = PointGroups(points[points[:, 0] < 6], points[points[:, 0] < 6], 1.0)
    others = PointGroups(points[points[:, 0] >= 4], points[points[:, 0] >= 4], 1.0)
    place = points[shared]
    a, b = some.nearest(place), others.nearest(place)
    inner = (place[:, 0] > 5) & (place[:, 0] < 5.5)
    assert inner.any() and np.allclose(a[1][inner], b[1][inner], atol=1e-5)
