"""The rendered scene agrees with its own model and ground truth."""

import os
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from sirpy import _core, synthetic
from sirpy.errors import InputError, SirpyError
from sirpy.flight import GSD, flying_height, make_camera, plan_flight

SIZE = (240, 160)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("opencv")
    return synthetic.render_scene(folder, image_count=5, size=SIZE, seed=3)


@pytest.fixture(scope="module")
def model(scene: Path) -> pycolmap.Reconstruction:
    return pycolmap.Reconstruction(str(scene / "sparse"))


@pytest.fixture(autouse=True)
def no_word_of_georeference() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


def read(path: Path) -> np.ndarray:
    with rasterio.open(path) as file:
        return np.moveaxis(file.read(), 0, -1).astype(np.float64)


def test_the_folder_holds_photographs_model_and_truth(
    scene: Path, model: pycolmap.Reconstruction
) -> None:
    names = sorted(image.name for image in model.images.values())
    assert sorted(path.name for path in (scene / "images").iterdir()) == names
    assert len(names) == 5
    assert sorted(os.listdir(scene)) == ["images", "sparse", "truth.npz"]
    assert [camera.model.name for camera in model.cameras.values()] == ["OPENCV"]
    for name in names:
        assert read(scene / "images" / name).shape == (SIZE[1], SIZE[0], 3)


def test_photographs_have_texture_down_to_the_pixel(scene: Path) -> None:
    for path in (scene / "images").iterdir():
        grey = read(path).mean(axis=2)
        assert 50 < grey.mean() < 200
        assert np.median(np.abs(np.diff(grey, axis=1))) > 2


def test_observations_are_exact(model: pycolmap.Reconstruction) -> None:
    assert model.num_points3D() > 500
    assert model.compute_mean_track_length() > 2.5
    assert model.compute_mean_reprojection_error() < 1e-9


def test_sparse_points_lie_on_the_surface_and_are_seen(
    scene: Path, model: pycolmap.Reconstruction
) -> None:
    truth = synthetic.read_truth(scene)
    points = np.array([point.xyz for point in model.points3D.values()])
    assert truth.distances(points, 1.0).max() < 1e-6
    for image in model.images.values():
        observed = [p.point3D_id for p in image.points2D if p.has_point3D()]
        points = np.array([model.point3D(index).xyz for index in observed])
        way = truth.surface.cast(image.projection_center(), points - image.projection_center())
        assert way == pytest.approx(np.ones(len(way)), abs=1e-4)


def test_depth_maps_agree_with_the_points(scene: Path, model: pycolmap.Reconstruction) -> None:
    """The depth at the pixel of an observation is that of its point, but where a pixel holds an
    edge.
    """
    truth = synthetic.read_truth(scene)
    pinhole = make_camera("PINHOLE", SIZE)
    for image in model.images.values():
        depth = truth.depth_map(pinhole, image.cam_from_world())
        ids = [p.point3D_id for p in image.points2D if p.has_point3D()]
        in_camera = image.cam_from_world() * np.array([model.point3D(i).xyz for i in ids])
        column, row = np.floor(pinhole.img_from_cam(in_camera)).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < SIZE[0]) & (row < SIZE[1])
        error = np.abs(depth[row[inside], column[inside]] - in_camera[inside, 2])
        assert np.median(error) < 0.03  # the slope of the ground within a pixel
        assert np.mean(error < 0.5) > 0.95


def test_the_lens_moves_pixels_and_nothing_else(scene: Path, tmp_path: Path) -> None:
    """A pixel of the OPENCV photograph has the colour of the PINHOLE one where its ray points."""
    flat = synthetic.render_scene(
        tmp_path, image_count=5, size=SIZE, seed=3, camera_model="PINHOLE"
    )
    lens, pinhole = make_camera("OPENCV", SIZE), make_camera("PINHOLE", SIZE)
    x, y = np.meshgrid(np.arange(20, SIZE[0] - 20) + 0.5, np.arange(20, SIZE[1] - 20) + 0.5)
    rays = lens.cam_from_img(np.stack([x.ravel(), y.ravel()], axis=1))
    places = pinhole.img_from_cam(np.column_stack([rays, np.ones(len(rays))])) - 0.5
    assert np.abs(places + 0.5 - np.stack([x.ravel(), y.ravel()], axis=1)).max() > 1
    for name in ("strip1_001.jpg", "oblique_001.jpg"):
        image, other = read(scene / "images" / name), read(flat / "images" / name)
        column, row = np.floor(places).astype(int).T
        right, down = (places - np.floor(places)).T[:, :, None]
        expected = (1 - down) * ((1 - right) * other[row, column] + right * other[row, column + 1])
        expected += down * (
            (1 - right) * other[row + 1, column] + right * other[row + 1, column + 1]
        )
        seen = image[20:-20, 20:-20].reshape(-1, 3)
        moved = np.corrcoef(expected[:, 1], seen[:, 1])[0, 1]
        unmoved = np.corrcoef(other[20:-20, 20:-20, 1].ravel(), seen[:, 1])[0, 1]
        assert moved > 0.97
        assert moved > unmoved


def test_threads_do_not_change_the_files(scene: Path, tmp_path: Path) -> None:
    again = synthetic.render_scene(tmp_path, image_count=5, size=SIZE, seed=3, threads=1)
    for path in sorted(scene.rglob("*.*")):
        if path.suffix != ".npz":  # a zip file holds the time
            assert path.read_bytes() == (again / path.relative_to(scene)).read_bytes(), path


def test_the_seed_makes_another_town(scene: Path, tmp_path: Path) -> None:
    other = synthetic.render_scene(tmp_path, image_count=2, size=(64, 48), seed=4)
    assert other == tmp_path
    first, second = synthetic.read_truth(scene), synthetic.read_truth(other)
    assert not np.array_equal(first.surface.vertices[:100], second.surface.vertices[:100])


def test_photographs_overlap_at_the_height_of_the_middle() -> None:
    size, middle = (1200, 900), (30.0, -20.0, 72.0)  # two thirds of the flying height
    shots = plan_flight(12, size, 1, middle)
    nadir = np.array([shot.centre for shot in shots if shot.name.startswith("strip1")])
    forward = 0.2 * size[1] * GSD / 3
    assert np.diff(nadir[:, 1]).mean() == pytest.approx(forward, abs=0.5)
    assert nadir[:, 2] == pytest.approx(flying_height(size), abs=2)
    for shot in shots:
        if shot.name.startswith("oblique"):
            x, y, z = shot.cam_from_world @ (middle - shot.centre)
            assert np.hypot(x, y) < 0.2 * z


def test_keypoint_noise_is_what_was_asked(tmp_path: Path) -> None:
    folder = synthetic.render_scene(tmp_path, image_count=3, size=SIZE, keypoint_noise=0.5)
    model = pycolmap.Reconstruction(str(folder / "sparse"))
    # The mean length of a normal deviate in two dimensions is sigma sqrt(pi / 2).
    assert model.compute_mean_reprojection_error() == pytest.approx(0.627, abs=0.05)


def test_exact_depth_maps_evaluate_to_one_and_shifted_ones_do_not(
    scene: Path, model: pycolmap.Reconstruction, tmp_path: Path
) -> None:
    truth = synthetic.read_truth(scene)
    pinhole = make_camera("PINHOLE", (300, 200))  # a little wider than the photographs
    pinhole.params = [216, 216, 150, 100]
    points = []
    for image in model.images.values():
        pose = image.cam_from_world()
        depth = truth.depth_map(pinhole, pose)
        row, column = np.nonzero(depth)
        rays = pinhole.cam_from_img(np.stack([column + 0.5, row + 0.5], axis=1))
        in_camera = np.column_stack([rays, np.ones(len(rays))]) * depth[row, column, None]
        points.append(pose.inverse() * in_camera)
    cloud = np.concatenate(points)
    perfect = synthetic.evaluate(scene, write_ply(tmp_path / "perfect.ply", cloud))
    assert min(perfect.accuracy) > 0.999
    assert perfect.completeness[0] > 0.98
    assert perfect.completeness[1] > 0.995
    shifted = synthetic.evaluate(
        scene,
        write_ply(tmp_path / "shifted.ply", cloud + np.array([0, 0, 0.3])),
        thresholds=(1, 2, 5),
    )
    assert shifted.accuracy[1] < 0.4
    assert shifted.completeness[1] < 0.4
    assert shifted.accuracy[2] > 0.99


def write_ply(path: Path, points: np.ndarray) -> Path:
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        "property double x\nproperty double y\nproperty double z\nend_header\n"
    )
    path.write_bytes(header.encode() + np.ascontiguousarray(points, "<f8").tobytes())
    return path


def test_a_users_mistake_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least 2 photographs"):
        synthetic.render_scene(tmp_path / "a", image_count=1)
    with pytest.raises(InputError, match="PINHOLE or OPENCV"):
        synthetic.render_scene(tmp_path / "b", camera_model="FISHEYE")
    with pytest.raises(InputError, match="must not be negative"):
        synthetic.render_scene(tmp_path / "d", tall=-1)
    with pytest.raises(InputError, match="cannot look down"):
        synthetic.render_scene(tmp_path / "e", size=(64, 48), tall=20)
    with pytest.raises(InputError, match="too small"):
        synthetic.render_scene(tmp_path / "c", size=(8, 8))
    (tmp_path / "file").touch()
    with pytest.raises(SirpyError, match="file"):
        synthetic.render_scene(tmp_path / "file", image_count=2, size=(32, 32))
    with pytest.raises(InputError, match=r"truth\.npz"):
        synthetic.evaluate(tmp_path, tmp_path / "cloud.ply")


def test_the_core_refuses_arrays_of_another_type() -> None:
    with pytest.raises(TypeError):
        _core.nearest_distances(np.zeros((1, 3), np.float32), np.zeros((1, 3)), 1.0)
    with pytest.raises(TypeError):
        _core.nearest_distances(np.zeros((1, 6))[:, ::2], np.zeros((1, 3)), 1.0)
