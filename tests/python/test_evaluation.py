"""Clouds judged by a photograph that was held out: a textured plane, and a rendered town."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
from PIL import Image
from rephotograph_scene import DEPTH, HEIGHT, HELD_OUT, WIDTH, Scene, plane_scene
from sirpy import coloured_points
from sirpy.cli import app
from sirpy.errors import BudgetError, InputError
from sirpy.evaluation import Evaluation, evaluate
from sirpy.model_arrays import read_arrays
from sirpy.posed_camera import PosedCamera
from sirpy.progress import Progress
from sirpy.rephotograph_score import RephotographOptions
from sirpy.workspace import Workspace
from typer.testing import CliRunner

NATIVE = RephotographOptions(radius=0.5, shrink=1)


@pytest.fixture(params=["PINHOLE", "OPENCV"])
def scene(tmp_path: Path, request: pytest.FixtureRequest) -> Scene:
    return plane_scene(tmp_path, request.param)


@pytest.fixture
def plane(tmp_path: Path) -> Scene:
    return plane_scene(tmp_path)


def judged(
    scene: Scene, cloud: Path, options: RephotographOptions = NATIVE, **more: object
) -> Evaluation:
    return evaluate(
        scene.sparse,
        scene.images,
        cloud,
        hold_out=[HELD_OUT],
        options=options,
        **more,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("shrink", [1, 2, 3])
def test_an_exact_cloud_is_right_everywhere(scene: Scene, shrink: int) -> None:
    found = judged(scene, scene.cloud(), replace(NATIVE, shrink=shrink)).all
    assert found.pixels == found.covered == (HEIGHT // shrink) * (WIDTH // shrink)
    assert found.textured == (HEIGHT // shrink - 8) * (WIDTH // shrink - 8)
    assert found.alike == (found.textured,) * 3


@pytest.mark.parametrize("radius", [0.5, 1.0, 2.0, 4.5])
def test_the_radius_neither_shifts_nor_blurs_a_slanted_surface(plane: Scene, radius: float) -> None:
    slope = 1 + 0.3 * (plane.points[..., :1] + plane.points[..., 1:2]) / DEPTH
    slanted = replace(plane, points=plane.points * slope)  # on the same rays
    found = judged(plane, slanted.cloud(), replace(NATIVE, radius=radius)).all
    assert found.alike[2] > 0.97 * found.textured


def test_a_cloud_that_is_off_is_wrong_although_it_covers(plane: Scene) -> None:
    shares = judged(plane, plane.cloud(shift=2.0)).all.shares()
    assert shares["covered"] == pytest.approx(1 - 2 / WIDTH)
    assert shares["right_0.5"] == pytest.approx(0, abs=0.01)


def test_what_is_missing_is_wrong(plane: Scene) -> None:
    kept = np.ones((HEIGHT, WIDTH), bool)
    kept[: HEIGHT // 2, : WIDTH // 2] = False
    found = judged(plane, plane.cloud(kept)).all
    assert found.covered / found.pixels == 0.75
    # Beside the hole, fewer than 60 pixels of a window are left within two pixels of it.
    missing = (HEIGHT // 2 - 4 + 2) * (WIDTH // 2 - 4 + 2)
    wrong = found.textured - found.alike[2]
    assert wrong == pytest.approx(missing, rel=0.02)


def test_nearer_points_hide_farther_ones(plane: Scene) -> None:
    before = plane.points * 0.5  # on the same rays
    both = replace(
        plane,
        points=np.concatenate([before[:, : WIDTH // 2], plane.points], axis=1),
        colours=np.concatenate([255 - plane.colours[:, : WIDTH // 2], plane.colours], axis=1),
    )
    kept = np.ones(both.points.shape[:2], bool)
    shares = judged(plane, both.cloud(kept)).all.shares()
    assert shares["covered"] == 1
    assert shares["right_0.9"] == pytest.approx(0.5, abs=0.03)


def test_memory_and_parts_do_not_change_the_score(
    plane: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(0)
    other = random.integers(0, 256, plane.colours.shape) * np.linspace(0, 1, WIDTH)[:, None]
    noisy = replace(plane, colours=((plane.colours + other) / 2).astype(np.uint8))
    kept = random.uniform(size=(HEIGHT, WIDTH)) < 0.9
    cloud, options = noisy.cloud(kept, shift=0.2), RephotographOptions(0.7, 1)
    whole = judged(plane, cloud, options)
    assert 0 < whole.all.alike[2] < whole.all.alike[0] < whole.all.textured
    bands: list[int] = []
    read = coloured_points.read_coloured
    monkeypatch.setattr(
        "sirpy.judged_cloud.read_coloured", lambda path: bands.append(1) or read(path, 1000)
    )
    assert judged(plane, cloud, options, memory=401_400_000) == whole
    assert len(bands) > 3  # a passage through the cloud for each
    with pytest.raises(BudgetError, match=r"held\.png needs .* GB, more than --memory"):
        judged(plane, cloud, options, memory=100_000_000)


def test_only_what_enough_others_see_is_asked(plane: Scene) -> None:
    assert judged(plane, plane.cloud(), replace(NATIVE, min_views=3)).all.pixels == HEIGHT * WIDTH
    with pytest.raises(InputError, match="no photograph can be judged: too few photographs"):
        judged(plane, plane.cloud(), replace(NATIVE, min_views=4))


def test_masked_pixels_are_not_asked(plane: Scene) -> None:
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[:, :41] = 0
    (plane.folder / "masks").mkdir()
    Image.fromarray(mask).save(plane.folder / "masks" / f"{HELD_OUT}.png")
    options = replace(NATIVE, shrink=2)
    found = judged(plane, plane.cloud(mask > 0), options, masks=plane.folder / "masks").all
    assert found.pixels == found.covered == (HEIGHT // 2) * (WIDTH // 2 - 21)


def test_a_photograph_of_16_bits_counts_like_one_of_8(plane: Scene) -> None:
    grey = plane.colours[..., 0]
    flat = np.where(np.arange(WIDTH) < WIDTH // 2, grey, 100 + grey % 3).astype(np.uint16)
    cloud = replace(plane, colours=np.repeat(grey[..., None], 3, axis=2)).cloud()
    found = []
    for picture in (flat.astype(np.uint8), flat * 257):
        Image.fromarray(picture).save(plane.images / HELD_OUT)
        found.append(judged(plane, cloud).all)
    assert found[0] == found[1]
    assert found[0].textured == pytest.approx((HEIGHT - 8) * (WIDTH // 2), rel=0.02)


def test_pictures_show_holes(plane: Scene) -> None:
    kept = np.ones((HEIGHT, WIDTH), bool)
    kept[30:90, 40:120] = False
    judged(plane, plane.cloud(kept), picture=plane.folder / "pictures")
    picture = np.asarray(Image.open(plane.folder / "pictures" / f"{HELD_OUT}.png"))
    pink = (picture == (255, 0, 200)).all(axis=2)
    larger = 800 // WIDTH
    assert picture.shape == (30 + larger * HEIGHT, 3 * larger * WIDTH + 24, 3)
    assert pink.sum() == 2 * 60 * 80 * larger**2  # in the cloud and in the NCC


def test_files_of_points_in_another_frame_are_refused(plane: Scene) -> None:
    moved = replace(plane, points=plane.points + np.array([5e5, 5.8e6, 100])).cloud(name="_utm")
    with pytest.raises(
        InputError, match=r"no point of .* falls into held\.png: .* not one in a CRS"
    ):
        judged(plane, moved)


def test_mistakes_end_in_one_sentence(plane: Scene, tmp_path: Path) -> None:
    cloud = plane.cloud()
    with pytest.raises(InputError, match=r"nothing tells which photographs .* --hold-out"):
        evaluate(plane.sparse, plane.images, cloud)
    with pytest.raises(InputError, match=r"has no photograph a\.png: give names"):
        evaluate(plane.sparse, plane.images, cloud, hold_out=["a.png"])
    with pytest.raises(InputError, match="there is no point cloud"):
        judged(plane, tmp_path / "none.ply")
    with pytest.raises(InputError, match="there is no cloud in"):
        judged(plane, tmp_path)
    with pytest.raises(InputError, match=r"there is no folder .* holds the photographs"):
        evaluate(plane.sparse, tmp_path / "none", cloud, hold_out=[HELD_OUT])
    with pytest.raises(InputError, match="no photograph can be judged: there is no photograph"):
        evaluate(plane.sparse, plane.sparse, cloud, hold_out=[HELD_OUT])
    for options in ({"radius": 0.4}, {"radius": float("nan")}, {"shrink": 0}, {"min_views": 0}):
        with pytest.raises(InputError, match="is not possible: choose"):
            RephotographOptions(**options)  # type: ignore[arg-type]
    Image.fromarray(plane.colours[:-1]).save(plane.images / HELD_OUT)
    with pytest.raises(InputError, match="has 160x119 pixels, but its camera"):
        judged(plane, cloud)


# ---- workspaces


class Notes(Progress):
    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


def run(*words: str | Path) -> tuple[int, str]:
    done = CliRunner().invoke(app, [str(word) for word in words])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.exit_code, done.output


@pytest.fixture(scope="module")
def held(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the town: model without a photograph in kept/, its workspace in out/."""
    folder = tmp_path_factory.mktemp("held")
    code, said = run("evaluate", "split", town / "sparse", folder / "kept", "--every", "4")
    assert code == 0 and "held out: " in said
    run(
        *("reconstruct", town / "images", "--model", folder / "kept", "-o", folder / "out"),
        *("--columns", "2", "--rows", "2", "--quiet"),
    )
    return folder


def test_from_holding_out_to_the_score(town: Path, held: Path, tmp_path: Path) -> None:
    split = (town / "sparse", town / "images", held / "out")
    code, said = run("evaluate", "score", *split, "--json", tmp_path / "a.json", "--quiet")
    assert code == 0 and said.splitlines()[0].split() == [
        *("photograph", "covered", "right:", "0.5", "0.7", "0.9", "pixels"),
    ]
    found = json.loads((tmp_path / "a.json").read_text())
    (name,) = found["photographs"]
    assert name not in [native.name for native in Workspace(held / "out").natives]
    assert found["all"] == found["photographs"][name]
    assert found["all"]["covered"] > 0.6
    assert found["all"]["right_0.9"] <= found["all"]["right_0.7"] <= found["all"]["right_0.5"]
    assert found["all"]["right_0.5"] > 0.5


def test_files_of_a_workspace_are_known_by_their_place(town: Path, held: Path) -> None:
    run("georeference", held / "out", "--as-is", "--crs", "EPSG:25832")
    run("fuse", held / "out", "--format", "laz", "--quiet")
    sets = town / "sparse", town / "images"
    ply = evaluate(*sets, held / "out").all
    assert evaluate(*sets, held / "out/fused.ply").all == ply
    laz = evaluate(*sets, held / "out/fused.laz").all
    assert laz.covered == pytest.approx(ply.covered, rel=0.01)
    assert laz.alike[0] == pytest.approx(ply.alike[0], rel=0.02)


def test_points_come_back_from_the_frame_of_a_workspace(
    town: Path, held: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(held / "out", out)
    alignment = out / "georeference.json"
    alignment.unlink(missing_ok=True)
    before = evaluate(town / "sparse", town / "images", out).all
    centres = [",".join(["name", "x", "y", "z"])]
    kept = read_arrays(held / "kept")
    for image in kept.images:
        x, y, z = PosedCamera.of(kept, image).centre
        centres.append(f"{image.name},{500000 - 2 * y:.6f},{5800000 + 2 * x:.6f},{2 * z:.6f}")
    (tmp_path / "cameras.csv").write_text("\n".join(centres))
    run("georeference", out, "--positions", tmp_path / "cameras.csv", "--crs", "EPSG:25832")
    run("fuse", out, "--format", "laz", "--quiet")
    with laspy.open(out / "fused.laz") as reader:
        assert reader.header.mins[1] > 5e6
    after = evaluate(town / "sparse", town / "images", out / "fused.laz").all
    assert after.covered == pytest.approx(before.covered, rel=0.01)
    assert after.alike[0] == pytest.approx(before.alike[0], rel=0.02)


def test_only_the_region_that_was_cut_is_asked(town: Path, held: Path, tmp_path: Path) -> None:
    whole = evaluate(town / "sparse", town / "images", held / "out").all
    cut = ("cut", town / "images", "--model", held / "kept", "-o", tmp_path / "part", "--quiet")
    run(*cut, "--columns", "1", "--rows", "1", "--roi", "90,60,180,120")
    part = evaluate(
        town / "sparse", town / "images", held / "out", within=Workspace(tmp_path / "part")
    ).all
    assert 0 < part.pixels < 0.6 * whole.pixels


def test_a_workspace_of_other_cameras_or_of_all_photographs(
    town: Path, held: Path, plane: Scene, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="was made with other cameras than those of"):
        evaluate(plane.sparse, plane.images, held / "out")
    with pytest.raises(InputError, match=r"was made of all photographs .*sirpy evaluate split"):
        evaluate(held / "kept", town / "images", held / "out")
    notes, used = Notes(), Workspace(held / "out").natives[0].name
    evaluate(town / "sparse", town / "images", held / "out", hold_out=[used], progress=notes)
    assert any(f"made of {used} too" in note for note in notes.notes)


def test_a_photograph_that_cannot_be_read_is_left_out(plane: Scene) -> None:
    shutil.copy(plane.images / HELD_OUT, plane.images / "2.png")
    (plane.images / "3.png").write_bytes(b"no picture")
    names = [word for name in (HELD_OUT, "2.png", "3.png") for word in ("--hold-out", name)]
    words = (plane.sparse, plane.images, plane.cloud(), *names, "--min-views", "1", "--quiet")
    with pytest.raises(InputError, match=r"made without 1 of the photographs \(3\.png"):
        run("evaluate", "score", *words)
