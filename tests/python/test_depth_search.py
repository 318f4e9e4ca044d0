"""Between which depths stereo searches, on blocks whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import plane_scene
from sirpy.depth_search import searched_around, searched_everywhere, whole_range
from sirpy.errors import InputError
from sirpy.view_fields import ViewField, view_field

SCENE = plane_scene(count=5, width=800, height=600, points=8000)
NAME = "002.jpg"
SEEN = SCENE.observations[NAME]  # depths of 98 to 102
LEVEL = 2  # blocks of 128 have 32 x 32 pixels


@pytest.fixture
def field() -> ViewField:
    found = view_field(SCENE, NAME, num_sources=3)
    allowed = found.allowed.copy()
    allowed[0, 0] = 0  # nothing is matched there
    return ViewField(
        found.name, found.side, found.sources, allowed, found.min_depth, found.max_depth
    )


def test_whole_photographs_are_searched_for_what_stands_tall(field: ViewField) -> None:
    near, far = whole_range(SEEN)
    # Of 100 above the ground, something of 70 and a hole of 80.
    assert near < 30 and far > 180
    found = searched_everywhere(field, SEEN)
    known = field.allowed != 0
    np.testing.assert_array_equal(found.min_depth[known], np.float32(near))
    np.testing.assert_array_equal(found.max_depth[known], np.float32(far))
    np.testing.assert_array_equal(found.min_depth[~known], field.min_depth[~known])
    np.testing.assert_array_equal(found.allowed, field.allowed)
    assert found.min_depth.dtype == found.max_depth.dtype == np.float32


def test_what_a_user_knows_comes_first(field: ViewField) -> None:
    known = field.allowed != 0
    found = searched_everywhere(field, SEEN, (60.0, None))
    assert (found.min_depth[known] == 60).all()
    assert (found.max_depth[known] == np.float32(whole_range(SEEN)[1])).all()
    found = searched_everywhere(field, SEEN, (None, 120.0))
    assert (found.max_depth[known] == 120).all()


def test_limits_that_leave_nothing_are_said(field: ViewField) -> None:
    with pytest.raises(
        InputError, match=r"^depths from 500 to 20\d\.\d are nothing that 002\.jpg can see"
    ):
        searched_everywhere(field, SEEN, (500.0, None))


def test_without_sources_there_is_nothing_to_search(field: ViewField) -> None:
    alone = ViewField(
        NAME,
        field.side,
        (),
        np.zeros_like(field.allowed),
        np.zeros_like(field.min_depth),
        np.zeros_like(field.max_depth),
    )
    nothing = type(SEEN)(SEEN.point[:0], SEEN.pixel[:0], SEEN.depth[:0])
    assert searched_everywhere(alone, nothing) is alone


def test_a_tower_that_was_found_is_searched_for_in_the_blocks_around(field: ViewField) -> None:
    depth = np.full((150, 200), 100, np.float32)
    depth[70:80, 110:120] = 40  # in row 2, column 3
    found = searched_around(field, depth, np.ones(depth.shape, bool), LEVEL)
    near = found.min_depth < 40
    expected = np.zeros_like(near)
    expected[1:4, 2:5] = True
    np.testing.assert_array_equal(near, expected)
    assert found.min_depth[2, 3] > 25  # a margin, and no more
    # What the sparse points expect stays in range.
    assert (found.min_depth <= field.min_depth).all()
    assert (found.max_depth >= field.max_depth).all()
    assert (found.max_depth < 140).all()
    assert found.min_depth.dtype == found.max_depth.dtype == np.float32


def test_what_no_source_confirms_is_not_searched_for(field: ViewField) -> None:
    depth = np.full((150, 200), 100, np.float32)
    depth[70:80, 110:120] = 40
    sure = depth != 40
    sure[72, 112:114] = True  # two in a thousand: too few
    depth[0, 0] = 0  # nothing was found there
    found = searched_around(field, depth, sure, LEVEL)
    assert (found.min_depth > 90)[field.allowed != 0].all()
    nothing = searched_around(field, depth, np.zeros(depth.shape, bool), LEVEL)
    np.testing.assert_array_equal(nothing.min_depth, field.min_depth)
    np.testing.assert_array_equal(nothing.max_depth, field.max_depth)


def test_blocks_without_a_source_stay_unknown(field: ViewField) -> None:
    found = searched_around(
        field, np.full((150, 200), 50, np.float32), np.ones((150, 200), bool), LEVEL
    )
    assert found.min_depth[0, 0] == field.min_depth[0, 0]


def test_a_map_smaller_than_a_block_is_no_special_case(field: ViewField) -> None:
    small = ViewField(
        NAME,
        128,
        field.sources,
        np.ones((1, 1), np.uint32),
        np.full((1, 1), 90, np.float32),
        np.full((1, 1), 110, np.float32),
    )
    found = searched_around(small, np.full((3, 4), 60, np.float32), np.ones((3, 4), bool), LEVEL)
    assert 55 < found.min_depth[0, 0] < 60 and found.max_depth[0, 0] == 110
