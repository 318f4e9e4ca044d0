"""Models as arrays against pycolmap and COLMAP 3.8: what is read, and what is written."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from sirpy import _core
from sirpy.errors import InputError, OutputError
from sirpy.model_arrays import SparseModel, read_arrays, write_model
from sub_image_scenes import LENSES, camera, model_of

FILES = ("cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin")


def all_lenses() -> pycolmap.Reconstruction:
    """An image of every camera model; each has a keypoint without a point."""
    names = [f"{name}/ä {i}.jpg" for i, name in enumerate(LENSES)]
    return model_of(names, [camera(name, 3 + 2 * i) for i, name in enumerate(LENSES)], points=60)


def rig() -> pycolmap.Reconstruction:
    """Two cameras on one rig, at one moment."""
    model = pycolmap.Reconstruction()
    kind = pycolmap.SensorType.CAMERA
    made = pycolmap.Rig(rig_id=5)
    second_from_rig = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0, 0.1, 0])), np.ones(3))
    for i in (1, 2):
        model.add_camera(camera("PINHOLE", i))
    made.add_ref_sensor(pycolmap.sensor_t(kind, 1))
    made.add_sensor(pycolmap.sensor_t(kind, 2), second_from_rig)
    model.add_rig(made)
    frame = pycolmap.Frame(frame_id=3, rig_id=5)
    frame.rig = model.rig(5)
    frame.rig_from_world = pycolmap.Rigid3d(
        pycolmap.Rotation3d(np.array([0.3, 0.1, 0])), np.array([1.0, 2, 3])
    )
    for i in (1, 2):
        frame.add_data_id(pycolmap.data_t(pycolmap.sensor_t(kind, i), i))
    model.add_frame(frame)
    for i in (1, 2):
        image = pycolmap.Image(name=f"{i}.jpg", camera_id=i, image_id=i, keypoints=np.ones((1, 2)))
        image.frame_id = 3
        model.add_image(image)
    model.register_frame(3)
    model.add_point3D(np.ones(3), pycolmap.Track([pycolmap.TrackElement(i, 0) for i in (1, 2)]))
    return model


def assert_same(found: SparseModel, expected: pycolmap.Reconstruction) -> None:
    assert set(found.cameras) == set(expected.cameras)
    for camera_id, ours in found.cameras.items():
        theirs = expected.camera(camera_id)
        assert (ours.model, ours.width, ours.height) == (theirs.model, theirs.width, theirs.height)
        np.testing.assert_array_equal(ours.params, theirs.params)
    assert {i.image_id: i.name for i in found.images} == {
        i: expected.image(i).name for i in expected.reg_image_ids()
    }
    for index, image in enumerate(found.images):
        theirs = expected.image(image.image_id)
        assert image.camera_id == theirs.camera_id
        np.testing.assert_allclose(
            image.cam_from_world, theirs.cam_from_world().matrix(), atol=1e-15
        )
        seen = [point2d for point2d in theirs.points2D if point2d.has_point3D()]
        rows = found.seen(index)
        np.testing.assert_array_equal(
            found.xy[rows], np.array([point2d.xy for point2d in seen]).reshape(-1, 2)
        )
        assert found.point_ids[found.point[rows]].tolist() == [p.point3D_id for p in seen]
    assert set(found.point_ids.tolist()) == set(expected.point3D_ids())
    for index, point_id in enumerate(found.point_ids.tolist()):
        theirs = expected.point3D(point_id)
        np.testing.assert_array_equal(found.points[index], theirs.xyz)
        np.testing.assert_array_equal(found.colors[index], theirs.color)
        assert found.errors[index] == theirs.error


@pytest.mark.parametrize("make", [all_lenses, rig])
@pytest.mark.parametrize("source", ["binary", "three files", "text", "memory"])
def test_what_is_read_is_what_pycolmap_reads(
    tmp_path: Path, make: type[pycolmap.Reconstruction], source: str
) -> None:
    model = make()
    if source == "memory":
        assert_same(read_arrays(model), model)
        return
    model.write_text(tmp_path) if source == "text" else model.write_binary(tmp_path)
    if source == "three files":
        (tmp_path / "rigs.bin").unlink()
        (tmp_path / "frames.bin").unlink()
    assert_same(read_arrays(tmp_path), pycolmap.Reconstruction(tmp_path))


def test_every_camera_model_of_pycolmap_is_known() -> None:
    numbers = {}
    for name, model in pycolmap.CameraModelId.__members__.items():
        if name != "INVALID":
            made = pycolmap.Camera.create_from_model_id(0, model, 1.0, 1, 1)
            numbers[int(model)] = len(made.params)
    last = max(numbers)
    assert {i: _core.num_camera_parameters(i) for i in range(last + 1)} == numbers
    assert _core.num_camera_parameters(-1) == _core.num_camera_parameters(last + 1) == -1


def test_the_files_are_those_that_pycolmap_writes(tmp_path: Path) -> None:
    """Byte by byte, once neither has keypoints without points."""
    write_model(read_arrays(all_lenses()), tmp_path / "ours")
    again = pycolmap.Reconstruction(tmp_path / "ours")
    assert_same(read_arrays(tmp_path / "ours"), again)
    (tmp_path / "theirs").mkdir()
    again.write_binary(tmp_path / "theirs")
    for name in FILES:
        assert (tmp_path / "ours" / name).read_bytes() == (tmp_path / "theirs" / name).read_bytes()


def test_a_model_replaces_the_one_before_it(tmp_path: Path) -> None:
    model = read_arrays(all_lenses())
    write_model(model, tmp_path / "sparse")
    (tmp_path / "sparse" / "points3D.txt").touch()  # of what else wrote a model there
    write_model(model.taking([0, 2]), tmp_path / "sparse")
    assert [path.name for path in tmp_path.iterdir()] == ["sparse"]
    assert sorted(path.name for path in (tmp_path / "sparse").iterdir()) == sorted(FILES)
    assert len(read_arrays(tmp_path / "sparse").images) == 2


def test_a_folder_with_anything_but_a_model_is_not_replaced(tmp_path: Path) -> None:
    model = read_arrays(all_lenses())
    (tmp_path / "notes.txt").touch()
    for folder in (tmp_path, tmp_path / "new" / ".."):
        with pytest.raises(OutputError, match=r"holds notes\.txt, no part of a model; choose"):
            write_model(model, folder)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.skipif(shutil.which("colmap") is None, reason="needs the program colmap")
def test_colmap_reads_and_converts_the_model(tmp_path: Path) -> None:
    known = ("PINHOLE", "SIMPLE_RADIAL", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE", "FOV")
    cameras = [camera(name, i) for i, name in enumerate(known, 1)]
    model = read_arrays(model_of([f"{i}.jpg" for i in range(len(known))], cameras))
    write_model(model, tmp_path / "sparse")
    said = _colmap("model_analyzer", "--path", str(tmp_path / "sparse"))
    assert f"Images: {len(known)}" in said
    assert f"Points: {len(model.points)}" in said
    assert f"Observations: {len(model.point)}" in said
    (tmp_path / "text").mkdir()
    folders = ["--input_path", str(tmp_path / "sparse"), "--output_path", str(tmp_path / "text")]
    _colmap("model_converter", *folders, "--output_type", "TXT")
    # The text has three files, as 3.8 writes them, with poses of 9 digits.
    converted = pycolmap.Reconstruction(tmp_path / "text")
    assert converted.num_points3D() == len(model.points)
    for image in model.images:
        pose = converted.image(image.image_id).cam_from_world()
        np.testing.assert_allclose(pose.matrix(), image.cam_from_world, atol=1e-9)


def _colmap(*arguments: str) -> str:
    environment = {**os.environ, "QT_QPA_PLATFORM": "offscreen"}
    done = subprocess.run(
        ["colmap", *arguments], capture_output=True, text=True, timeout=60, env=environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


_FULL_DISK = """
import resource, sys
from pathlib import Path
from sirpy.errors import OutputError
from sirpy.model_arrays import read_arrays, write_model
model = read_arrays(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), int(sys.argv[3])))
try:
    write_model(model, Path(sys.argv[2]))
except OutputError as error:
    print(error)
"""


@pytest.mark.parametrize("limit", [0, 1000, 10_000])
def test_a_disk_that_takes_no_more_leaves_what_was_there(tmp_path: Path, limit: int) -> None:
    model = read_arrays(all_lenses())
    source, target = tmp_path / "source", tmp_path / "out" / "sparse"
    write_model(model, source)
    write_model(model.taking([0]), target)
    before = {path.name: path.read_bytes() for path in target.iterdir()}
    command = [sys.executable, "-c", _FULL_DISK, str(source), str(target), str(limit)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.stdout.startswith(f"cannot write the model {target}: File too large"), done.stderr
    assert done.stdout.count("\n") == 1
    assert {path.name: path.read_bytes() for path in target.iterdir()} == before
    assert [path.name for path in target.parent.iterdir()] == ["sparse"]


def test_taking_keeps_the_points_that_are_seen() -> None:
    model = read_arrays(
        model_of(["a.jpg", "b.jpg", "c.jpg"], [camera("PINHOLE", i) for i in (1, 2, 3)])
    )
    taken = model.taking([2, 0])
    assert [image.name for image in taken.images] == ["c.jpg", "a.jpg"]
    assert taken.cameras.keys() == {1, 3}
    for index, before in enumerate((2, 0)):
        old, new = model.seen(before), taken.seen(index)
        np.testing.assert_array_equal(taken.xy[new], model.xy[old])
        np.testing.assert_array_equal(
            taken.points[taken.point[new]], model.points[model.point[old]]
        )
    assert set(taken.point) == set(range(len(taken.points)))
    assert len(model.taking([]).points) == 0


def test_a_model_in_memory_that_cannot_be_used(tmp_path: Path) -> None:
    model = model_of(["a\nb.jpg"], [camera("PINHOLE")])
    with pytest.raises(InputError, match="the model in memory cannot be used"):
        read_arrays(model)
