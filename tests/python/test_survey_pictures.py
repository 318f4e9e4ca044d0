"""Hill shade has its light in the north-west, coverage counts points where they are, rasters are read small."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from cloud_parts import cloud_of
from rasterio.transform import from_origin
from sirpy.cloud import POINT
from sirpy.errors import InputError
from sirpy.frame import Frame
from sirpy.survey_pictures import coverage, photograph_from_above, shaded_heights


def write_raster(path: Path, bands: np.ndarray, nodata: float | None = None) -> Path:
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        count=len(bands),
        height=bands.shape[1],
        width=bands.shape[2],
        dtype=bands.dtype,
        nodata=nodata,
        crs="EPSG:32632",
        transform=from_origin(691_000, 5_335_000, 0.5, 0.5),
    ) as file:
        file.write(bands)
    return path


def test_a_slope_towards_the_light_is_brighter(tmp_path: Path) -> None:
    """A pyramid: its north-west faces the light, its south-east does not; equal heights, equal colours."""
    y, x = np.mgrid[-100:101, -100:101]
    heights = (100 - np.maximum(abs(x), abs(y))).astype(np.float32)[None] * 0.5
    made = shaded_heights(write_raster(tmp_path / "dsm.tif", heights))
    grey = made.image.astype(int).sum(axis=2)
    north, south, west, east = grey[40, 100], grey[160, 100], grey[100, 40], grey[100, 160]
    assert north == west > south == east
    assert (made.low, made.high) == (np.percentile(heights, 1), np.percentile(heights, 99))


def test_no_height_is_white_and_casts_no_shade(tmp_path: Path) -> None:
    heights = np.full((1, 40, 60), 7.0, np.float32)
    heights[:, :, 30:] = -9999
    image = shaded_heights(write_raster(tmp_path / "dsm.tif", heights, nodata=-9999)).image
    assert (image[:, 30:] == 255).all()
    assert (image[:, :30] == image[0, 0]).all() and (image[0, 0] != 255).any()


def test_large_rasters_are_read_small(tmp_path: Path) -> None:
    ortho = np.zeros((4, 4000, 3000), np.uint8)
    ortho[0], ortho[3, 2000:] = 200, 255
    path = write_raster(tmp_path / "ortho.tif", ortho)
    with rasterio.open(path, "r+") as file:
        file.colorinterp = [
            rasterio.enums.ColorInterp[n] for n in ("red", "green", "blue", "alpha")
        ]
    image = photograph_from_above(path)
    assert image.shape == (1400, 1050, 3)
    assert (image[:700] == 255).all() and (image[701:] == (200, 0, 0)).all()


def test_coverage_counts_points_and_photographs_where_they_are(tmp_path: Path) -> None:
    points = np.zeros(5, POINT)
    points["x"], points["y"] = [0.1, 0.2, 359.5, 359.5, 999], [0.1, 0.2, 179.5, 179.5, 0]
    points["views"] = [2, 4, 7, 9, 5]
    cloud = cloud_of(tmp_path, [points], Frame())
    count, views, side = coverage(cloud, np.array([0.0, 0.0]), np.array([360.0, 180.0]))
    assert side == 1.0 and count.image.shape[:2] == (180, 360)
    known = (views.image != 255).any(axis=2)
    assert np.argwhere(known).tolist() == [[0, 359], [179, 0]]  # north-east, south-west
    assert (count.low, count.high) == (2, 2)  # the point outside counts nowhere
    assert views.low == pytest.approx(3.05) and views.high == pytest.approx(7.95)  # 3 and 8


def test_a_damaged_raster_is_named(tmp_path: Path) -> None:
    (tmp_path / "dsm.tif").write_text("no picture")
    with pytest.raises(InputError, match=r"dsm\.tif cannot be read"):
        shaded_heights(tmp_path / "dsm.tif")
