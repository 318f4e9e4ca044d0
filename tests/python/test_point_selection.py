"""Every point in one tile, thinning that depends on nothing but the points and the spacing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cloud_parts import UTM, cloud_of, ground
from sirpy.cloud import POINT, Points
from sirpy.errors import InputError
from sirpy.frame import Frame
from sirpy.point_selection import PointSelection
from sirpy.progress import Steps
from sirpy.tiles import tiling


def ordered(points: list[Points]) -> Points:
    found = np.concatenate([np.empty(0, POINT), *points])
    return found[np.lexsort([found[name] for name in POINT.names or ()])]


def whole(selection: PointSelection) -> Points:
    return ordered(list(selection.all(Steps())))


@pytest.mark.parametrize("tiles", ["7.5", "30", "quadkey:19", "quadkey:22"])
@pytest.mark.parametrize("spacing", [None, 0.7])
def test_every_point_is_in_exactly_one_tile(
    tmp_path: Path, tiles: str, spacing: float | None
) -> None:
    selection = PointSelection(cloud_of(tmp_path, [ground(4000)]), spacing)
    found = [part for tile in selection.tiles(tiling(tiles, UTM)) for part in selection.of(tile)]
    assert np.array_equal(ordered(found), whole(selection))


def test_a_cube_keeps_its_best_point_whatever_the_order(tmp_path: Path) -> None:
    """By hand: for each cube of the lattice the least (gsd, -confidence, place)."""
    points = ground(6000)
    points["confidence"] = np.round(points["confidence"], 1)  # so that there are ties
    cloud = cloud_of(tmp_path, [points])
    best: dict[tuple[int, ...], tuple[float, ...]] = {}
    for point in np.concatenate(list(cloud.runs())):
        xyz = (float(point["x"]), float(point["y"]), float(point["z"]))
        cube = tuple(int(np.floor(value / 2.0)) for value in xyz)
        key = (float(point["gsd"]), -float(point["confidence"]), *xyz)
        best[cube] = min(best.get(cube, key), key)
    kept = whole(PointSelection(cloud, 2.0))
    assert {(p["x"], p["y"], p["z"]) for p in kept} == {key[2:] for key in best.values()}
    assert len(kept) == len(best) < 6000

    (tmp_path / "other").mkdir()
    shuffled = np.random.default_rng(5).permutation(points)
    other = cloud_of(tmp_path / "other", [shuffled[:100], shuffled[100:]])
    assert np.array_equal(whole(PointSelection(other, 2.0)), kept)


def test_points_that_differ_in_colour_alone_are_chosen_the_same(tmp_path: Path) -> None:
    pair = np.concatenate([ground(1), ground(1)])
    pair["red"] = [200, 100]
    for number, points in enumerate([pair, pair[::-1]]):
        (tmp_path / str(number)).mkdir()
        selection = PointSelection(cloud_of(tmp_path / str(number), [points]), 1.0)
        assert whole(selection)["red"].tolist() == [100]


def test_a_point_far_away_costs_no_tiles_between(tmp_path: Path) -> None:
    points = ground(500)
    points["x"][0] = 2e5
    selection = PointSelection(cloud_of(tmp_path, [points]))
    wanted = selection.tiles(tiling("10", UTM))
    assert len(wanted) < 2000
    assert sum(len(part) for tile in wanted for part in selection.of(tile)) == 500


def test_an_empty_cloud_has_no_tiles(tmp_path: Path) -> None:
    selection = PointSelection(cloud_of(tmp_path, [ground(0)], Frame()), 0.5)
    assert len(whole(selection)) == 0
    assert selection.tiles(tiling("10", Frame())) == []


@pytest.mark.parametrize("spacing", [0.0, -1.0, float("nan"), float("inf")])
def test_a_spacing_that_is_no_length_is_refused(tmp_path: Path, spacing: float) -> None:
    with pytest.raises(InputError, match="--spacing"):
        PointSelection(cloud_of(tmp_path, []), spacing)
