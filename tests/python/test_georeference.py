"""Where on the Earth a model lies: by positions and control points, right, wrong, and missing."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pycolmap
import pytest
from sirpy.alignment import read_alignment
from sirpy.cutting import cut
from sirpy.errors import InputError
from sirpy.frame import Frame
from sirpy.georeference import georeference, read_frame, settle_frame
from sirpy.layout import Region
from sirpy.model_arrays import SparseModel, read_arrays
from sirpy.model_files import read_model
from sirpy.native_scene import read_native_scene
from sirpy.rectangle import Grid, Rectangle
from sirpy.workspace import Workspace
from test_camera_positions import Notes
from test_exif import GPS, with_gps
from test_ground_control import marks_of, well_seen
from typer.testing import CliRunner

Floats = npt.NDArray[np.float64]

CRS = "EPSG:25832"
# The frame of the town, on the Earth.
EAST, NORTH, HEIGHT = 407_000.0, 5_381_000.0, 140.0


@pytest.fixture(scope="module")
def lost(town: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Workspace, Path, Frame]:
    """The town in a frame that says nothing, as from structure from motion: (workspace, model, its true
    frame)."""
    model = read_model(town / "sparse")
    first = min(model.images.values(), key=lambda image: image.name)
    turn = first.cam_from_world().rotation
    scale, shift = 0.037, np.array([3.0, -2, 5])
    model.transform(pycolmap.Sim3d(scale, turn, shift))
    folder = tmp_path_factory.mktemp("lost")
    model.write(folder)
    workspace = cut(
        town / "images",
        model,
        tmp_path_factory.mktemp("workspace"),
        identity="lost",
        grid=Grid(1, 1),
        region=Region(Rectangle(0, 0, 32, 32)),
    )
    back = turn.matrix().T
    earth = np.array([EAST, NORTH, HEIGHT])
    return workspace, folder, Frame(CRS, 1 / scale, back, earth - back @ shift / scale)


@pytest.fixture
def workspace(lost: tuple[Workspace, Path, Frame], tmp_path: Path) -> Workspace:
    shutil.copytree(lost[0].folder, tmp_path / "workspace")
    return Workspace(tmp_path / "workspace")


@pytest.fixture
def truth(lost: tuple[Workspace, Path, Frame]) -> Frame:
    return lost[2]


@pytest.fixture
def solved(lost: tuple[Workspace, Path, Frame]) -> Path:
    return lost[1]


def centres(workspace: Workspace, truth: Frame) -> dict[str, Floats]:
    """Where the cameras were on the Earth."""
    cameras = read_native_scene(workspace).cameras
    return {name: truth.world(one.centre[None])[0] for name, one in cameras.items()}


def written(path: Path, header: str, rows: dict[str, Any]) -> Path:
    lines = [",".join(map(str, [name, *values])) for name, values in rows.items()]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


def distance(one: Frame, other: Frame, workspace: Workspace) -> float:
    """Between the sparse points in two frames, at most."""
    points = read_native_scene(workspace).points
    return float(np.linalg.norm(one.world(points) - other.world(points), axis=1).max())


def test_positions_give_the_frame(workspace: Workspace, truth: Frame, tmp_path: Path) -> None:
    table = written(tmp_path / "p.csv", "name,easting,northing,height", centres(workspace, truth))
    alignment = georeference(workspace, positions=table, crs=CRS)
    assert alignment.source == "positions" and alignment.outliers == []
    frame = read_frame(workspace)
    assert frame.crs == CRS
    assert distance(frame, truth, workspace) < 1e-3
    before = workspace.georeference.read_bytes()
    georeference(workspace, positions=table, crs=CRS)
    assert workspace.georeference.read_bytes() == before


def test_noise_goes_into_the_residuals(workspace: Workspace, truth: Frame, tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    noisy = {n: c + random.normal(size=3) * 0.5 for n, c in centres(workspace, truth).items()}
    table = written(tmp_path / "p.csv", "name,x,y,z", noisy)
    alignment = georeference(workspace, positions=table, crs=CRS)
    assert 0.1 < alignment.rms()["x"] < 1
    assert distance(alignment.frame, truth, workspace) < 5
    said = json.loads(workspace.georeference.read_text())
    assert (said["source"], said["crs"], said["outliers"]) == ("positions", CRS, [])
    for one in said["residuals"]:
        at = alignment.frame.world(read_native_scene(workspace).cameras[one["name"]].centre[None])[
            0
        ]
        np.testing.assert_allclose(
            at - noisy[one["name"]], [one["dx"], one["dy"], one["dz"]], atol=1e-6
        )


def test_a_position_wrong_by_kilometres_is_named(
    workspace: Workspace, truth: Frame, tmp_path: Path
) -> None:
    places = centres(workspace, truth)
    wrong = sorted(places)[2]
    places[wrong] = places[wrong] + [5000, 0, 0]
    notes = Notes()
    alignment = georeference(
        workspace,
        positions=written(tmp_path / "p.csv", "name,x,y,z", places),
        crs=CRS,
        progress=notes,
    )
    assert alignment.outliers == [wrong]
    assert distance(alignment.frame, truth, workspace) < 1e-3
    assert any(f"{wrong} (5,000 off)" in note for note in notes.said)


def test_gps_in_exif(workspace: Workspace, truth: Frame, tmp_path: Path) -> None:
    from pyproj import Transformer

    degrees = Transformer.from_crs(CRS, "OGC:CRS84", always_xy=True)
    for name, (x, y, z) in centres(workspace, truth).items():
        longitude, latitude = degrees.transform(x, y)
        gps = {1: "N", 2: (latitude, 0.0, 0.0), 3: "E", 4: (longitude, 0.0, 0.0), 6: z}
        photograph = with_gps((tmp_path / name).with_suffix(".jpg"), gps)
        photograph.rename(tmp_path / name)
    alignment = georeference(workspace, images=tmp_path)
    assert (alignment.source, alignment.frame.crs) == ("exif", "EPSG:32632")
    # Rationals of EXIF, and both CRS are the same to centimetres.
    assert distance(alignment.frame, truth, workspace) < 0.2


def test_gps_in_two_photographs_is_too_little(workspace: Workspace, tmp_path: Path) -> None:
    names = sorted(read_native_scene(workspace).cameras)
    for name in names:
        gps = {**GPS, 6: 300.0} if name in names[:2] else {}
        with_gps((tmp_path / name).with_suffix(".jpg"), gps).rename(tmp_path / name)
    with pytest.raises(InputError, match="2 of the 6 photographs have a GPS position"):
        georeference(workspace, images=tmp_path)
    assert not workspace.georeference.exists()


def control(
    folder: Path, model: SparseModel, truth: Frame, count: int = 8, noise: float = 0.0
) -> tuple[Path, Path]:
    """Tables of control points and their marks."""
    points = well_seen(model, count)
    world = truth.world(points)
    marks = marks_of(model, points, noise)
    rows = [f"{model.images[m.image].name},{m.point},{m.xy[0]},{m.xy[1]}" for m in marks]
    (folder / "marks.csv").write_text("\n".join(["image,id,x,y", *rows]) + "\n")
    numbered = {str(number): xyz for number, xyz in enumerate(world)}
    return written(folder / "points.csv", "id,x,y,z", numbered), folder / "marks.csv"


def test_control_points_give_the_frame(
    workspace: Workspace, truth: Frame, solved: Path, tmp_path: Path
) -> None:
    points, marks = control(tmp_path, read_arrays(solved), truth)
    alignment = georeference(
        workspace,
        control_points=points,
        marks=marks,
        model=solved,
        crs=CRS,
        check=["3"],
    )
    assert [one.name for one in alignment.residuals if one.role == "check"] == ["3"]
    assert alignment.rms("check")["z"] < 1e-3
    assert alignment.rms()["pixels"] < 1e-3
    assert distance(alignment.frame, truth, workspace) < 1e-3
    assert read_alignment(workspace) is not None


def test_marks_of_a_pixel_and_what_is_wrong_among_them(
    workspace: Workspace, truth: Frame, solved: Path, tmp_path: Path
) -> None:
    points, marks = control(tmp_path, read_arrays(solved), truth, count=12, noise=0.5)
    lines = points.read_text().splitlines()
    name, x, y, z = lines[5].split(",")
    lines[5] = f"{name},{float(x) + 30},{y},{z}"
    points.write_text("\n".join(lines))
    rows = marks.read_text().splitlines()
    image, point, column, row = rows[1].split(",")
    rows[1] = f"{image},{point},{column},{abs(float(row) - 120)}"
    marks.write_text("\n".join(rows))
    notes = Notes()
    alignment = georeference(
        workspace,
        control_points=points,
        marks=marks,
        model=solved,
        crs=CRS,
        progress=notes,
    )
    assert alignment.outliers == [name]
    assert [(one.image, one.point) for one in alignment.marks_left_out] == [(image, point)]
    said = "\n".join(notes.said)
    assert f"{name} (30" in said and f"{point} in {image}" in said
    gsd = 1.0  # about
    assert distance(alignment.frame, truth, workspace) < 3 * gsd
    again = read_alignment(workspace)
    assert again is not None and again.marks_left_out == alignment.marks_left_out
    assert again.residuals == alignment.residuals


def test_control_points_on_a_line_are_refused(
    workspace: Workspace, truth: Frame, solved: Path, tmp_path: Path
) -> None:
    model = read_arrays(solved)
    ends = well_seen(model, 2)
    line = ends[0] + np.linspace(0.4, 0.6, 4)[:, None] * (ends[1] - ends[0])
    rows = [
        f"{model.images[m.image].name},{m.point},{m.xy[0]},{m.xy[1]}" for m in marks_of(model, line)
    ]
    (tmp_path / "marks.csv").write_text("\n".join(["image,id,x,y", *rows]) + "\n")
    numbered = {str(number): xyz for number, xyz in enumerate(truth.world(line))}
    points = written(tmp_path / "points.csv", "id,x,y,z", numbered)
    with pytest.raises(InputError, match="on one line"):
        georeference(
            workspace, control_points=points, marks=tmp_path / "marks.csv", model=solved, crs=CRS
        )
    assert not workspace.georeference.exists()


def test_control_in_one_photograph_only(
    workspace: Workspace, truth: Frame, solved: Path, tmp_path: Path
) -> None:
    points, marks = control(tmp_path, read_arrays(solved), truth)
    rows = marks.read_text().splitlines()
    first = rows[1].split(",")[0]
    marks.write_text("\n".join([rows[0], *[row for row in rows[1:] if row.startswith(first)]]))
    with pytest.raises(InputError, match=r"0 control points .* mark .* in more"):
        georeference(workspace, control_points=points, marks=marks, model=solved, crs=CRS)


def test_the_photographs_cameras_are_needed_and_must_be_these(
    workspace: Workspace, truth: Frame, solved: Path, town: Path, tmp_path: Path
) -> None:
    points, marks = control(tmp_path, read_arrays(solved), truth)
    with pytest.raises(InputError, match="--model"):
        georeference(workspace, control_points=points, marks=marks)
    with pytest.raises(InputError, match="is not the model that this workspace was cut from"):
        georeference(workspace, control_points=points, marks=marks, model=town / "sparse")


Places = dict[str, Floats]


def swapped(places: Places) -> Places:
    return {name: place[[1, 0, 2]] for name, place in places.items()}


def shuffled(places: Places) -> Places:
    return dict(zip(places, [*list(places.values())[3:], *list(places.values())[:3]], strict=True))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (swapped, "upside down|do not fit"),
        (shuffled, "do not fit the model"),
        (lambda places: dict.fromkeys(places, np.ones(3)), "are at one place"),
        (lambda places: dict(list(places.items())[:2]), "2 of the 6 photographs have a position"),
        (lambda places: {f"x{n}": p for n, p in places.items()}, "names none of the photographs"),
        (lambda places: {**places, "0": np.array([1, np.nan, 2])}, "'nan' for y"),
        (
            lambda places: {**places, **{Path(n).stem: p for n, p in places.items()}},
            "two positions",
        ),
    ],
)
def test_positions_that_cannot_be_right(
    workspace: Workspace,
    truth: Frame,
    tmp_path: Path,
    change: Callable[[Places], Places],
    why: str,
) -> None:
    table = written(tmp_path / "p.csv", "name,x,y,z", change(centres(workspace, truth)))
    with pytest.raises(InputError, match=why):
        georeference(workspace, positions=table)
    assert not workspace.georeference.exists()


@pytest.mark.parametrize("options", [{}, {"as_is": True, "images": Path("a")}])
def test_one_source(workspace: Workspace, options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="needs one source"):
        georeference(workspace, **options)
    with pytest.raises(InputError, match="belong together"):
        georeference(workspace, marks=Path("a"))


def test_declared_nothing_moves(workspace: Workspace) -> None:
    with pytest.raises(InputError, match="not projected"):
        georeference(workspace, as_is=True, crs="EPSG:4326")
    georeference(workspace, as_is=True, crs=CRS)
    frame = read_frame(workspace)
    assert (frame.crs, frame.scale) == (CRS, 1)
    assert (frame.rotation == np.eye(3)).all() and (frame.translation == 0).all()


def test_without_a_file_the_frame_is_local(workspace: Workspace) -> None:
    frame = read_frame(workspace)
    assert frame.crs is None and frame.scale == 1
    points = frame.world(read_native_scene(workspace).points)
    assert np.percentile(points[:, 2], 25) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    "change",
    [
        lambda value: value.update(version=0),
        lambda value: value.update(source="rumour"),
        lambda value: value["frame"].update(scale=-1),
        lambda value: value["frame"].update(rotation=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
        lambda value: value["frame"].update(translation=[0, 0]),
        lambda value: value.pop("residuals"),
    ],
)
def test_a_damaged_file_is_named(
    workspace: Workspace, change: Callable[[dict[str, Any]], Any]
) -> None:
    georeference(workspace, as_is=True, crs=CRS)
    value = json.loads(workspace.georeference.read_text())
    change(value)
    workspace.georeference.write_text(json.dumps(value))
    with pytest.raises(InputError, match=r"georeference.json .*run `sirpy georeference` again"):
        read_frame(workspace)


def test_what_a_reconstruction_settles_on(workspace: Workspace, town: Path, tmp_path: Path) -> None:
    notes = Notes()
    assert settle_frame(workspace, town / "images", progress=notes).crs is None
    assert "no georeference: no photograph" in notes.said[-2] and "local frame" in notes.said[-1]
    declared = settle_frame(workspace, town / "images", model_crs=CRS, progress=notes)
    assert declared.crs == CRS
    # What is there stays.
    assert settle_frame(workspace, town / "images", progress=notes).crs == CRS


def test_the_command(workspace: Workspace, truth: Frame, tmp_path: Path) -> None:
    from sirpy.cli import app

    table = written(tmp_path / "p.csv", "name,x,y,z", centres(workspace, truth))
    command = ["georeference", str(workspace.folder), "--positions", str(table), "--crs", CRS]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0
    assert "6 of 6 used" in result.output and CRS in result.output
    assert read_frame(workspace).crs == CRS
