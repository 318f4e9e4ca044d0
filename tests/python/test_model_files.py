"""Damaged models end in one sentence that names the file; sound ones are read as pycolmap reads
them."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sirpy.errors import InputError
from sirpy.model_files import model_identity, read_model

BINARY = ("cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin")


def make_model() -> pycolmap.Reconstruction:
    """Two cameras of one lens that see 20 points."""
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, "OPENCV", 100.0, 64, 48)
    model.add_camera_with_trivial_rig(camera)
    generator = np.random.default_rng(3)
    points = generator.uniform([-1, -1, 4], [1, 1, 6], (20, 3))
    for image_id in (1, 2):
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([0.5 * image_id, 0.0, 0.0]))
        pixels = [camera.img_from_cam(pose * point) for point in points]
        image = pycolmap.Image(
            name=f"{image_id}.jpg", camera_id=1, image_id=image_id, keypoints=np.array(pixels)
        )
        model.add_image_with_trivial_frame(image, pose)
    for index, point in enumerate(points):
        track = pycolmap.Track()
        track.add_element(1, index)
        track.add_element(2, index)
        model.add_point3D(point, track)
    return model


@pytest.fixture
def binary(tmp_path: Path) -> Path:
    make_model().write_binary(tmp_path)
    return tmp_path


def test_binary_and_text_of_three_and_five_files_are_read(tmp_path: Path) -> None:
    for kind in ("binary", "text"):
        folder = tmp_path / kind
        folder.mkdir()
        model = make_model()
        model.write_binary(folder) if kind == "binary" else model.write_text(folder)
        for files in ("five", "three"):
            read = read_model(folder)
            assert (read.num_reg_images(), read.num_points3D()) == (2, 20), (kind, files)
            for extra in (*folder.glob("rigs.*"), *folder.glob("frames.*")):
                extra.unlink()


@pytest.mark.parametrize("subfolder", ["sparse", "0", "sparse/0"])
def test_the_folder_above_a_model_will_do(tmp_path: Path, subfolder: str) -> None:
    folder = tmp_path / subfolder
    folder.mkdir(parents=True)
    make_model().write_binary(folder)
    assert read_model(tmp_path).num_points3D() == 20


def test_several_models_are_a_question_to_the_user(tmp_path: Path) -> None:
    for name in ("0", "1"):
        (tmp_path / name).mkdir()
        make_model().write_binary(tmp_path / name)
    with pytest.raises(InputError, match="several models"):
        read_model(tmp_path)


@pytest.mark.parametrize("name", BINARY)
@pytest.mark.parametrize("part", [0.0, 0.3, 0.99])
def test_truncated_file_is_named(binary: Path, name: str, part: float) -> None:
    file = binary / name
    file.write_bytes(file.read_bytes()[: int(part * file.stat().st_size)])
    with pytest.raises(InputError, match=name):
        read_model(binary)


@pytest.mark.parametrize("name", BINARY)
def test_a_count_beyond_the_file_is_named_at_once(binary: Path, name: str) -> None:
    file = binary / name
    file.write_bytes(struct.pack("<Q", 1 << 60) + file.read_bytes()[8:])
    with pytest.raises(InputError, match=f"{name} is damaged"):
        read_model(binary)


@given(seed=st.integers(0, 10**6), name=st.sampled_from(BINARY[:3]), size=st.integers(0, 300))
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_random_bytes_are_refused(binary: Path, seed: int, name: str, size: int) -> None:
    good = (binary / name).read_bytes()
    (binary / name).write_bytes(random.Random(seed).randbytes(size))
    try:
        with pytest.raises(InputError, match=r"damaged|no images|no 3D points"):
            read_model(binary)
    finally:
        (binary / name).write_bytes(good)


def test_an_image_without_its_camera_is_refused(binary: Path) -> None:
    file = binary / "images.bin"
    data = bytearray(file.read_bytes())
    struct.pack_into("<I", data, 8 + 4 + 56, 77)  # the camera id of the first image
    file.write_bytes(data)
    with pytest.raises(InputError, match="camera 77, which does not exist"):
        read_model(binary)


def test_missing_and_empty_models_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no folder"):
        read_model(tmp_path / "nowhere")
    with pytest.raises(InputError, match="holds no COLMAP sparse model"):
        read_model(tmp_path)
    pycolmap.Reconstruction().write_binary(tmp_path)
    with pytest.raises(InputError, match="has no images"):
        read_model(tmp_path)
    model = make_model()
    for point in list(model.points3D):
        model.delete_point3D(point)
    model.write_binary(tmp_path)
    with pytest.raises(InputError, match="has no 3D points"):
        read_model(tmp_path)
    (tmp_path / "points3D.bin").unlink()
    with pytest.raises(InputError, match=r"has no points3D\.bin"):
        read_model(tmp_path)


def test_identity_is_of_the_content(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        make_model().write_binary(tmp_path / name)
    assert model_identity(tmp_path / "a") == model_identity(tmp_path / "b")
    data = bytearray((tmp_path / "b" / "points3D.bin").read_bytes())
    data[-1] ^= 1
    (tmp_path / "b" / "points3D.bin").write_bytes(data)
    assert model_identity(tmp_path / "a") != model_identity(tmp_path / "b")
