"""The parts of `benchmarks/stereo.py` that a figure could be wrong by, on cases solved by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from sirpy.model_arrays import PosedImage, SparseModel
from sirpy.native_images import NativeImage, SubImage
from sirpy.native_scene import NativeCamera
from sirpy.patch_match import passes
from sirpy.rectangle import Grid, Rectangle
from sirpy.stereo_backend import StereoOptions
from sirpy.windows import write_map
from stereo_decimation import area_mean, scaled_model
from stereo_grids import most_connected, overhead
from stereo_maps import error_in_gsd, quality, true_depth
from stereo_seams import band_mask

OPENCV = pycolmap.Camera(
    camera_id=1,
    model="OPENCV",
    width=1000,
    height=701,
    params=[900.0, 910.0, 480.0, 360.0, -0.1, 0.02, 1e-3, -1e-3],
)


def model_of(points: np.ndarray, seen: list[list[int]], camera: pycolmap.Camera) -> SparseModel:
    """Images with the pose of the world; image i sees the points `seen[i]`."""
    return SparseModel(
        {1: camera},
        tuple(PosedImage(i + 1, 1, f"{i}.jpg", (1, 0, 0, 0, 0, 0, 0)) for i in range(len(seen))),
        np.arange(1, len(points) + 1, dtype=np.uint64),
        points,
        np.zeros((len(points), 3), np.uint8),
        np.zeros(len(points)),
        np.cumsum([0, *map(len, seen)], dtype=np.int64),
        np.concatenate([camera.img_from_cam(points[one]) for one in seen]),
        np.concatenate(seen).astype(np.int32),
    )


def native_image(width: int, height: int, grid: Grid) -> NativeImage:
    cores = list(grid.cores(width, height))
    subs = [SubImage(f"a_r{row:02}_c{col:02}.jpg", row, col, one, one) for row, col, one in cores]
    return NativeImage("a.jpg", width, height, tuple(subs))


@pytest.mark.parametrize("longest", [500, 333])  # 333 x 233: not quite the same scale both ways
def test_decimated_cameras_project_to_the_scaled_pixels(longest: int) -> None:
    points = np.random.default_rng(0).uniform([-0.4, -0.3, 1], [0.4, 0.3, 2], (50, 3))
    small = scaled_model(model_of(points, [list(range(50))], OPENCV), longest)
    assert (small.cameras[1].width, small.cameras[1].height) == (longest, round(0.701 * longest))
    np.testing.assert_allclose(small.cameras[1].img_from_cam(points), small.xy, atol=1e-9)
    assert OPENCV.width == 1000  # the native model keeps its own


def test_decimation_takes_means_of_areas() -> None:
    pixels = np.array([[0, 3, 6], [10, 10, 40]], np.uint8)
    np.testing.assert_allclose(area_mean(pixels, 2, axis=1), [[1, 5], [10, 30]])
    np.testing.assert_allclose(area_mean(pixels, 1, axis=0), [[5, 6.5, 23]])


def test_few_photographs_are_those_that_share_most() -> None:
    seen = [[0, 1], [0, 1, 2, 3, 4], [2, 3, 4], [5]]
    model = model_of(np.ones((6, 3)), seen, OPENCV)
    assert most_connected(model, 2) == [1, 2]
    assert most_connected(model, 3) == [0, 1, 2]


def test_a_band_lies_on_both_sides_of_inner_borders_only() -> None:
    mask = band_mask(native_image(10, 8, Grid(2, 2)), 2)
    expected = np.zeros((8, 10), bool)
    expected[:, 3:7] = True
    expected[2:6] = True
    np.testing.assert_array_equal(mask, expected)


def test_the_end_of_what_is_cut_is_no_seam() -> None:
    region = Rectangle(1, 2, 8, 5)
    tiles = [
        SubImage(f"{row}{col}", row, col, one, one) for row, col, one in Grid(2, 1).tiles(region)
    ]
    expected = np.zeros((8, 10), bool)
    expected[2:7, 3:7] = True
    mask = band_mask(NativeImage("a.jpg", 10, 8, tuple(tiles)), 2)
    np.testing.assert_array_equal(mask, expected)

    whole = native_image(10, 8, Grid(2, 2))
    without_last = replace(whole, sub_images=whole.sub_images[:3])
    expected = np.zeros((8, 10), bool)
    expected[:4, 3:7] = expected[2:6, :5] = True
    np.testing.assert_array_equal(band_mask(without_last, 2), expected)


def test_what_a_halo_adds_is_what_the_passes_estimate() -> None:
    natives = (native_image(1000, 100, Grid(2, 1)),)
    found = overhead(natives, 2, 16)
    assert found["estimated_to_core"] == pytest.approx(1 + 2 * 16 / 1000)
    # Columns by rows by sweeps; the halo is as wide at every level, and no whole photograph has one.
    sweeps = [
        (1000 >> one.level, 100 >> one.level, one.iterations, 32 * (one.level < 2))
        for one in passes(2, StereoOptions())
    ]
    bare = sum(columns * rows * times for columns, rows, times, _ in sweeps)
    more = sum(halo * rows * times for _, rows, times, halo in sweeps)
    assert found["sweeps_to_no_halo"] == pytest.approx(1 + more / bare)
    # No more than can have a say.
    (native_pass,) = (one for one in passes(2, StereoOptions()) if one.name == "level0.photometric")
    assert overhead(natives, 2, 450)["estimated_to_core"] == pytest.approx(
        1 + 2 * native_pass.margin / 1000
    )


def test_errors_are_along_the_ray_and_say_what_is_missing() -> None:
    focal = 100.0
    intrinsics = np.array([[focal, 0, 0.5], [0, focal, 0.5], [0, 0, 1]])
    camera = NativeCamera("a.jpg", 101, 1, intrinsics, np.eye(3, 4))
    depth, truth = np.full((1, 101), 10.1), np.full((1, 101), 10.0)
    depth[0, 1], truth[0, 2] = 0, 0
    by_pixel = error_in_gsd(depth, truth, camera, None)
    np.testing.assert_allclose(by_pixel[0, [0, 1, 2, 100]], [1, np.inf, np.nan, 1])
    # The last pixel's ray has 45 degrees.
    fixed = error_in_gsd(depth, truth, camera, 0.2)
    np.testing.assert_allclose(fixed[0, [0, 100]], [0.5, 0.5 * np.sqrt(2)])
    figures = quality(np.array([0.5, 1.5, np.inf, np.nan]))
    assert figures == {
        "complete_1_gsd": pytest.approx(1 / 3),
        "complete_2_gsd": pytest.approx(2 / 3),
        "median_error_gsd": 1.0,
    }


def test_true_depths_of_uncut_photographs_serve_every_grid(tmp_path: Path) -> None:
    depth = np.arange(1, 61, dtype=np.float32).reshape(6, 10)
    native = native_image(10, 6, Grid(2, 3))
    for sub in native.sub_images:
        write_map(
            tmp_path / "cut" / f"{sub.name}.geometric.bin",
            np.ascontiguousarray(depth[sub.core.slices_in(native.rectangle)]),
        )
    write_map(tmp_path / "uncut" / "a_r00_c00.jpg.geometric.bin", depth)
    for folder in ("cut", "uncut"):
        np.testing.assert_array_equal(true_depth(tmp_path / folder, native), depth)
