"""A mesh is cut exactly where the tile ends, and nothing is lost or doubled between tiles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_checks import plan_areas, tile_surface
from sirpy.frame import Floats
from sirpy.mesh_cutting import TileMesh, cut, open_edges
from sirpy.tiles import Tile

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def one_triangle(places: list[list[float]]) -> TileMesh:
    return TileMesh(
        np.array(places, np.float64),
        np.tile(np.array([0, 0, 1], np.float32), (3, 1)),
        np.array([[0, 0, 0], [200, 0, 0], [0, 100, 0]], np.uint8),
        np.zeros(3, np.uint8),
        np.array([[0, 1, 2]]),
    )


def test_a_triangle_across_a_side() -> None:
    mesh = cut(one_triangle([[0.5, 0.2, 0], [2.5, 0.2, 4], [0.5, 0.6, 0]]), SQUARE, 0.01)
    assert plan_areas(mesh.positions, mesh.faces).sum() == pytest.approx(0.4 * (1 - 0.75**2))
    on_side = mesh.positions[(mesh.sides & 0b10) > 0]
    assert np.allclose(on_side, [[1, 0.2, 1], [1, 0.5, 1]])
    colours = {tuple(colour) for colour in mesh.colours[(mesh.sides & 0b10) > 0].tolist()}
    assert colours == {(50, 0, 0), (50, 75, 0)}


def test_a_triangle_over_a_corner_knows_both_sides() -> None:
    mesh = cut(one_triangle([[-3, -3, 1], [3, -3, 1], [0.5, 5, 1]]), SQUARE, 0.01)
    assert plan_areas(mesh.positions, mesh.faces).sum() == pytest.approx(1)
    corners = {
        int(sides): tuple(place)
        for sides, place in zip(mesh.sides, mesh.positions[:, :2].round(9), strict=True)
    }
    assert corners[0b1001] == (0, 0) and corners[0b0011] == (1, 0) and corners[0b0110] == (1, 1)


def test_a_vertex_near_a_side_is_moved_onto_it() -> None:
    mesh = cut(one_triangle([[0.0004, 0.5, 0], [0.5, 0.2, 0], [0.5, 0.8, 0]]), SQUARE, 0.01)
    assert mesh.positions[:, 0].min() == 0 and len(mesh.faces) == 1
    assert mesh.sides[mesh.positions[:, 0] == 0].tolist() == [0b1000]


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 1000), st.floats(-0.6, 0.6))
def test_tiles_share_a_surface_without_gap_or_double(seed: int, slant: float) -> None:
    """Two quadrilaterals with a slanted side in common, cut of the same mesh."""
    low, high = [4 - slant, 0.0], [4 + slant, 6.0]
    left = np.array([[0.0, 0.0], low, high, [0.0, 6.0]])
    right = np.array([low, [9.0, 0.0], [9.0, 6.0], high])
    whole = Tile("whole", np.array([[-1.0, -1.0], [10.0, -1.0], [10.0, 7.0], [-1.0, 7.0]]))
    surface = tile_surface(whole, seed)
    pieces = [cut(surface, corners, 0.5) for corners in (left, right)]
    for piece, corners in zip(pieces, (left, right), strict=True):
        areas = plan_areas(piece.positions, piece.faces)
        assert (areas > -1e-9).all()
        assert areas.sum() == pytest.approx(area(corners), rel=2e-3)  # vertices moved onto the side
        edges, _ = open_edges(piece.faces)
        assert piece.sides[edges].all()  # all that is open lies on a side
    assert sum(plan_areas(piece.positions, piece.faces).sum() for piece in pieces) == pytest.approx(
        54, rel=1e-9
    )


def area(corners: Floats) -> float:
    x, y = corners.T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)
