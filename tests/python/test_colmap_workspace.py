"""The dense workspace as COLMAP and OpenMVS's InterfaceCOLMAP read it."""

from __future__ import annotations

import os
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import pycolmap
import pytest
from engine_scenes import cut_town, expected_pixels, write_plane_maps
from numpy.typing import NDArray
from sirpy.colmap_launcher import installed_colmap
from sirpy.colmap_workspace import write_dense_folder
from sirpy.ply import read_vertices
from sirpy.workspace import Workspace

COLMAP = installed_colmap(os.environ.get("PATH", os.defpath))
needs_colmap = pytest.mark.skipif(COLMAP is None, reason="no COLMAP is installed")


@pytest.fixture(scope="module")
def workspace(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    made = cut_town(town, tmp_path_factory.mktemp("dense") / "out")
    write_dense_folder(made, 5)
    return made


def _lines(path: Path) -> list[str]:
    return path.read_text().splitlines()


def _median_points(workspace: Workspace) -> int:
    """Half of the sub-images see fewer sparse points."""
    model = pycolmap.Reconstruction(workspace.sparse)
    return int(np.median([model.image(i).num_points3D for i in model.reg_image_ids()]))


def _run(*words: object) -> str:
    command = [str(COLMAP), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@needs_colmap
def test_colmap_converts_and_analyses_the_model(workspace: Workspace, tmp_path: Path) -> None:
    text = tmp_path / "text"
    text.mkdir()
    _run("model_converter", "--input_path", workspace.sparse, "--output_path", text,
         "--output_type", "TXT")  # fmt: skip
    cameras = [line.split() for line in _lines(text / "cameras.txt") if line[0] != "#"]
    assert len(cameras) == 36 and {words[1] for words in cameras} == {"PINHOLE"}
    assert "Registered images: 36" in _run("model_analyzer", "--path", workspace.sparse)


@needs_colmap
def test_colmap_fuses_maps_of_all_sub_images(town: Path, tmp_path: Path) -> None:
    made = cut_town(town, tmp_path / "out")
    lists = write_dense_folder(made, 5, min_points=_median_points(made))
    assert len(lists.few_points) > 10
    names = [sub.name for _, sub in made.sub_images()]
    assert sorted(_lines(made.fusion_config)) == sorted(names)
    write_plane_maps(made, made.stereo, names)
    _run("stereo_fusion", "--workspace_path", made.folder, "--output_path", tmp_path / "c.ply")
    points = read_vertices(tmp_path / "c.ply")
    assert len(points) > 20_000
    # COLMAP takes the corner of a pixel for its centre: half a pixel is 0.05 m here.
    np.testing.assert_allclose(points["z"], 0, atol=0.1)


def test_sub_images_with_few_points_have_their_depths_and_sources(
    town: Path, tmp_path: Path
) -> None:
    made = cut_town(town, tmp_path / "out")
    least = _median_points(made)
    lists = write_dense_folder(made, 5, min_points=least)
    assert len(lists.few_points) > 10
    seen = [len(world) for world, _ in expected_pixels(made)]
    subs = list(made.sub_images())
    main = _lines(made.patch_match_config)[::2]
    assert _lines(made.patch_match_config)[1::2] == ["__auto__, 5"] * len(main)
    assert sorted([*main, *lists.few_points, *lists.unlisted]) == sorted(s.name for _, s in subs)
    # A point may project into a sub-image that does not observe it.
    assert all(n >= least for (_, s), n in zip(subs, seen, strict=True) if s.name in main)
    photograph = {sub.name: native.name for native, sub in subs}
    listed = []
    for path in sorted((made.stereo / "few-points").iterdir()):
        head, *lines = _lines(path)
        mark, name_of_low, low, name_of_high, high = head.split()
        assert (mark, name_of_low, name_of_high) == ("#", "depth_min", "depth_max")
        for name, sources in zip(lines[::2], lines[1::2], strict=True):
            assert photograph[name] == photograph[lines[0]]
            assert 1 <= len(sources.split(", ")) <= 5
            assert all(photograph[one] != photograph[name] for one in sources.split(", "))
        # The town is seen from about 100 m.
        assert 0 < float(low) < float(high)
        listed += lines[::2]
    assert sorted(listed) == sorted(lists.few_points)


def test_folders_of_names_are_there_for_the_maps(town: Path, tmp_path: Path) -> None:
    """COLMAP writes maps under the image's name, and makes no folders."""
    made = cut_town(town, tmp_path / "out")
    natives = [
        (native.name, [f"strip 1/{sub.name}" for sub in native.sub_images])
        for native in made.natives
    ]
    text = made.index.read_text()
    for _, names in natives:
        for name in names:
            text = text.replace(f'"{name.removeprefix("strip 1/")}"', f'"{name}"')
    made.index.write_text(text)
    write_dense_folder(Workspace(made.folder), 5)
    for kind in ("depth_maps", "normal_maps", "consistency_graphs"):
        assert (made.stereo / kind / "strip 1").is_dir()


# ---- OpenMVS: the rules of apps/InterfaceCOLMAP


class Pinhole(NamedTuple):
    width: int
    height: int
    matrix: NDArray[np.float64]  # 3 x 3


class Posed(NamedTuple):
    name: str
    camera: int
    cam_from_world: NDArray[np.float64]  # 3 x 4


def _records(path: Path) -> Iterator[tuple[BinaryIO, int]]:
    with path.open("rb") as file:
        (count,) = struct.unpack("<Q", file.read(8))
        for index in range(count):
            yield file, index
        assert file.read(1) == b""


def _read(file: BinaryIO, layout: str) -> tuple[float, ...]:
    return struct.unpack(f"<{layout}", file.read(struct.calcsize(f"<{layout}")))


def _scaled(matrix: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
    """OpenMVS scales the principal point about the corner of the first pixel, at (-0.5, -0.5)."""
    corner = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    return np.linalg.inv(corner) @ np.diag([scale, scale, 1]) @ corner @ matrix


def read_as_openmvs(
    folder: Path,
) -> tuple[dict[int, Pinhole], dict[int, Posed], list[tuple[tuple[float, ...], list[int]]]]:
    """Cameras (normalised by the longer side and back, as it does), images, points with views."""
    # It takes text where there is any, and reads only binary files of PINHOLE cameras.
    assert not list((folder / "sparse").glob("*.txt"))
    cameras, images, points = {}, {}, []
    for file, _ in _records(folder / "sparse" / "cameras.bin"):
        camera_id, model, width, height = _read(file, "IiQQ")
        assert model == 1
        fx, fy, cx, cy = _read(file, "dddd")
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        longest = max(width, height)
        there_and_back = _scaled(_scaled(matrix, 1 / longest), longest)
        cameras[int(camera_id)] = Pinhole(int(width), int(height), there_and_back)
    for file, _ in _records(folder / "sparse" / "images.bin"):
        (image_id,) = _read(file, "I")
        w, x, y, z, *translation = _read(file, "7d")
        (camera_id,) = _read(file, "I")
        name = b"".join(iter(lambda file=file: file.read(1), b"\0")).decode()
        (count,) = _read(file, "Q")
        file.seek(24 * int(count), 1)
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        pose = np.column_stack([rotation, translation])
        images[int(image_id)] = Posed(name, int(camera_id), pose)
    for file, _ in _records(folder / "sparse" / "points3D.bin"):
        _, *xyz = _read(file, "Qddd")
        _read(file, "BBBd")
        (length,) = _read(file, "Q")
        assert length  # it stops reading at the first point without a view
        track = _read(file, f"{2 * int(length)}I")
        points.append((tuple(xyz), [int(image) for image in track[::2]]))
    return cameras, images, points


def test_openmvs_reads_cameras_images_and_points(workspace: Workspace) -> None:
    cameras, images, points = read_as_openmvs(workspace.folder)
    assert len(cameras) == len(images) == 36
    by_name = {image.name: image for image in images.values()}
    expected = expected_pixels(workspace)
    for (_, sub), (world, pixels) in zip(workspace.sub_images(), expected, strict=True):
        assert (workspace.folder / "images" / sub.name).is_file()
        image = by_name[sub.name]
        camera = cameras[image.camera]
        assert (camera.width, camera.height) == (sub.stored.width, sub.stored.height)
        homogeneous = np.column_stack([world, np.ones(len(world))])
        seen = homogeneous @ (camera.matrix @ image.cam_from_world).T
        np.testing.assert_allclose(seen[:, :2] / seen[:, 2:], pixels, atol=1e-6)
    assert points and all(set(views) <= images.keys() for _, views in points)
    # With depth_maps/ there, it wants the list of patch match; "__auto__" tells it nothing.
    assert _lines(workspace.patch_match_config)
    # Overlap puts a point into several sub-images of one photograph: still one view each.
    assert all(len(set(views)) == len(views) for _, views in points)
