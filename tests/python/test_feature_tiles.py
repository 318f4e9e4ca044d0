"""Sub-images for features: every pixel owned once, overlaps whole, sizes as the memory allows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sirpy.errors import BudgetError, InputError
from sirpy.feature_tiles import check_tile_side, feature_tiles, overlap, tile_side
from sirpy.rectangle import Rectangle


@given(st.integers(1, 6000), st.integers(1, 3000), st.integers(640, 2000))
@settings(max_examples=100, deadline=None)
def test_every_pixel_has_one_owner_and_its_overlap(width: int, height: int, side: int) -> None:
    tiles = feature_tiles(width, height, side, -1)
    owners = np.zeros((height, width), np.uint8)
    whole = Rectangle(0, 0, width, height)
    for tile in tiles:
        owners[tile.core.slices_in(whole)] += 1
        assert tile.stored == tile.core.padded(overlap(-1)).intersection(whole)
        assert max(tile.stored.width, tile.stored.height) <= side
        assert tile.stored.x0 % 16 == tile.stored.y0 % 16 == 0
    assert owners.min() == owners.max() == 1


def test_a_small_photograph_is_not_cut() -> None:
    (tile,) = feature_tiles(1920, 1440, 1920, 0)
    assert tile.core == tile.stored == Rectangle(0, 0, 1920, 1440)


def test_more_memory_larger_sub_images() -> None:
    sides = [tile_side(memory, 0) for memory in (700_000_000, 1_000_000_000, 8_000_000_000)]
    assert sides[0] < sides[1] < sides[2]


@pytest.mark.parametrize("first_octave", [0, -1])
def test_too_little_memory_is_refused_with_what_is_needed(first_octave: int) -> None:
    with pytest.raises(BudgetError, match=r"features need 0\.\d\d GB, more than --memory allows"):
        tile_side(400_000_000, first_octave)


def test_a_side_that_cannot_be() -> None:
    with pytest.raises(InputError, match="it must be 1152 or more"):
        check_tile_side(1151, 8_000_000_000, 0)
    with pytest.raises(BudgetError, match="give a smaller --tile"):
        check_tile_side(4000, 1_000_000_000, 0)
    check_tile_side(1152, 1_000_000_000, 0)
