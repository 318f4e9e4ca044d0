"""What `benchmarks/rephotography.py` hands to the reconstructions of decimated photographs."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image
from rephotograph_scene import FOCAL, HEIGHT, HELD_OUT, WIDTH, plane_scene
from rephotography import _options, decimate
from sirpy.held_out import without
from sirpy.model_arrays import read_arrays


def test_photographs_and_cameras_are_decimated_alike(tmp_path: Path) -> None:
    scene = plane_scene(tmp_path)
    only = without(scene.model, {"2.png", "3.png"})
    Image.fromarray(scene.colours).save(scene.images / "4.png")
    decimate(scene.images, only, 4, tmp_path / "small", tmp_path / "small_model")
    small = np.asarray(Image.open(tmp_path / "small" / HELD_OUT), np.float64)
    means = scene.colours.reshape(HEIGHT // 4, 4, WIDTH // 4, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(small, means, atol=0.51)
    model = read_arrays(tmp_path / "small_model")
    camera = model.camera_of(model.images[0])
    assert (camera.width, camera.height, camera.params[0]) == (WIDTH // 4, HEIGHT // 4, FOCAL / 4)
    np.testing.assert_allclose(model.xy, only.xy / 4)


def test_regions_are_those_of_the_decimated_photographs() -> None:
    given = argparse.Namespace(
        columns="3", rows="2", area=None, model_crs=None, roi="101,50,203,100"
    )
    grid = ["--columns", "3", "--rows", "2"]
    assert _options(given, 1) == [*grid, "--roi", "101,50,203,100"]
    assert _options(given, 2) == [*grid, "--roi", "50,25,102,50"]
