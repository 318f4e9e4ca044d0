"""Cameras with lens and pose."""

from __future__ import annotations

import numpy as np
import pycolmap
from sirpy.posed_camera import PosedCamera


def camera(model: str, params: list[float]) -> PosedCamera:
    lens = pycolmap.Camera(camera_id=1, model=model, width=400, height=300, params=params)
    turn = pycolmap.Rotation3d(np.array([0.1, -0.2, 0.3, 1.0]))
    turn.normalize()
    pose = pycolmap.Rigid3d(turn, np.array([1.0, 2.0, 3.0]))
    return PosedCamera("a.jpg", lens, np.array(pose.matrix()))


def test_points_on_rays_project_to_their_pixels() -> None:
    view = camera("OPENCV", [300, 310, 200, 150, -0.1, 0.02, 1e-3, -1e-3])
    pixels = np.random.default_rng(0).uniform([0, 0], [400, 300], (100, 2))
    depth = np.linspace(1, 50, 100)
    world = view.world(view.rays(pixels), depth)
    found, projected, depths = view.project(world)
    np.testing.assert_array_equal(found, np.arange(100))
    np.testing.assert_allclose(projected, pixels, atol=1e-6)
    np.testing.assert_allclose(depths, depth)
    np.testing.assert_allclose(view.in_camera(view.centre[None]), 0, atol=1e-12)


def test_points_behind_or_beside_the_frame_are_not_seen() -> None:
    view = camera("PINHOLE", [300, 300, 200, 150])
    rays = np.array([[0.0, 0.0], [0.0, 0.0], [0.66, 0.0], [0.67, 0.0]])  # the frame ends at 2/3
    world = view.world(rays, np.array([5.0, -5.0, 5.0, 5.0]))
    found, pixels = view.sees(world)
    np.testing.assert_array_equal(found, [0, 2])
    np.testing.assert_allclose(pixels, [[200, 150], [398, 150]])


def test_a_lens_that_folds_back_shows_nothing_from_far_outside() -> None:
    # r (1 - r^2 / 3) grows up to r = 1 and comes back to 0.3 at r = 1.56
    view = camera("SIMPLE_RADIAL", [500, 200, 150, -1 / 3])
    folded = np.array([[1.56, 0.0]])
    world = view.world(folded, np.array([2.0]))
    assert 200 < view.camera.img_from_cam(np.array([[1.56, 0, 1]]))[0, 0] < 400
    assert len(view.sees(world)[0]) == 0
