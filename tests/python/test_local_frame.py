"""Which way is up, and the frame without a georeference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import plane_scene
from scipy.spatial.transform import Rotation
from sirpy.local_frame import is_z_up, local_frame, up_direction
from sirpy.native_scene import NativeCamera, NativeScene

Floats = npt.NDArray[np.float64]

ABOVE = plane_scene(count=6, width=600, height=400)  # looks down at z = 0


def turned(scene: NativeScene, rotation: Floats) -> NativeScene:
    """The same scene in another frame."""

    def camera(one: NativeCamera) -> NativeCamera:
        pose = np.column_stack([one.cam_from_world[:, :3] @ rotation.T, one.cam_from_world[:, 3]])
        return NativeCamera(one.name, one.width, one.height, one.intrinsics, pose)

    cameras = {name: camera(one) for name, one in scene.cameras.items()}
    return replace(scene, cameras=cameras, points=scene.points @ rotation.T)


def looking(centres: Floats, targets: Floats, points: Floats) -> NativeScene:
    """Level, upright cameras at (n, 3) places that look at others."""
    cameras = {}
    for number, (centre, target) in enumerate(zip(centres, targets, strict=True)):
        forward = (target - centre) / np.linalg.norm(target - centre)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        axes = np.array([right, np.cross(forward, right), forward])
        pose = np.column_stack([axes, -axes @ centre])
        cameras[f"{number}"] = NativeCamera(f"{number}", 600, 400, np.eye(3), pose)
    return NativeScene(cameras, points, {})


def test_a_survey_is_left_as_it_is() -> None:
    frame, what = local_frame(ABOVE)
    assert frame.scale == 1 and "already" in what
    assert (frame.rotation == np.eye(3)).all() and (frame.translation == 0).all()


@pytest.mark.parametrize("degrees", [-9, 4, 9])
def test_so_is_one_whose_cameras_swing(degrees: float) -> None:
    swung = turned(ABOVE, Rotation.from_euler("xy", [degrees, 5], degrees=True).as_matrix())
    assert is_z_up(swung)


def test_so_is_a_survey_of_a_wall_and_one_of_slopes() -> None:
    random = np.random.default_rng(0)
    wall = np.column_stack([random.uniform(-9, 9, 500), np.zeros(500), random.uniform(0, 8, 500)])
    street = np.array([[x, -10, 1.6] for x in (-6.0, -3, 0, 3, 6)])
    assert is_z_up(looking(street, street + np.array([0, 1, 0.1]), wall))
    hill = turned(ABOVE, Rotation.from_euler("y", 40, degrees=True).as_matrix()).points
    assert is_z_up(replace(ABOVE, points=hill))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_any_other_model_is_turned_up(seed: int) -> None:
    # As from structure from motion: its axes are those of the first photograph.
    first = next(iter(ABOVE.cameras.values())).cam_from_world[:, :3]
    swing = Rotation.from_rotvec(np.random.default_rng(seed).uniform(-0.4, 0.4, 3))
    rotation = swing * Rotation.from_matrix(first)
    scene = turned(ABOVE, rotation.as_matrix())
    frame, what = local_frame(scene)
    assert "local frame" in what
    assert (frame.rotation @ rotation.apply([0, 0, 1.0]))[2] == pytest.approx(1, abs=1e-4)
    np.testing.assert_allclose(frame.rotation @ frame.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame.rotation) > 0
    heights = frame.world(scene.points)[:, 2]
    assert np.percentile(heights, 25) == pytest.approx(0, abs=1e-9)
    centres = np.array([camera.centre for camera in scene.cameras.values()])
    assert (frame.world(centres)[:, 2] > 50).all()


def test_stray_points_do_not_tilt_the_plane() -> None:
    random = np.random.default_rng(1)
    stray = random.uniform(-500, 500, (600, 3))
    up = up_direction(replace(ABOVE, points=np.concatenate([ABOVE.points, stray])))
    assert up[2] > np.cos(np.radians(0.5))


def test_level_cameras_tell_a_wall_from_the_ground() -> None:
    random = np.random.default_rng(2)
    wall = np.column_stack([random.uniform(-9, 9, 500), np.zeros(500), random.uniform(0, 8, 500)])
    angles = np.radians([20, 50, 80, 110, 140, 170])
    around = np.column_stack([12 * np.cos(angles), -12 * np.sin(angles), np.full(6, 1.6)])
    scene = looking(around, np.broadcast_to([0, 0, 3.0], (6, 3)), wall)
    np.testing.assert_allclose(up_direction(scene), [0, 0, 1], atol=1e-9)


def test_so_they_do_around_an_object() -> None:
    random = np.random.default_rng(3)
    statue = random.normal(size=(500, 3)) * [1, 1, 3]
    angles = np.radians(np.arange(0, 360, 30))
    around = np.column_stack([12 * np.cos(angles), -12 * np.sin(angles), np.full(12, 1.6)])
    scene = looking(around, np.zeros((12, 3)), statue)
    assert up_direction(scene)[2] == pytest.approx(1, abs=1e-6)
