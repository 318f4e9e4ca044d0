"""The principal point is freed where the photographs determine it, and only there."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray
from sirpy.self_calibration import adjust

FOCAL, WIDTH, HEIGHT = 900.0, 1000, 800
OFFSET = np.array([12.0, -8.0])  # of the true principal point from the centre, px


def looking(
    centre: NDArray[np.float64], target: NDArray[np.float64], roll: float
) -> pycolmap.Rigid3d:
    """cam_from_world of a camera at `centre` that looks at `target`."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    rotation = np.array([c * right + s * down, -s * right + c * down, forward])
    return pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ centre)


def model_seen_from(poses: list[pycolmap.Rigid3d]) -> pycolmap.Reconstruction:
    """Observations by a camera whose principal point is off by OFFSET, in a model that does not
    know."""
    generator = np.random.default_rng(2)
    points = generator.uniform([-3, -3, -0.3], [3, 3, 0.3], (300, 3))
    true = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", FOCAL, WIDTH, HEIGHT)
    parameters = true.params
    parameters[1:3] += OFFSET
    true.params = parameters
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", FOCAL, WIDTH, HEIGHT)
    )
    for image_id, pose in enumerate(poses, start=1):
        pixels = np.array([true.img_from_cam(pose * point) for point in points])
        pixels += generator.normal(0, 0.3, pixels.shape)
        image = pycolmap.Image(
            name=f"{image_id}.jpg", camera_id=1, image_id=image_id, keypoints=pixels
        )
        model.add_image_with_trivial_frame(image, pose)
    for index, point in enumerate(points):
        track = pycolmap.Track()
        for image_id in range(1, len(poses) + 1):
            track.add_element(image_id, index)
        model.add_point3D(point, track)
    return model


def test_convergent_rolled_views_find_the_principal_point() -> None:
    angles = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    poses = [
        looking(np.array([5 * np.cos(a), 5 * np.sin(a), -8.0]), np.zeros(3), roll=2 * a)
        for a in angles
    ]
    (camera,) = adjust(model_seen_from(poses)).cameras.values()
    found = np.array([camera.principal_point_x, camera.principal_point_y])
    assert found == pytest.approx(np.array([WIDTH, HEIGHT]) / 2 + OFFSET, abs=1.0)
    assert camera.mean_focal_length() == pytest.approx(FOCAL, rel=2e-3)


def test_a_nadir_strip_keeps_the_centre() -> None:
    poses = [
        looking(np.array([x, 0.0, -8.0]), np.array([x, 0.0, 0.0]), roll=0.0)
        for x in np.linspace(-1.5, 1.5, 5)
    ]
    (camera,) = adjust(model_seen_from(poses)).cameras.values()
    assert (camera.principal_point_x, camera.principal_point_y) == (WIDTH / 2, HEIGHT / 2)
