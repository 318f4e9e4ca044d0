"""3D Tiles hold every point in its place on the Earth, keep to the specification, and are the same every time."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from cloud_parts import UTM, cloud_of, fused_workspace, ground
from pyproj import Transformer
from scipy.spatial import cKDTree
from sirpy.cloud import POINT, positions
from sirpy.errors import InputError, OutputError
from sirpy.frame import Frame
from sirpy.progress import LoggedProgress, Progress
from sirpy.tiles3d import Place, _finish, tiles3d
from tileset_checks import check_tileset
from typer.testing import CliRunner

pytest.importorskip("py3dtiles", reason="needs the extra tiles3d")


def sums(folder: Path) -> dict[str, str]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


def test_every_point_is_in_its_place_and_colour(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = ground(30_000)
    workspace = fused_workspace(tmp_path / "out", points, monkeypatch)
    path = tiles3d(workspace)
    found = check_tileset(path)
    assert len(found.places) == 30_000 and found.files > 4
    degrees = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    plane = Transformer.from_crs("EPSG:4326", "EPSG:32632", always_xy=True)
    longitude, latitude, height = degrees.transform(*found.places.T)
    seen = np.column_stack([*plane.transform(longitude, latitude), height])
    truth = UTM.world(positions(points))
    away, index = cKDTree(truth).query(seen)
    assert away.max() < 2e-3  # a millimetre of the file, and 32 bits
    assert len(set(index)) == 30_000
    colours = np.column_stack([points[name] for name in ("red", "green", "blue")])
    assert np.array_equal(found.colours, colours[index])

    assert sorted(entry.name for entry in workspace.folder.glob("*tiles3d*")) == ["tiles3d"]
    before = sums(workspace.tiles3d)
    (workspace.tiles3d / "stale.pnts").touch()
    tiles3d(workspace)
    assert sums(workspace.tiles3d) == before


def test_the_place_of_a_large_cloud_follows_the_earth(tmp_path: Path) -> None:
    """30 km from the middle the ground is 70 m below the plane that touches it there."""
    corners = np.zeros(2, POINT)
    corners["x"] = [-15_000, 15_000]
    cloud = cloud_of(tmp_path, [corners])
    place = Place(cloud)
    local = place.local(np.concatenate([[(cloud.low + cloud.high) / 2], [cloud.low], [cloud.high]]))
    assert np.abs(local[0]).max() < 1  # the middle, in whole metres
    assert local[1:, 2] == pytest.approx(-(30_000**2) / (2 * 6.38e6), abs=1.0)


def test_boxes_hold_what_is_below_them_also_across_files(tmp_path: Path) -> None:
    """As py3dtiles splits a large tileset: the box of the tile that refers to a file is too small."""

    def box(low: list[float], high: list[float]) -> dict[str, list[float]]:
        middle, half = (np.add(low, high) / 2).tolist(), (np.subtract(high, low) / 2).tolist()
        return {"box": [*middle, half[0], 0, 0, 0, half[1], 0, 0, 0, half[2]]}

    def tileset(name: str, root: dict[str, object]) -> Path:
        asset = {"version": "1.0", "extras": {"created_date": "today"}}
        (tmp_path / name).write_text(json.dumps({"asset": asset, "root": root}))
        return tmp_path / name

    leaf = {"boundingVolume": box([4, 4, 0], [6, 9, 1])}
    tileset("inner.json", {"boundingVolume": box([0, 0, 0], [5, 5, 1]), "children": [leaf]})
    outer = {"boundingVolume": box([0, 0, 0], [5, 5, 1]), "content": {"uri": "inner.json"}}
    shift = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 100, 200, 300, 1]  # columns
    held = {"boundingVolume": box([0, 0, 0], [5, 5, 1]), "transform": shift, "children": [outer]}
    root = {"boundingVolume": box([101, 201, 300], [104, 204, 301]), "children": [held]}
    path = tileset("tileset.json", root)
    turn = np.array([[0.0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30], [0, 0, 0, 1]])
    assert _finish(path, turn).tolist() == [[100, 200, 300], [106, 209, 301]]

    found, inner = (json.loads((tmp_path / n).read_text()) for n in ("tileset.json", "inner.json"))
    assert found["root"]["boundingVolume"] == box([100, 200, 300], [106, 209, 301])
    assert found["root"]["children"][0]["boundingVolume"] == box([0, 0, 0], [6, 9, 1])
    assert found["root"]["children"][0]["transform"] == shift
    assert found["root"]["transform"] == turn.T.ravel().tolist()
    assert inner["root"]["boundingVolume"] == box([0, 0, 0], [6, 9, 1])
    assert "transform" not in inner["root"] and "today" not in json.dumps([found, inner])


def test_a_local_frame_stays_local_and_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = ground(2000)
    workspace = fused_workspace(tmp_path / "out", points, monkeypatch, Frame())
    log = LoggedProgress(Progress(), tmp_path / "none" / "log.txt")
    places = check_tileset(tiles3d(workspace, progress=log)).places
    assert np.allclose(places.min(axis=0), positions(points).min(axis=0), atol=2e-3)
    assert np.allclose(places.max(axis=0), positions(points).max(axis=0), atol=2e-3)
    assert any("local frame" in note for note in log.notes)


def test_a_cloud_without_points_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workspace = fused_workspace(tmp_path / "out", ground(0), monkeypatch)
    with pytest.raises(InputError, match="no points"):
        tiles3d(workspace)


def test_without_py3dtiles_the_sentence_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace = fused_workspace(tmp_path / "out", ground(10), monkeypatch)
    monkeypatch.setattr("sirpy.tiles3d.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pip install \"sirpy\[tiles3d\]\""):
        tiles3d(workspace)


def test_a_failure_leaves_the_earlier_tiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace = fused_workspace(tmp_path / "out", ground(100), monkeypatch)
    tiles3d(workspace)
    before = sums(workspace.folder)
    monkeypatch.setattr("sirpy.tiles3d._WORKER", "sirpy.nothing_there")
    with pytest.raises(OutputError, match="3D Tiles could not be made"):
        tiles3d(workspace)
    assert sums(workspace.folder) == before


def test_the_command_prints_where_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from sirpy.cli import app

    workspace = fused_workspace(tmp_path / "out", ground(100), monkeypatch)
    done = CliRunner().invoke(app, ["tiles3d", str(workspace.folder), "--quiet"])
    assert done.exit_code == 0
    assert done.stdout.strip() == f"3D Tiles: {workspace.tiles3d / 'tileset.json'}"


@pytest.mark.skipif(
    shutil.which("3d-tiles-validator") is None,
    reason="needs the 3D Tiles Validator: npm install -g 3d-tiles-validator",
)
def test_the_validator_finds_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workspace = fused_workspace(tmp_path / "out", ground(30_000), monkeypatch)
    report = tmp_path / "report.json"
    command = ["3d-tiles-validator", "--tilesetFile", str(tiles3d(workspace))]
    subprocess.run([*command, "--reportFile", str(report)], check=True)
    assert json.loads(report.read_text())["numErrors"] == 0
