"""Polylines that are nearly the same find each other; what is not the same stays apart."""

from __future__ import annotations

import numpy as np
import pytest
from sirpy.frame import Floats
from sirpy.mesh_cutting import Indices
from sirpy.mesh_matching import match


def path(places: list[list[float]]) -> tuple[Floats, Indices]:
    return np.array(places), np.column_stack(
        [np.arange(len(places) - 1), np.arange(1, len(places))]
    )


def test_other_vertices_on_the_same_line() -> None:
    ours, ours_edges = path([[0, 0], [4, 0], [8, 0], [12, 0]])
    theirs, theirs_edges = path([[0.01, 0.1], [3, 0.1], [10, 0.1], [12, 0.1]])
    found = match(ours, ours_edges, theirs, theirs_edges, {})
    places = {vertex: place.edge + place.part for vertex, place in found.places.items()}
    assert places == pytest.approx({0: 0, 1: 0.75, 2: 2.5, 3: 3})  # the first is near enough
    assert {edge: inside for edge, inside in found.inserts.items() if inside} == {1: [1, 2]}


def test_the_other_direction_is_another_surface() -> None:
    ours, ours_edges = path([[0, 0], [4, 0]])
    theirs, theirs_edges = path([[4, 0.1], [0, 0.1]])
    assert not match(ours, ours_edges, theirs, theirs_edges, {}).places


def test_too_far_is_another_surface() -> None:
    ours, ours_edges = path([[0, 0], [4, 0]])
    theirs, theirs_edges = path([[0, 2.5], [4, 2.5]])
    assert not match(ours, ours_edges, theirs, theirs_edges, {}).places


def test_places_never_go_back() -> None:
    random = np.random.default_rng(0)
    x = np.arange(0, 30, 0.5)
    ours, ours_edges = path(np.column_stack([x, np.sin(x)]).tolist())
    x = np.arange(0, 29.5, 0.4)
    shaken = np.column_stack([x, np.sin(x)]) + random.normal(0, 0.3, (len(x), 2))
    theirs, theirs_edges = path(shaken.tolist())
    found = match(ours, ours_edges, theirs, theirs_edges, {})
    along = [found.places[v].edge + found.places[v].part for v in sorted(found.places)]
    assert len(along) > 0.9 * len(x) and along == sorted(along)
    inserted = [vertex for edge in sorted(found.inserts) for vertex in found.inserts[edge]]
    assert inserted == sorted(set(inserted))


def test_of_two_sheets_above_each_other_one_is_taken() -> None:
    """No edge may get a third face."""
    ours, ours_edges = path([[0, 0], [4, 0], [8, 0]])
    sheets = np.array([[0, 0.5], [8, 0.5], [0, 0.1], [8, 0.1]])
    found = match(ours, ours_edges, sheets, np.array([[0, 1], [2, 3]]), {})
    assert sorted(found.places) == [2, 3]


def test_beyond_the_end_only_the_next_vertex_moves() -> None:
    ours, ours_edges = path([[0, 0], [4, 0]])
    theirs, theirs_edges = path([[1, 0.1], [3, 0.1], [4.5, 0.1], [5.0, 0.1], [5.5, 0.1]])
    assert sorted(match(ours, ours_edges, theirs, theirs_edges, {}).places) == [0, 1, 2]


@pytest.mark.parametrize("turned", [0, 5])
@pytest.mark.parametrize("shift", [-0.1, 0.1])
def test_rings(turned: int, shift: float) -> None:
    """They are laid onto each other all around, wherever they begin."""
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.column_stack([10 + 3 * np.cos(turn), 3 * np.sin(turn)])
    edges = np.column_stack([np.arange(12), (np.arange(12) + 1) % 12])
    turn = turn + 0.2 + shift
    other = np.column_stack([10 + 3.1 * np.cos(turn), 3.1 * np.sin(turn)])
    found = match(ring, np.roll(edges, turned, axis=0), other, edges, {})
    assert sorted(found.places) == list(range(12))
    # Every vertex of ours is one of theirs, or lies within an edge of theirs.
    order = np.roll(edges, turned, axis=0)
    welded = {
        int(order[place.edge, int(place.part)])
        for place in found.places.values()
        if place.part in (0, 1)
    }
    inserted = [vertex for inside in found.inserts.values() for vertex in inside]
    assert len(inserted) == len(set(inserted)) and welded | set(inserted) == set(range(12))


def test_known_vertices_stay_what_they_are() -> None:
    ours, ours_edges = path([[0, 0], [4, 0]])
    theirs, theirs_edges = path([[0.3, 0.2], [4, 0.1]])
    found = match(ours, ours_edges, theirs, theirs_edges, {0: 0})
    assert found.places[0].edge + found.places[0].part == 0
    assert not match(ours, ours_edges, theirs, theirs_edges, {0: -1}).places
