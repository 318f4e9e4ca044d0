"""Turning a camera into a richer model changes no projection."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest
from sirpy.lens_models import mapping_model, turn_cameras


@pytest.mark.parametrize("asked", ["PINHOLE", "RADIAL", "OPENCV", "FULL_OPENCV"])
def test_the_turned_camera_projects_as_before(asked: str) -> None:
    camera = pycolmap.Camera.create_from_model_name(3, mapping_model(asked), 900.0, 1000, 800)
    camera.params = np.array([905.0, 503.0, 396.0, -0.07])[: len(camera.params)]
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    rays = np.random.default_rng(1).uniform(-0.5, 0.5, (50, 2))
    points = np.column_stack([rays, np.ones(50)])
    before = camera.img_from_cam(points)
    turn_cameras(model, asked)
    turned = model.camera(3)
    assert (turned.model_name, turned.width, turned.height) == (asked, 1000, 800)
    np.testing.assert_allclose(turned.img_from_cam(points), before, atol=1e-9)


@pytest.mark.parametrize("asked", ["SIMPLE_RADIAL", "OPENCV_FISHEYE", "FOV"])
def test_other_models_are_mapped_directly(asked: str) -> None:
    assert mapping_model(asked) == asked
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", 900.0, 1000, 800)
    )
    turn_cameras(model, asked)
    assert model.camera(1).model_name == "SIMPLE_RADIAL"
