"""The fused cloud as PLY and LAZ, whole and by tiles."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest
import trimesh
from cloud_parts import UTM, fused_workspace, ground
from sirpy.cloud import POINT, positions
from sirpy.cloud_files import export_cloud
from sirpy.errors import InputError
from sirpy.frame import Frame
from sirpy.ply import read_vertices
from sirpy.progress import LoggedProgress, Progress
from sirpy.tiles import tiling


def test_ply_keeps_everything_in_double_precision(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = ground(3000)
    workspace = fused_workspace(tmp_path / "out", points, monkeypatch)
    [path] = export_cloud(workspace, format="ply")
    found = read_vertices(path)
    assert found.dtype == POINT
    assert np.array_equal(positions(found), UTM.world(positions(points)))
    assert np.array_equal(found["views"], points["views"])
    assert np.allclose(found["gsd"], 2 * points["gsd"])
    other = trimesh.load(path)
    assert np.array_equal(np.asarray(other.vertices), positions(found))
    assert np.array_equal(np.asarray(other.colors)[:, 0], found["red"])


def test_tiles_share_the_points_and_old_tiles_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace = fused_workspace(tmp_path / "out", ground(3000), monkeypatch)
    quads = export_cloud(workspace, tiles="quadkey:20")
    assert sum(laspy.read(path).header.point_count for path in quads) == 3000
    mesh = workspace.tile("x1_y2", "mesh.laz")
    mesh.touch()
    log = LoggedProgress(Progress(), tmp_path / "none" / "log.txt")
    squares = export_cloud(workspace, tiles="25", progress=log)
    assert not any(path.exists() for path in quads) and mesh.exists()
    assert sum(laspy.read(path).header.point_count for path in squares) == 3000
    by_name = {
        tile.name: tile for tile in tiling("25", UTM).tiles(690_900, 5_334_900, 691_200, 5_335_200)
    }
    for path in squares:
        x0, y0, x1, y1 = by_name[path.stem].bounds
        header = laspy.read(path).header
        assert header.parse_crs().to_epsg() == 32632
        assert (header.mins[:2] >= (x0 - 1e-3, y0 - 1e-3)).all()
        assert (header.maxs[:2] <= (x1 + 1e-3, y1 + 1e-3)).all()
    assert log.notes[-1] == f"laz: {len(squares)} tiles"


def test_tiles_without_points_are_left_out_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = ground(2)
    points["x"], points["y"], points["gsd"] = [0.25, 30.25], 0, 0.1
    workspace = fused_workspace(tmp_path / "out", points, monkeypatch, Frame())
    log = LoggedProgress(Progress(), tmp_path / "none" / "log.txt")
    assert [path.name for path in export_cloud(workspace, tiles="10", progress=log)] == [
        "x0_y0.laz",
        "x3_y0.laz",
    ]
    assert log.notes[-1] == "laz: 2 tiles, 6 more have no points"


def test_thinned_tiles_are_the_thinned_cloud(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace = fused_workspace(tmp_path / "out", ground(5000), monkeypatch)
    [path] = export_cloud(workspace, spacing=2.5)
    thinned = np.unique(laspy.read(path).xyz, axis=0)
    tiles = [laspy.read(path).xyz for path in export_cloud(workspace, tiles="20", spacing=2.5)]
    assert np.array_equal(np.unique(np.concatenate(tiles), axis=0), thinned)
    assert len(np.concatenate(tiles)) == len(thinned) < 5000


def test_quadkeys_need_a_place_on_the_earth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace = fused_workspace(tmp_path / "out", ground(10), monkeypatch, Frame())
    with pytest.raises(InputError, match="quadkey:19 needs a place"):
        export_cloud(workspace, tiles="quadkey:19")
    with pytest.raises(InputError, match="--format copc is not known: choose ply or laz"):
        export_cloud(workspace, format="copc")  # type: ignore[arg-type]
