"""Refinement at native resolution: rough cameras become those that took the photographs."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from camera_errors import judge
from PIL import Image
from sirpy.errors import InputError, OutputError
from sirpy.model_arrays import read_arrays
from sirpy.model_files import model_identity
from sirpy.native_refinement import Refinement, refine
from sirpy.progress import Progress
from sirpy.refinement_record import read_left_out
from sirpy.synthetic import render_scene

NOISE = 1.0  # px of the rough observations: those of photographs decimated three times or so


def rough(exact: Path, folder: Path) -> Path:
    """The cameras that observations with NOISE give."""
    model = pycolmap.Reconstruction(exact)
    random = np.random.default_rng(5)
    for image_id in sorted(model.reg_image_ids()):
        for point in model.image(image_id).points2D:
            point.xy = point.xy + random.normal(0, NOISE, 2)
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.solver_options.num_threads = 1
    pycolmap.bundle_adjustment(model, options)
    model.update_point_3d_errors()
    folder.mkdir()
    model.write_binary(folder)
    return folder


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """images/, sparse/ (exact) and rough/."""
    folder = tmp_path_factory.mktemp("scene")
    render_scene(folder, image_count=6, size=(720, 480), camera_model="OPENCV", seed=4)
    rough(folder / "sparse", folder / "rough")
    return folder


@pytest.fixture(scope="module")
def refined(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Refinement:
    output = tmp_path_factory.mktemp("refined") / "model"
    return refine(scene / "images", scene / "rough", output, threads=2)


def errors(model: Path, scene: Path) -> dict[str, float]:
    found = judge(read_arrays(model), read_arrays(scene / "sparse"))
    return {
        "consistency": found["consistency_px"]["rms"],
        "points": found["by_points"]["reprojection_px"]["rms"],
        "centres": found["by_points"]["centres"]["rms"],
    }


def test_cameras_are_several_times_better_than_those_of_rough_observations(
    scene: Path, refined: Refinement
) -> None:
    before, after = errors(scene / "rough", scene), errors(refined.model, scene)
    for name in before:
        assert after[name] < before[name] / 3, (name, before, after)
    assert after["consistency"] < 0.1
    assert not refined.record.left_out and refined.record.kept is None


def test_the_record_says_what_was_found(scene: Path, refined: Refinement) -> None:
    record = refined.record
    on_disk = json.loads(refined.model.with_name("refinement.json").read_text(encoding="utf-8"))
    assert on_disk["rms_after"] == record.rms_after
    assert record.rms_after < min(0.1, record.rms_before)
    model = pycolmap.Reconstruction(refined.model)
    assert record.points == model.num_points3D()
    assert record.observations == model.compute_num_observations()
    assert {image.name for image in record.images} == {p.name for p in (scene / "images").iterdir()}
    (camera,) = record.cameras
    assert sum(camera.count) == record.observations
    assert len(camera.mean_residual) == camera.columns * camera.rows == len(camera.count)
    exact = next(iter(pycolmap.Reconstruction(scene / "sparse").cameras.values()))
    assert camera.deviations is not None
    # The focal length is known as well as is said, within what relief does to tie points.
    assert abs(camera.params[0] - exact.params[0]) < 10 * camera.deviations[0] + 0.5


def test_only_a_model_is_replaced(scene: Path, tmp_path: Path) -> None:
    model = tmp_path / "model"
    model.mkdir()
    (model / "notes.txt").touch()
    with pytest.raises(OutputError, match=r"holds notes\.txt"):
        refine(scene / "images", scene / "rough", model)
    for output in (scene / "images", scene / "rough", scene):
        with pytest.raises(OutputError, match="would replace"):
            refine(scene / "images", scene / "rough", output)
    assert (model / "notes.txt").exists() and any((scene / "images").iterdir())


def test_the_same_bytes_for_any_number_of_threads(
    scene: Path, refined: Refinement, tmp_path: Path
) -> None:
    left_by_a_kill = tmp_path / ".model.patches" / "000000"
    left_by_a_kill.parent.mkdir()
    left_by_a_kill.write_bytes(b"half")
    again = refine(scene / "images", scene / "rough", tmp_path / "model", threads=1)
    assert {path.name for path in tmp_path.iterdir()} == {"model", "refinement.json"}
    assert model_identity(again.model) == model_identity(refined.model)
    assert again.record == refined.record


def test_other_exposures_and_moved_cars_do_not_matter(scene: Path, tmp_path: Path) -> None:
    """One photograph darker, one with squares of its ground exchanged: what moved is rejected."""
    images = tmp_path / "images"
    shutil.copytree(scene / "images", images)
    first, second, *_ = sorted(images.iterdir())
    dark = np.asarray(Image.open(first)).astype(float) * 0.55 + 12
    Image.fromarray(dark.astype(np.uint8)).save(first, quality=97)
    moved = np.array(Image.open(second))
    for y in range(40, 400, 90):  # each car is now 6 px further
        for x in range(40, 640, 90):
            moved[y : y + 24, x + 6 : x + 30] = moved[y : y + 24, x : x + 24].copy()
    Image.fromarray(moved).save(second, quality=97)
    made = refine(images, scene / "rough", tmp_path / "model", threads=2)
    found = errors(made.model, scene)
    assert found["consistency"] < 0.12, found
    assert len(made.record.images) == 6


def compressed(scene: Path, folder: Path, quality: int) -> Path:
    folder.mkdir()
    for path in (scene / "images").iterdir():
        Image.open(path).save(folder / path.name, quality=quality)
    return folder


class Notes(Progress):
    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


@pytest.mark.parametrize("quality", [1, 3])
def test_of_extreme_compression_the_decimated_cameras_are_kept(
    scene: Path, tmp_path: Path, quality: int
) -> None:
    """Blocks of one value each, which match perfectly or hardly tell where."""
    images, output, progress = tmp_path / "images", tmp_path / "model", Notes()
    compressed(scene, images, quality)
    made = refine(images, scene / "rough", output, threads=2, progress=progress)
    record = made.record
    assert model_identity(made.model) == model_identity(scene / "rough")
    assert record.features.rms_after > 1.1 * record.features.rms_before
    assert progress.notes == [record.kept]
    assert record.kept is not None and record.kept.endswith("the decimated cameras are kept")
    assert len(record.images) == 6 and not record.left_out
    assert sum(image.unmatched["weak"] for image in record.images) > 50
    assert np.isfinite(record.sigma0)


def test_of_usual_compression_they_are_refined(scene: Path, tmp_path: Path) -> None:
    made = refine(
        compressed(scene, tmp_path / "images", 50), scene / "rough", tmp_path / "model", threads=2
    )
    assert made.record.kept is None
    assert errors(made.model, scene)["centres"] < 0.7 * errors(scene / "rough", scene)["centres"]


def test_kept_cameras_are_without_photographs_that_cannot_be_read(
    scene: Path, tmp_path: Path
) -> None:
    images = compressed(scene, tmp_path / "images", 3)
    first, *others = sorted(path.name for path in images.iterdir())
    (images / first).write_bytes(b"no photograph")
    made = refine(images, scene / "rough", tmp_path / "model", threads=2)
    assert made.record.kept is not None
    assert [out.name for out in made.record.left_out] == [first]
    model, rough_model = pycolmap.Reconstruction(made.model), read_arrays(scene / "rough")
    assert sorted(image.name for image in model.images.values()) == others
    poses = {image.name: image.cam_from_world for image in rough_model.images}
    for image in read_arrays(made.model).images:
        np.testing.assert_array_equal(image.cam_from_world, poses[image.name])


def test_a_damaged_photograph_is_left_out_and_named(scene: Path, tmp_path: Path) -> None:
    images = tmp_path / "images"
    shutil.copytree(scene / "images", images)
    first, second, *_ = sorted(images.iterdir())
    first.write_bytes(first.read_bytes()[:3000])
    Image.open(second).rotate(90, expand=True).save(second)
    made = refine(images, scene / "rough", tmp_path / "model", threads=2)
    left_out = {out.name: out.reason for out in made.record.left_out}
    assert left_out.keys() == {first.name, second.name}
    assert "has 480x720 pixels, but its camera in the model 720x480" in left_out[second.name]
    assert read_left_out(tmp_path / "refinement.json") == made.record.left_out
    names = {image.name for image in pycolmap.Reconstruction(made.model).images.values()}
    assert names == {path.name for path in images.iterdir()} - left_out.keys()


def test_photographs_of_something_else_are_refused(scene: Path, tmp_path: Path) -> None:
    images = tmp_path / "images"
    images.mkdir()
    random = np.random.default_rng(1)
    for path in (scene / "images").iterdir():
        noise = random.integers(0, 255, (480, 720, 3), np.uint8)
        Image.fromarray(noise).save(images / path.name)
    with pytest.raises(InputError, match="are these the photographs that it was made of"):
        refine(images, scene / "rough", tmp_path / "model", threads=2)
    assert not (tmp_path / "model").exists() and not (tmp_path / "refinement.json").exists()
    assert not list(tmp_path.glob(".*"))


def test_sixteen_bit_photographs_serve_too(scene: Path, tmp_path: Path) -> None:
    import rasterio

    images = tmp_path / "images"
    images.mkdir()
    model = pycolmap.Reconstruction(scene / "rough")
    for image in model.images.values():
        pixels = np.asarray(Image.open(scene / "images" / image.name)).astype(np.uint16) * 16
        image.name = f"{Path(image.name).stem}.tif"
        with rasterio.open(
            images / image.name, "w", driver="GTiff", width=720, height=480, count=3, dtype="uint16"
        ) as raster:
            raster.write(np.moveaxis(pixels, 2, 0))
    (tmp_path / "rough").mkdir()
    model.write_binary(tmp_path / "rough")
    made = refine(images, tmp_path / "rough", tmp_path / "model", threads=2)
    assert made.record.rms_after < 0.2
