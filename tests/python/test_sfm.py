"""Structure from motion and the refinement after it: what is written, removed, continued, refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from bumpy_ground import camera_centres, photograph, write_jpeg, write_photographs
from rig_scene import OBLIQUE_FROM_RIG, TRANSLATION, write_rig_file, write_rig_photographs
from sirpy.errors import BudgetError, InputError, OutputError
from sirpy.model_arrays import read_arrays
from sirpy.model_files import model_identity
from sirpy.progress import Progress
from sirpy.refinement_record import FeatureFit
from sirpy.sfm import predicted_refinement_peak, refine_cameras, sfm
from sirpy.sfm_options import SfmOptions
from sirpy.workspace import Workspace

SMALL = SfmOptions(max_image_size=300)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photographs")
    write_photographs(folder, ["1.jpg", "2.jpg", "3.jpg"])
    return folder


@pytest.fixture(scope="module")
def made(photographs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The model without refinement, its workspace beside it."""
    output = tmp_path_factory.mktemp("made") / "model"
    sfm(photographs, output, options=SMALL, native=False, threads=2)
    return output


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path / "model")
    shutil.copytree(made.with_name("model.sfm"), tmp_path / "model.sfm")
    return tmp_path / "model"


@pytest.fixture
def refined(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The models that were refined, by a refinement that turns focal lengths into 123."""
    calls: list[Path] = []

    def refine(_: Path, model: Path, output: Path, **options: object) -> None:
        calls.append(model)
        assert options.keys() == {"threads", "progress"}
        moved = pycolmap.Reconstruction(model)
        for camera in moved.cameras.values():
            camera.params = np.array([123.0, 123.0, *camera.params[2:]])
        output.mkdir(exist_ok=True)
        moved.write_binary(output)
        (output.parent / "refinement.json").write_text(
            '{"left_out": [{"name": "9.jpg", "reason": "too few tie points"}]}'
        )

    monkeypatch.setattr("sirpy.native_refinement.refine", refine)
    return calls


def focal(model: Path) -> float:
    (camera,) = pycolmap.Reconstruction(model).cameras.values()
    assert camera.model_name == "OPENCV"
    return float(camera.params[0])


def poses(model: Path) -> dict[str, list[list[float]]]:
    return {image.name: image.cam_from_world.tolist() for image in read_arrays(model).images}


def test_the_output_is_a_model_and_nothing_else(made: Path) -> None:
    names = {path.name for path in made.iterdir()}
    assert names == {f"{n}.bin" for n in ("cameras", "images", "points3D", "rigs", "frames")}
    assert len(read_arrays(made).images) == 3
    assert not Workspace(made.with_name("model.sfm")).is_refined


def test_refinement_comes_and_goes_without_another_structure_from_motion(
    photographs: Path, copy: Path, refined: list[Path]
) -> None:
    workspace = Workspace(copy.with_name("model.sfm"))
    solved = workspace.sfm_task.stat().st_mtime_ns
    plain = model_identity(copy)
    result = sfm(photographs, copy, options=SMALL)
    assert refined == [workspace.sfm_model] and focal(copy) == 123.0
    assert result.refinement == workspace.refinement and result.components == [
        ["1.jpg", "2.jpg", "3.jpg"]
    ]
    assert workspace.solved_model == workspace.refined_model
    assert [out.name for out in result.left_out] == ["9.jpg"]
    assert sfm(photographs, copy, options=SMALL) == result
    assert len(refined) == 1
    # A refinement that was killed is done again.
    workspace.refinement.unlink()
    sfm(photographs, copy, options=SMALL)
    assert len(refined) == 2
    without = sfm(photographs, copy, options=SMALL, native=False)
    assert without.refinement is None and model_identity(copy) == plain
    assert not workspace.refinement.exists() and workspace.solved_model == workspace.sfm_model
    assert workspace.sfm_task.stat().st_mtime_ns == solved


def test_kept_cameras_are_resumed_like_refined_ones(
    photographs: Path, copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    contradicted = FeatureFit(1.0, 2.0, contradict=True)
    monkeypatch.setattr("sirpy.refinement_record.feature_fit", lambda *_: contradicted)
    workspace, plain = Workspace(copy.with_name("model.sfm")), poses(copy)
    result = sfm(photographs, copy, options=SMALL)
    assert workspace.is_refined and poses(copy) == plain
    made = model_identity(copy)
    assert "2.00 px instead of 1.00" in workspace.refinement.read_text()
    written = workspace.refinement.stat().st_mtime_ns
    assert sfm(photographs, copy, options=SMALL) == result
    assert workspace.refinement.stat().st_mtime_ns == written and model_identity(copy) == made


def test_refinement_stays_within_the_memory_allowed(photographs: Path, copy: Path) -> None:
    workspace = Workspace(copy.with_name("model.sfm"))
    needed = predicted_refinement_peak(workspace)
    with pytest.raises(BudgetError, match=r"more than --memory allows .* --no-native"):
        refine_cameras(
            *(photographs, workspace, [], []),
            native=True,
            memory=needed - 1,
            threads=1,
            progress=Progress(),
        )
    assert not workspace.is_refined


def test_what_another_made_is_not_replaced(photographs: Path, made: Path, tmp_path: Path) -> None:
    others = tmp_path / "model"
    shutil.copytree(made, others)
    with pytest.raises(OutputError, match="holds a model that was not made with"):
        sfm(photographs, others, options=SMALL, native=False)
    shutil.copytree(made.with_name("model.sfm"), tmp_path / "model.sfm")
    (others / "notes.txt").touch()
    with pytest.raises(OutputError, match=r"notes\.txt"):
        sfm(photographs, others, options=SMALL, native=False)
    assert (others / "notes.txt").exists()


def test_a_model_that_another_tool_put_there_is_not_replaced(
    photographs: Path, copy: Path, made: Path
) -> None:
    other = pycolmap.Reconstruction(made)
    other.delete_point3D(min(other.point3D_ids()))
    other.write_binary(copy)
    with pytest.raises(OutputError, match="or was changed since"):
        sfm(photographs, copy, options=SMALL, native=False)
    (copy / "points3D.bin").unlink()
    with pytest.raises(OutputError, match="or was changed since"):
        sfm(photographs, copy, options=SMALL, native=False)


@pytest.mark.parametrize("link", [False, True], ids=["folder", "link"])
def test_an_empty_folder_is_filled(
    photographs: Path, copy: Path, made: Path, tmp_path: Path, link: bool
) -> None:
    shutil.rmtree(copy)
    copy.mkdir()
    given = copy
    if link:
        given = tmp_path / "link"
        given.symlink_to(copy, target_is_directory=True)
    sfm(photographs, given, options=SMALL, native=False)
    assert model_identity(given) == model_identity(made) == model_identity(copy)


def test_a_folder_of_one_photograph_does_not_cost_the_model_before(
    copy: Path, made: Path, tmp_path: Path
) -> None:
    write_photographs(tmp_path / "one", ["1.jpg"])
    with pytest.raises(InputError, match="1 usable photograph"):
        sfm(tmp_path / "one", copy, options=SMALL, native=False)
    assert Workspace(copy.with_name("model.sfm")).is_solved
    assert model_identity(copy) == model_identity(made)


def test_photographs_that_cannot_be_read_are_those_of_now(
    photographs: Path, copy: Path, tmp_path: Path
) -> None:
    images = tmp_path / "images"
    shutil.copytree(photographs, images)
    for name in ("8.jpg", "9.jpg"):
        (images / name).write_text("no photograph")
        result = sfm(images, copy, options=SMALL, native=False)
        assert [out.name for out in result.left_out] == [name]
        (images / name).unlink()


def test_a_damaged_workspace_is_one_sentence(photographs: Path, copy: Path) -> None:
    workspace = Workspace(copy.with_name("model.sfm"))
    workspace.sfm_components.write_text("[]")
    with pytest.raises(InputError, match=r"model\.sfm/sfm is damaged: delete .* and run again"):
        sfm(photographs, copy, options=SMALL, native=False)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"camera_model": "OPENCV5"}, "camera_model"),
        ({"camera_per": "lens"}, "camera_per"),
        ({"matcher": "vocabulary"}, "matcher"),
        ({"mapper": "hierarchical"}, "mapper"),
        ({"gps": "on"}, "gps"),
        ({"max_image_size": 10}, "64 or more"),
        ({"matcher": "spatial", "gps": "off"}, "choose one of the two"),
        ({"rig": Path("rig.json"), "camera_per": "single"}, "leave it at auto"),
        ({"matcher": "spatial"}, "3 of the 3 in .* have none in EXIF"),
        ({"gps": "use"}, "0 of the 3 in .* have one in EXIF"),
        ({"rig": Path("no-rig.json")}, "there is no file"),
    ],
)
def test_what_cannot_be_is_one_sentence_and_nothing_is_written(
    photographs: Path, tmp_path: Path, options: dict[str, object], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        sfm(photographs, tmp_path / "model", options=SfmOptions(**options))  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_sizes_that_differ_cannot_share_a_single_camera(photographs: Path, tmp_path: Path) -> None:
    shutil.copytree(photographs, tmp_path / "in")
    noise = np.random.default_rng(1).integers(0, 255, (90, 120), np.uint8)
    write_jpeg(tmp_path / "in" / "4.jpg", noise)
    with pytest.raises(InputError, match=r"480x360 pixels and 4\.jpg 120x90"):
        sfm(tmp_path / "in", tmp_path / "model", options=SfmOptions(camera_per="single"))


def test_two_scenes_are_two_components_and_the_smaller_is_named(tmp_path: Path) -> None:
    large, small = [f"a{i}.jpg" for i in range(4)], [f"b{i}.jpg" for i in range(3)]
    write_photographs(tmp_path / "in", large)
    down = np.diag([1.0, -1.0, -1.0])
    for name, centre in zip(small, camera_centres(3), strict=True):
        elsewhere = centre + np.array([16.0, 16.0, 0.0])
        write_jpeg(tmp_path / "in" / name, photograph(elsewhere, down))
    result = sfm(tmp_path / "in", tmp_path / "model", options=SMALL, native=False, threads=2)
    assert result.components == [large, small]
    assert [out.name for out in result.left_out] == small
    assert "component 2, of 3 photographs" in result.left_out[0].reason
    # What is read again of an earlier run.
    again = sfm(tmp_path / "in", tmp_path / "model", options=SMALL, native=False)
    assert (again.components, again.left_out) == (result.components, result.left_out)


@pytest.fixture(scope="module")
def rig_photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rig") / "in"
    write_rig_photographs(folder, 4)
    return folder


@pytest.mark.parametrize("posed", [True, False])
def test_a_rig_has_one_pose_an_exposure(rig_photographs: Path, tmp_path: Path, posed: bool) -> None:
    rig = write_rig_file(tmp_path / "rig.json", posed=posed)
    options = SfmOptions(max_image_size=300, rig=rig)
    sfm(rig_photographs, tmp_path / "model", options=options, native=False, threads=2)
    model = pycolmap.Reconstruction(tmp_path / "model")
    assert (model.num_rigs(), model.num_reg_frames(), model.num_reg_images()) == (1, 4, 8)
    assert all((c.width, c.height) == (480, 360) for c in model.cameras.values())
    (one,) = model.rigs.values()
    (oblique_from_rig,) = one.non_ref_sensors.values()
    turn = oblique_from_rig.rotation.matrix() @ OBLIQUE_FROM_RIG.T
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 0.3
    if posed:  # the rig gives the scale
        assert oblique_from_rig.translation == pytest.approx(TRANSLATION, abs=0.05)
    # Other stages read the poses of the photographs, composed.
    poses = {image.name: image.cam_from_world for image in read_arrays(tmp_path / "model").images}
    for exposure in range(4):
        composed = oblique_from_rig.matrix() @ np.vstack(
            [poses[f"nadir/{exposure}.jpg"], [0, 0, 0, 1]]
        )
        assert poses[f"oblique/{exposure}.jpg"] == pytest.approx(composed, abs=1e-9)


@pytest.mark.parametrize(
    ("cameras", "sentence"),
    [
        ([{"image_prefix": "nadir/"}], "0 cameras that are its reference"),
        ([{"image_prefix": "up/", "ref_sensor": True}], "no photograph has a name"),
        ([{"image_prefix": "nadir/", "ref_sensor": True, "color": 1}], "color"),
        (
            [{"image_prefix": "n", "ref_sensor": True}, {"image_prefix": "nadir/"}],
            "of two cameras",
        ),
        (
            [
                {"image_prefix": "nadir/", "ref_sensor": True},
                {"image_prefix": "oblique/", "cam_from_rig_rotation": [1, 0, 0, 0]},
            ],
            "half a pose of oblique/",
        ),
        (
            [{"image_prefix": "nadir/0", "ref_sensor": True}, {"image_prefix": "oblique/"}],
            "no two photographs",
        ),
        ("cameras", "damaged"),
    ],
)
def test_a_wrong_rig_is_one_sentence(
    rig_photographs: Path, tmp_path: Path, cameras: object, sentence: str
) -> None:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps([{"cameras": cameras}]))
    with pytest.raises(InputError, match=sentence):
        sfm(rig_photographs, tmp_path / "model", options=SfmOptions(rig=path))
    assert not (tmp_path / "model.sfm").exists()
