"""Grids, even and uneven: every pixel of a rectangle has one owner."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sirpy.errors import InputError
from sirpy.rectangle import Grid, Rectangle


@st.composite
def grids_and_rectangles(draw: st.DrawFn) -> tuple[Grid, Rectangle]:
    """Any rectangle, also of one pixel, with a grid that fits: even, or cut anywhere, on each side."""
    begin = [draw(st.integers(0, 50)) for _ in range(2)]
    size = [draw(st.integers(1, 40)) for _ in range(2)]
    counts: list[int] = []
    cuts: list[tuple[int, ...]] = []
    for low, length in zip(begin, size, strict=True):
        inner = st.integers(low + 1, low + length - 1) if length > 1 else st.nothing()
        cut = draw(st.sets(inner, max_size=6)) if length > 1 and draw(st.booleans()) else set()
        cuts.append(tuple(sorted(cut)))
        counts.append(len(cut) + 1 if cut else draw(st.integers(1, length)))
    grid = Grid.with_cuts(*cuts, columns=counts[0], rows=counts[1])
    return grid, Rectangle(*begin, *size)


@given(grids_and_rectangles())
def test_tiles_own_every_pixel_once(case: tuple[Grid, Rectangle]) -> None:
    grid, rectangle = case
    owners = np.zeros((rectangle.height, rectangle.width), int)
    tiles = list(grid.tiles(rectangle))
    for _, _, core in tiles:
        assert core.area > 0
        owners[core.slices_in(rectangle)] += 1
    assert (owners == 1).all()
    places = [(row, column) for row, column, _ in tiles]
    assert places == [(row, column) for row in range(grid.rows) for column in range(grid.columns)]
    assert set(grid.column_cuts) <= {core.x0 for _, _, core in tiles}
    assert set(grid.row_cuts) <= {core.y0 for _, _, core in tiles}


@given(st.integers(1, 60), st.integers(1, 60), st.data())
def test_even_parts_differ_by_one_pixel(width: int, height: int, data: st.DataObject) -> None:
    grid = Grid(data.draw(st.integers(1, width)), data.draw(st.integers(1, height)))
    cores = [core for _, _, core in grid.cores(width, height)]
    for side in ({core.width for core in cores}, {core.height for core in cores}):
        assert max(side) - min(side) <= 1


def test_cuts_are_native_pixels_also_in_a_region() -> None:
    grid = Grid.with_cuts((30, 80), rows=2)
    assert [core for _, _, core in grid.tiles(Rectangle(20, 10, 70, 4))] == [
        Rectangle(20, 10, 10, 2),
        Rectangle(30, 10, 50, 2),
        Rectangle(80, 10, 10, 2),
        Rectangle(20, 12, 10, 2),
        Rectangle(30, 12, 50, 2),
        Rectangle(80, 12, 10, 2),
    ]


@pytest.mark.parametrize("cuts", [(0,), (-3,), (20, 20), (20, 10)])
def test_cuts_that_are_not_ascending_are_refused(cuts: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="are not possible"):
        Grid.with_cuts(cuts)


def test_cuts_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match="make 3 rows, not 2"):
        Grid.with_cuts(row_cuts=(20, 30), rows=2)
    for cut in (20, 90, 100):
        with pytest.raises(InputError, match=f"column cut at {cut} is outside"):
            list(Grid.with_cuts((cut,)).tiles(Rectangle(20, 10, 70, 4)))


RECTANGLES = st.builds(
    Rectangle, st.integers(-99, 99), st.integers(-99, 99), st.integers(1, 99), st.integers(1, 99)
)


@given(RECTANGLES, st.integers(1, 40))
def test_aligned_is_the_smallest_that_begins_and_ends_on_steps(one: Rectangle, step: int) -> None:
    found = one.aligned(step)
    assert found.contains(one) and found.aligned(step) == found
    assert not any(side % step for side in (found.x0, found.y0, found.x1, found.y1))
    assert one.x0 - found.x0 < step and one.y0 - found.y0 < step
    assert found.x1 - one.x1 < step and found.y1 - one.y1 < step


@given(RECTANGLES, st.integers(1, 40))
def test_halves_tile_a_rectangle_across_its_longer_side(one: Rectangle, step: int) -> None:
    whole = one.aligned(step)
    first, second = whole.halves(step)
    assert first.aligned(step) == first and second.aligned(step) == second
    assert first.area + second.area == whole.area and not first.intersection(second).area
    if whole.width >= whole.height:
        assert (first.height, second.height) == (whole.height, whole.height)
        assert 0 <= second.width - first.width <= step
    else:
        assert (first.width, second.width) == (whole.width, whole.width)
        assert 0 <= second.height - first.height <= step
