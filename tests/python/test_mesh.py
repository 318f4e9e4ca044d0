"""Points to a mesh: the surface, its joints, the same bytes however it is made, and what can go wrong."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from cloud_parts import fused_workspace, ground
from mesh_checks import joints_of
from sirpy import mesh as mesh_module
from sirpy import mesh_tiles
from sirpy.cloud import POINT, Points
from sirpy.errors import BudgetError, InputError, OutputError
from sirpy.frame import Frame
from sirpy.mesh import MeshOptions, mesh
from sirpy.mesh_files import read_ply
from sirpy.progress import Progress
from sirpy.tiles import tiling
from sirpy.workspace import Workspace
from typer.testing import CliRunner

# A model of which one unit is 2 m; four tiles of 40 m meet in its middle.
UTM = Frame(
    "EPSG:32632",
    2.0,
    np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    np.array([691000.0, 5335000.0, 520.0]),
)
# 80 m of ground in cells of 1 m, with a collar of 8 m.
OPTIONS = MeshOptions(resolution=1.0, collar=8)


def hills(count: int = 20_000) -> Points:
    """Coloured by place, with normals."""
    points = ground(count)
    x, y = points["x"], points["y"]
    slope = np.column_stack(
        [
            -2 / 5 * np.cos(x / 5) * np.cos(y / 7),
            2 / 7 * np.sin(x / 5) * np.sin(y / 7),
            np.ones(count),
        ]
    )
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    points["nx"], points["ny"], points["nz"] = slope.T
    points["red"], points["green"], points["blue"] = 128 + 6 * x, 128 + 6 * y, 50
    return points


def off_the_surface(vertices: np.ndarray, frame: Frame) -> np.ndarray:
    """Distances in metres."""
    x, y, z = frame.model(np.column_stack([vertices[name] for name in "xyz"])).T
    away: np.ndarray = np.abs(z - 2 * np.sin(x / 5) * np.cos(y / 7)) * frame.scale
    return away


class Noted(Progress):
    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


def test_tiles_of_a_grid_are_one_surface(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workspace = fused_workspace(tmp_path, hills(), monkeypatch, UTM)
    result = mesh(workspace, tiles="40", options=OPTIONS, threads=1)
    tiles = list(tiling("40", UTM).tiles(690961, 5334961, 691039, 5335039))
    found = joints_of(result.path, tiles)
    assert found.non_manifold == 0 and found.open < 0.02 * found.closed
    assert found.closed > 160 and found.folded < 1
    vertices, triangles = read_ply(result.path)
    places = UTM.model(np.column_stack([vertices[name] for name in "xyz"]))
    inner = np.abs(places[:, :2]).max(axis=1) < 19
    assert off_the_surface(vertices[inner], UTM).max() < 0.3  # cells of 1 m
    assert np.abs(vertices["red"] - (128 + 6 * places[:, 0]))[inner].max() < 10
    (scene,) = trimesh.load(result.glb[0], process=False).dump()
    assert len(scene.faces) == len(triangles) == result.triangles and not result.failed

    # In two processes at a time, from the beginning: the same bytes.
    before = [path.read_bytes() for path in (result.path, *result.glb)]
    shutil.rmtree(tmp_path / "mesh-pieces")
    again = mesh(workspace, tiles="40", options=OPTIONS, threads=2)
    assert [path.read_bytes() for path in (again.path, *again.glb)] == before


def test_quadkeys_are_one_surface_and_files_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace = fused_workspace(tmp_path, hills(), monkeypatch, UTM)
    options = MeshOptions(resolution=1.0, collar=8, per_tile=True)
    result = mesh(workspace, tiles="quadkey:19", options=options)
    tiles = list(tiling("quadkey:19", UTM).tiles(690961, 5334961, 691039, 5335039))
    found = joints_of(result.path, tiles)
    assert found.non_manifold == 0 and found.open < 0.02 * found.closed and found.closed > 70
    made = workspace.tiles_made("mesh.ply")
    assert len(made) >= 4 and len(workspace.tiles_made("mesh.glb")) == len(made)
    assert sum(len(read_ply(path)[1]) for path in made) == result.triangles


def test_one_tile_that_fails_is_named_and_the_rest_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also the command's end says so; the next run makes what is missing, and only that."""
    points = hills()
    workspace = fused_workspace(tmp_path, points, monkeypatch, UTM)
    run = mesh_tiles.run_alone

    def broken(task: mesh_tiles.TileTask, task_file: Path) -> str | None:
        if task.corners[0] == (691000.0, 5334960.0):
            task.points.write_bytes(b"ply")
        return run(task, task_file)

    monkeypatch.setattr(mesh_module, "run_alone", broken)
    from sirpy.cli import app

    call = ["mesh", str(tmp_path), "--tiles", "40", "--resolution", "1", "--collar", "8"]
    done = CliRunner().invoke(app, call)
    assert isinstance(done.exception, InputError)
    name = f"x{691000 // 40}_y{5334960 // 40}"
    assert f"without 1 of its tiles ({name}" in str(done.exception)
    assert (tmp_path / "mesh.ply").exists() and (tmp_path / "mesh.glb").exists()

    calls = []
    monkeypatch.setattr(mesh_module, "run_alone", lambda *task: calls.append(task) or run(*task))
    noted = Noted()
    result = mesh(workspace, tiles="40", options=OPTIONS, progress=noted)
    assert len(calls) == 1 and not result.failed
    assert "tiles of the mesh are there already" in noted.notes[0]
    assert not list(tmp_path.glob("mesh-pieces/*/.*"))  # no scratch is left


def test_a_process_that_crashes_is_a_sentence(tmp_path: Path) -> None:
    """Poisson without points is a segmentation fault."""
    task = mesh_tiles.TileTask(
        points=tmp_path / "points.ply",
        origin=(0.0, 0.0, 0.0),
        corners=((0, 0), (1, 0), (1, 1), (0, 1)),
        cell=0.1,
        reach=0.6,
        keep=1.0,
        vertices=tmp_path / "v.npy",
        faces=tmp_path / "f.npy",
    )
    mesh_tiles.write_points(task.points, np.zeros(0, POINT), np.zeros(3))
    assert mesh_tiles.run_alone(task, tmp_path / "task.json")
    assert not task.faces.exists()


def test_a_full_disk_ends_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A crash that has no room is no fault of the tile."""
    workspace = fused_workspace(tmp_path, hills(), monkeypatch, UTM)
    monkeypatch.setattr(mesh_module, "run_alone", lambda *_: "its process was ended by SIGABRT")
    usage = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage)
    with pytest.raises(OutputError, match="No space left"):
        mesh(workspace, tiles="40", options=OPTIONS)
    assert not workspace.mesh.exists() and not list(tmp_path.glob("mesh-pieces/*/.*"))


@pytest.mark.parametrize("kept", [0, 10])
def test_a_cloud_without_a_surface(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kept: int
) -> None:
    workspace = fused_workspace(tmp_path, hills()[:kept], monkeypatch, UTM)
    noted = Noted()
    with pytest.raises(InputError, match="no points" if kept == 0 else "enough points"):
        mesh(workspace, options=OPTIONS, progress=noted)
    assert [("too few points" in note) for note in noted.notes] == [True] * (kept > 0)
    assert not workspace.mesh.exists()


def test_what_is_far_from_points_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lake of 28 m stays a hole, one of 6 m is closed."""
    points = hills()
    lake = np.hypot(points["x"], points["y"]) < 7
    pond = np.hypot(points["x"] - 13, points["y"]) < 1.5
    workspace = fused_workspace(tmp_path, points[~lake & ~pond], monkeypatch, UTM)
    mesh(workspace, tiles="1000", options=OPTIONS)
    vertices, triangles = read_ply(workspace.mesh)
    places = np.column_stack([vertices["x"], vertices["y"], vertices["z"]])
    centres = UTM.model(places[triangles["vertices"]].mean(axis=1))
    from_lake = np.hypot(centres[:, 0], centres[:, 1])
    assert 2.5 < from_lake.min() < 5.5  # 6 cells of half a unit inwards of 7, more or less
    assert np.hypot(centres[:, 0] - 13, centres[:, 1]).min() < 0.5


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"resolution": 0.0}, "resolution"),
        ({"resolution": float("nan")}, "resolution"),
        ({"keep": 0.0}, "keep"),
        ({"keep": 1.5}, "keep"),
        ({"reach": 0.0}, "reach"),
        ({"collar": float("inf")}, "collar"),
        ({"reach": 30.0}, "reach"),
    ],
)
def test_options_out_of_range(options: dict[str, float], name: str) -> None:
    with pytest.raises(InputError, match=f"--{name}"):
        MeshOptions(**options)


def test_a_tile_beyond_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workspace = fused_workspace(tmp_path, hills(), monkeypatch, UTM)
    fine = MeshOptions(resolution=0.01)
    with pytest.raises(BudgetError, match="smaller --tiles"):
        mesh(workspace, tiles="80", options=fine, memory=10**9)
    with pytest.raises(InputError, match="100000 tiles"):
        mesh(workspace, tiles="0.01", options=fine, memory=10**9)


def test_the_tiles_follow_the_memory_not_the_area(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = fused_workspace(tmp_path / "small", hills(), monkeypatch, UTM)
    wide = hills()
    wide["x"] *= 50
    wide["y"] *= 50
    large = fused_workspace(tmp_path / "large", wide, monkeypatch, UTM)

    def side(workspace: Workspace, memory: int) -> float:
        cloud = mesh_module.open_cloud(workspace)
        return mesh_module._side(cloud, 0.5, OPTIONS, memory)

    assert side(small, 8 * 10**9) == side(large, 8 * 10**9) > side(small, 10**9)
