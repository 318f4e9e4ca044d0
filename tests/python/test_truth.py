"""The judge on surfaces that can be solved by hand."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from sirpy.errors import InputError
from sirpy.truth import Truth, evaluate_cloud


def box_on_a_plane() -> Truth:
    """Ground z = 0 of 20 x 20 m, and a box 0 <= x, y <= 2 of height 3 without its bottom; GSD 0.1
    m.
    """
    ground = [[-10, -10, 0], [10, -10, 0], [10, 10, 0], [-10, 10, 0]]
    box = [[x, y, z] for z in (0, 3) for x, y in ((0, 0), (2, 0), (2, 2), (0, 2))]
    quads = [[0, 1, 2, 3], [8, 9, 10, 11]]
    quads += [[4 + i, 4 + (i + 1) % 4, 8 + (i + 1) % 4, 8 + i] for i in range(4)]
    triangles = [t for a, b, c, d in quads for t in ([a, b, c], [a, c, d])]
    return Truth(np.array(ground + box, np.float64), np.array(triangles, np.int32), 0.1)


def nadir(x: float, y: float) -> pycolmap.Rigid3d:
    """cam_from_world of a camera 10 m above (x, y) that looks straight down, north up."""
    rotation = np.diag([1.0, -1.0, -1.0])
    return pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ [x, y, 10])


def pinhole() -> pycolmap.Camera:
    return pycolmap.Camera(
        camera_id=1, model="PINHOLE", width=100, height=80, params=[100, 100, 50, 40]
    )


def three_views() -> pycolmap.Reconstruction:
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(pinhole())
    for index, x in enumerate((-1.0, 1.0, 3.0), start=1):
        image = pycolmap.Image(name=f"{index}.jpg", camera_id=1, image_id=index)
        model.add_image_with_trivial_frame(image, nadir(x, 1.0))
    return model


def write_ply(path: Path, points: np.ndarray) -> Path:
    rows = np.zeros(len(points), [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    rows["x"], rows["y"], rows["z"] = np.asarray(points, np.float64).T
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    path.write_bytes(header.encode() + rows.tobytes())
    return path


def unprojected(depth: np.ndarray, cam_from_world: pycolmap.Rigid3d) -> np.ndarray:
    y, x = np.nonzero(depth)
    z = depth[y, x].astype(np.float64)
    in_camera = np.stack([(x + 0.5 - 50) / 100 * z, (y + 0.5 - 40) / 100 * z, z], axis=1)
    return cam_from_world.inverse() * in_camera


def test_depth_of_plane_and_box() -> None:
    depth = box_on_a_plane().depth_map(pinhole(), nadir(1.0, 1.0))
    assert depth.shape == (80, 100)
    # The box's top is 7 m away: half its side is 1 m, 100 / 7 = 14.3 pixels; centres 36 .. 63 are
    # inside.
    top = np.zeros_like(depth, bool)
    top[26:54, 36:64] = True
    assert np.allclose(depth[top], 7)
    assert np.allclose(depth[~top], 10)


def test_depth_of_a_slanted_view() -> None:
    # From (0, -5, 5), at 45 degrees down to the north: depth z of a pixel with ray (x, y, 1) is
    # 5 / (cos 45 (1 + y)).
    s = np.sqrt(0.5)
    rotation = np.array([[1, 0, 0], [0, -s, -s], [0, s, -s]])
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ [0, -5, 5])
    depth = box_on_a_plane().depth_map(pinhole(), pose)
    y = (60 + 0.5 - 40) / 100
    assert depth[60, 10] == pytest.approx(5 / (s * (1 + y)), rel=1e-6)


def test_a_moved_principal_point_shifts_the_map() -> None:
    whole = box_on_a_plane().depth_map(pinhole(), nadir(1.0, 1.0))
    part = pycolmap.Camera(
        model="PINHOLE", width=30, height=20, params=[100, 100, 50 - 31, 40 - 17]
    )
    assert np.array_equal(box_on_a_plane().depth_map(part, nadir(1.0, 1.0)), whole[17:37, 31:61])


def test_nothing_beyond_the_surface() -> None:
    assert not box_on_a_plane().depth_map(pinhole(), nadir(50.0, 0.0)).any()


def test_a_perfect_cloud_is_perfect(tmp_path: Path) -> None:
    truth, model = box_on_a_plane(), three_views()
    points = [
        unprojected(truth.depth_map(pinhole(), image.cam_from_world()), image.cam_from_world())
        for image in model.images.values()
    ]
    cloud = write_ply(tmp_path / "cloud.ply", np.concatenate(points))
    evaluation = evaluate_cloud(truth, model, cloud)
    assert min(evaluation.accuracy) > 0.9999
    assert min(evaluation.completeness) > 0.99
    assert evaluation.f1[0] == pytest.approx(
        2 / (1 / evaluation.accuracy[0] + 1 / evaluation.completeness[0])
    )


def test_a_lifted_cloud_is_off_by_the_lift(tmp_path: Path) -> None:
    truth, model = box_on_a_plane(), three_views()
    pose = nadir(1.0, 1.0)
    points = unprojected(truth.depth_map(pinhole(), pose), pose) + np.array([0, 0, 0.15])  # 1.5 GSD
    evaluation = evaluate_cloud(truth, model, write_ply(tmp_path / "cloud.ply", points))
    assert evaluation.accuracy[0] < 0.05  # the few beside the walls are near those
    assert evaluation.accuracy[1] > 0.9999
    assert evaluation.completeness[0] < 0.05


def test_half_a_cloud_is_half_complete(tmp_path: Path) -> None:
    truth, model = box_on_a_plane(), three_views()
    grid = np.arange(-3.975, 4, 0.05)
    x, y = np.meshgrid(grid, np.arange(-4.975, 7, 0.05))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    outside_box = ~((points[:, :2] > 0) & (points[:, :2] < 2)).all(axis=1)
    # Three views see x from -2 to 4 on the ground: half of that is x < 1.
    kept = points[outside_box & (points[:, 0] < 1)]
    evaluation = evaluate_cloud(truth, model, write_ply(tmp_path / "cloud.ply", kept), (1,))
    assert evaluation.accuracy[0] == 1
    assert evaluation.completeness[0] == pytest.approx(0.5, abs=0.05)


def test_an_empty_cloud_scores_nothing(tmp_path: Path) -> None:
    cloud = write_ply(tmp_path / "cloud.ply", np.empty((0, 3)))
    evaluation = evaluate_cloud(box_on_a_plane(), three_views(), cloud)
    assert evaluation.f1 == (0, 0, 0)
    assert evaluation.surface_points > 900


def test_truth_survives_its_file(tmp_path: Path) -> None:
    truth = box_on_a_plane()
    truth.write(tmp_path / "truth.npz")
    again = Truth.read(tmp_path / "truth.npz")
    assert again.gsd == truth.gsd
    points = np.array([[1.0, 1.0, 5.0], [5.0, 5.0, 0.5], [3.0, 1.0, 1.0]])
    assert again.distances(points, 10.0) == pytest.approx([2, 0.5, 1])


def test_broken_input_is_named(tmp_path: Path) -> None:
    truth, model = box_on_a_plane(), three_views()
    (tmp_path / "text.ply").write_text("ply\nformat ascii 1.0\nend_header\n")
    whole = write_ply(tmp_path / "cut.ply", np.ones((100, 3))).read_bytes()
    (tmp_path / "cut.ply").write_bytes(whole[:-1])
    (tmp_path / "truth.npz").write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"missing\.ply"):
        evaluate_cloud(truth, model, tmp_path / "missing.ply")
    with pytest.raises(InputError, match="binary little-endian"):
        evaluate_cloud(truth, model, tmp_path / "text.ply")
    with pytest.raises(InputError, match="cut short"):
        evaluate_cloud(truth, model, tmp_path / "cut.ply")
    with pytest.raises(InputError, match="ground truth"):
        Truth.read(tmp_path / "truth.npz")
