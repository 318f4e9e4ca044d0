"""The cells that rasters share."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sirpy.errors import InputError
from sirpy.lattice import Lattice, aligned_blocks, choose_lattice, nice_above
from sirpy.rectangle import Rectangle

LOW, HIGH = np.array([0.0, 0.0, 0.0]), np.array([100.0, 50.0, 9.0])
cells = st.integers(-500, 500)


@given(st.floats(1e-4, 1e4))
def test_a_nice_number_is_a_little_above(length: float) -> None:
    nice = nice_above(length)
    assert length * (1 - 1e-5) <= nice <= 1.35 * length
    assert nice_above(nice) == nice


@given(st.sampled_from([0.05, 0.1, 0.12, 0.25, 3.0]), cells, cells, st.integers(1, 40))
def test_a_cell_holds_its_centre_whatever_the_window(
    cell: float, column: int, row: int, size: int
) -> None:
    lattice = Lattice(cell)
    window = Rectangle(column, row, size, 2)
    centres = lattice.centres(window)
    assert centres.shape == (2, size, 2)
    x, y = centres[1, size - 1]
    assert lattice.around(x, y, x, y) == Rectangle(column + size - 1, row + 1, 1, 1)
    single = lattice.centres(Rectangle(column + size - 1, row + 1, 1, 1))
    assert tuple(single[0, 0]) == (x, y)  # to the last bit
    x0, y0, x1, y1 = lattice.box(window)
    assert x0 < centres[..., 0].min() and centres[..., 0].max() < x1
    assert y0 < centres[..., 1].min() and centres[..., 1].max() < y1


@given(cells, cells, st.integers(1, 90), st.integers(1, 90), st.integers(1, 64))
def test_blocks_cover_a_window_once(x0: int, y0: int, width: int, height: int, side: int) -> None:
    window = Rectangle(x0, y0, width, height)
    blocks = list(aligned_blocks(window, side))
    assert sum(block.intersection(window).area for block in blocks) == window.area
    assert len(set(blocks)) == len(blocks)
    assert all(block.x0 % side == 0 and block.y0 % side == 0 for block in blocks)


@pytest.mark.parametrize("asked", [0.0, -1.0, float("nan"), float("inf"), 0.001, 200.0])
def test_an_absurd_resolution_is_refused(asked: float) -> None:
    with pytest.raises(InputError, match=r"--resolution.* (choose|give) "):
        choose_lattice(asked, 0.1, LOW, HIGH)


def test_too_many_cells_and_an_unknown_gsd_are_refused() -> None:
    with pytest.raises(InputError, match="too many cells"):
        choose_lattice(None, 1e-6, LOW, HIGH)
    with pytest.raises(InputError, match="GSD of the cloud is not known: give --resolution"):
        choose_lattice(None, 0.0, LOW, HIGH)
    assert choose_lattice(0.5, 0.0, LOW, HIGH).cell == 0.5
    assert choose_lattice(None, 0.113, LOW, HIGH).cell == 0.12
