"""Tiles whose surfaces differ a little are joined: no gap, no double, also where four meet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mesh_checks import bumpy, join, joints_of, tile_surface
from sirpy.frame import Floats
from sirpy.mesh_files import read_ply
from sirpy.tiles import GridTiling, Tile

GRID = list(GridTiling(12.0).tiles(1, 1, 23, 23))


def slanted() -> list[Tile]:
    """Four quadrilaterals around a corner, as quadkeys in a CRS."""
    lattice = np.array(
        [[[0, 0], [9, 1], [18, 2]], [[-1, 10], [8, 11], [17, 12]], [[-2, 20], [7, 21], [16, 22]]]
    )
    return [
        Tile(
            f"{row}{column}",
            np.array(
                [
                    lattice[row, column],
                    lattice[row, column + 1],
                    lattice[row + 1, column + 1],
                    lattice[row + 1, column],
                ],
                np.float64,
            ),
        )
        for row in range(2)
        for column in range(2)
    ]


@pytest.mark.parametrize("tiles", [GRID, slanted()], ids=["grid", "slanted"])
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.15])
def test_every_edge_of_a_joint_has_two_faces(
    tmp_path: Path, tiles: list[Tile], noise: float
) -> None:
    meshes = [tile_surface(tile, seed, noise) for seed, tile in enumerate(tiles)]
    join(tmp_path / "mesh.ply", tiles, meshes)
    found = joints_of(tmp_path / "mesh.ply", tiles)
    assert found.open == 0 and found.non_manifold == 0
    assert found.closed > 37
    whole = 576.0 if tiles is GRID else 2 * 9 * 2 * 10 + 4.0
    assert found.plan == pytest.approx(whole, rel=1e-6)
    assert found.folded < 1e-6 * whole
    vertices, _ = read_ply(tmp_path / "mesh.ply")
    places = np.column_stack([vertices[name] for name in "xyz"])
    assert np.abs(places[:, 2] - bumpy(places[:, :2])).max() < noise + 0.06  # of 0.5 long edges


def test_a_tile_that_is_missing_leaves_its_sides_open(tmp_path: Path) -> None:
    meshes = [tile_surface(tile, seed) for seed, tile in enumerate(GRID)]
    join(tmp_path / "mesh.ply", GRID, [meshes[0], None, *meshes[2:]])
    found = joints_of(tmp_path / "mesh.ply", GRID)
    assert found.closed > 24 and found.open > 24 and found.non_manifold == 0
    assert found.plan == pytest.approx(3 * 144, rel=1e-6)


def test_surfaces_that_do_not_meet_stay_apart(tmp_path: Path) -> None:
    """A step of many cells is no surface of either tile."""

    def high(xy: Floats) -> Floats:
        return bumpy(xy) + 5

    tiles = GRID[:2]
    join(
        tmp_path / "mesh.ply",
        tiles,
        [tile_surface(tiles[0], 0), tile_surface(tiles[1], 1, 0.02, high)],
    )
    found = joints_of(tmp_path / "mesh.ply", tiles)
    assert found.closed == 0 and found.open > 24


def test_the_triangles_of_a_tile_are_found_again(tmp_path: Path) -> None:
    meshes = [tile_surface(tile, seed) for seed, tile in enumerate(GRID)]
    joiner = join(tmp_path / "mesh.ply", GRID, meshes)
    vertices, triangles = read_ply(tmp_path / "mesh.ply")
    seen = np.zeros(len(triangles), int)
    for tile in GRID:
        for first, count in joiner.ranges[tile.name]:
            seen[first : first + count] += 1
            corners = triangles["vertices"][first : first + count]
            x, y = vertices["x"][corners].mean(axis=1), vertices["y"][corners].mean(axis=1)
            assert tile.contains(np.column_stack([x, y])).all()
    assert (seen == 1).all()
