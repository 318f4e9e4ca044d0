"""The plan: amounts of memory, and the coarsest grid that fits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import plane_scene
from sirpy.errors import BudgetError, InputError
from sirpy.memory import parse_memory
from sirpy.planning import grid_for_memory, plan
from sirpy.rectangle import Grid


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("8GB", 8_000_000_000),
        ("500MB", 500_000_000),
        ("1.5 GB", 1_500_000_000),
        ("2GiB", 2 * 1024**3),
        ("4g", 4_000_000_000),
        ("8000000000", 8_000_000_000),
    ],
)
def test_parse_memory(text: str, expected: int) -> None:
    assert parse_memory(text) == expected


@pytest.mark.parametrize("text", ["", "lots", "-1GB", "8XB", "GB"])
def test_parse_memory_refuses(text: str) -> None:
    with pytest.raises(InputError, match="is not an amount of memory"):
        parse_memory(text)


def test_less_memory_takes_a_finer_grid_with_a_lower_peak() -> None:
    scene = plane_scene(count=5, width=4000, height=3000)
    whole = plan(scene, memory=None)
    assert whole.grid == Grid(1, 1)
    half = plan(scene, memory=whole.peak // 2)
    assert half.grid.columns * half.grid.rows > 1
    assert half.peak <= whole.peak // 2


def test_a_budget_that_cannot_be_met_says_the_least_that_would_do() -> None:
    scene = plane_scene(count=5, width=4000, height=3000)
    with pytest.raises(BudgetError, match="least that would do is") as caught:
        plan(scene, memory=100_000_000)
    least = parse_memory(str(caught.value).split("would do is ")[1].split(",")[0])
    assert plan(scene, memory=least).peak <= least


def test_a_given_grid_is_kept_or_refused() -> None:
    scene = plane_scene(count=5, width=4000, height=3000)
    assert plan(scene, memory=None, grid=Grid(3, 2)).grid == Grid(3, 2)
    with pytest.raises(BudgetError, match="grid of 1x1 sub-images needs"):
        plan(scene, memory=600_000_000, grid=Grid(1, 1))


@given(st.integers(300, 20_000), st.integers(300, 20_000), st.floats(1e8, 1e11))
def test_grid_for_memory_fits(width: int, height: int, memory: float) -> None:
    grid = grid_for_memory([(width, height)], int(memory))
    areas = [core.area for _, _, core in grid.cores(width, height)]
    assert 200 * np.max(areas) <= memory
