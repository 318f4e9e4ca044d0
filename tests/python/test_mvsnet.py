"""The folder of MVSNet and PatchmatchNet, read by the rules of their published readers."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap
import pytest
from engine_scenes import Notes, assert_numbered_images_are, cut_town, expected_pixels
from numpy.typing import NDArray
from sirpy.cut_tasks import PixelOptions
from sirpy.cutting import cut
from sirpy.mvsnet import SIZE_MULTIPLE, write_mvsnet
from sirpy.rectangle import Grid
from sirpy.workspace import Workspace


class Camera(NamedTuple):
    intrinsics: NDArray[np.float64]
    extrinsics: NDArray[np.float64]
    depths: list[float]


def read_camera(path: Path) -> Camera:
    """PatchmatchNet, CasMVSNet: by line numbers. (They keep float32; here it is what stands there.)"""
    lines = path.read_text().split("\n")
    assert (lines[0], lines[5], lines[6], lines[10]) == ("extrinsic", "", "intrinsic", "")
    extrinsics = np.array(" ".join(lines[1:5]).split(), float).reshape(4, 4)
    intrinsics = np.array(" ".join(lines[7:10]).split(), float).reshape(3, 3)
    return Camera(intrinsics, extrinsics, [float(word) for word in lines[11].split()])


def read_pairs(path: Path) -> list[tuple[int, list[int]]]:
    """PatchmatchNet, CasMVSNet: sources are the words at odd places; views without any are passed over."""
    lines = path.read_text().splitlines()
    pairs = []
    for reference, sources in zip(lines[1::2], lines[2::2], strict=True):
        words = sources.split()
        assert len(words) == 1 + 2 * int(words[0])
        pairs.append((int(reference), [int(word) for word in words[1::2]]))
    assert len(pairs) == int(lines[0])
    return [pair for pair in pairs if pair[1]]


@pytest.fixture(scope="module")
def workspace(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    made = cut_town(town, tmp_path_factory.mktemp("mvsnet") / "out", same_size=SIZE_MULTIPLE)
    write_mvsnet(made, most_sources=7)
    return made


def _camera_path(workspace: Workspace, number: int) -> Path:
    return workspace.folder / "cams" / f"{number:0>8}_cam.txt"


def test_cameras_project_to_whole_number_pixel_centres(workspace: Workspace) -> None:
    expected = expected_pixels(workspace)
    assert len(list((workspace.folder / "cams").iterdir())) == len(expected) == 36
    for number, (world, pixels) in enumerate(expected):
        camera = read_camera(_camera_path(workspace, number))
        np.testing.assert_array_equal(camera.extrinsics[3], [0, 0, 0, 1])
        in_camera = world @ camera.extrinsics[:3, :3].T + camera.extrinsics[:3, 3]
        seen = in_camera @ camera.intrinsics.T
        np.testing.assert_allclose(seen[:, :2] / seen[:, 2:] + 0.5, pixels, atol=1e-6)
        low, high = camera.depths
        depth = in_camera[:, 2]
        assert ((depth > low) & (depth < high)).mean() > 0.9
        assert 0 < low < high


def test_images_have_their_numbers_and_one_size(workspace: Workspace) -> None:
    paths = [workspace.images / f"{number:0>8}.jpg" for number in range(36)]
    assert_numbered_images_are(workspace, paths)
    sizes = {(sub.stored.width, sub.stored.height) for _, sub in workspace.sub_images()}
    assert sizes == {(160, 128)}
    # A second name, not a second file.
    assert all(path.stat().st_nlink == 2 for path in paths)


def test_pairs_list_sub_images_of_other_photographs(workspace: Workspace) -> None:
    pairs = read_pairs(workspace.folder / "pair.txt")
    assert [reference for reference, _ in pairs] == list(range(36))
    photograph = [native.name for native, _ in workspace.sub_images()]
    for reference, sources in pairs:
        assert 1 <= len(sources) <= 7
        assert all(photograph[source] != photograph[reference] for source in sources)


def test_intervals_reach_from_the_least_to_the_greatest_depth(
    workspace: Workspace, town: Path, tmp_path: Path
) -> None:
    other = cut_town(town, tmp_path / "out", same_size=SIZE_MULTIPLE)
    notes = Notes()
    write_mvsnet(other, depths="interval", progress=notes)
    assert notes.notes == []
    for number in range(36):
        low, high = read_camera(_camera_path(workspace, number)).depths
        line = read_camera(_camera_path(other, number)).depths
        # MVSNet: planes at start + k interval; CasMVSNet: up to start + count interval.
        start, interval, count, end = line
        assert (start, end) == (low, high)
        np.testing.assert_allclose(start + (count - 1) * interval, high)
        assert start + int(count) * interval > high


def test_grey_images_are_said(town: Path, tmp_path: Path) -> None:
    made = cut_town(town, tmp_path / "out")
    name = next(sub.name for _, sub in made.sub_images())
    image = pycolmap.Bitmap.read(made.images / name, False)
    assert image.write(made.images / name)
    notes = Notes()
    write_mvsnet(made, progress=notes)
    assert f"{name} is grey, and MVSNet reads RGB" in notes.notes[-1]


def test_images_that_the_networks_would_resample_are_said(town: Path, tmp_path: Path) -> None:
    # 360 pixels less what undistortion takes, in one piece: growing them is not possible.
    whole = cut(
        town / "images",
        town / "sparse",
        tmp_path / "out",
        grid=Grid(1, 1),
        same_size=SIZE_MULTIPLE,
        pixels=PixelOptions(format="jpg"),
    )
    native = whole.natives[0]
    notes = Notes()
    write_mvsnet(whole, progress=notes)
    (note,) = [text for text in notes.notes if "no multiple of 32 pixels" in text]
    assert f"{native.sub_images[0].name} has {native.width}x{native.height}" in note
    assert "--same-size 32" in note and "more columns and rows" in note


def test_a_view_without_points_keeps_its_place_and_is_passed_over(
    town: Path, tmp_path: Path
) -> None:
    made = cut_town(town, tmp_path / "out")
    model = pycolmap.Reconstruction(made.native_model)
    blind = min(model.reg_image_ids(), key=lambda image_id: model.image(image_id).name)
    for index, point in enumerate(model.image(blind).points2D):
        if point.has_point3D():
            model.delete_observation(blind, index)
    model.write(made.native_model)
    notes = Notes()
    write_mvsnet(made, progress=notes)
    assert len(notes.notes) == 2 and "MVSNet expects images of one size" in notes.notes[0]
    lines = (made.folder / "pair.txt").read_text().splitlines()
    assert lines[:3] == ["36", "0", "0"]
    assert len(list((made.folder / "cams").iterdir())) == 36
    pairs = read_pairs(made.folder / "pair.txt")
    assert [reference for reference, _ in pairs] == list(range(6, 36))
    assert min(source for _, sources in pairs for source in sources) >= 6
