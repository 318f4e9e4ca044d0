"""Pictures of a survey from above, north at the top: heights with hill shade, orthophoto, coverage.

Rasters are read from their overviews, the cloud run by run: memory goes with the picture.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sirpy.cloud import Cloud
from sirpy.errors import InputError
from sirpy.frame import Floats
from sirpy.pictures import turbo

Image = npt.NDArray[np.uint8]

_SIDE = 1400  # longest side of rasters, pixels
_CELLS = 360  # along the longer side of the maps of coverage
_EMPTY = (255, 255, 255)
_LIGHT = np.array([-1.0, 1.0, np.sqrt(2.0)]) / 2  # from the north-west, 45 degrees high
_RELIEF = 0.35  # of the brightness at least, where the light does not come


@dataclass(frozen=True, eq=False)
class ScaledPicture:
    """Colours (height, width, 3) of values from `low` to `high`, on the colour map turbo."""

    image: Image
    low: float
    high: float


def shaded_heights(path: Path) -> ScaledPicture:
    """A surface model (GeoTIFF) in colours, with hill shade.

    Raises InputError where it cannot be read.
    """
    bands, valid, step = _reduced(path, 1)
    heights = bands[0].astype(np.float64)
    low, high = _range(heights[valid])
    colours = _coloured(heights, valid, low, high).astype(np.float64)
    light = _hill_shade(np.where(valid, heights, np.nan), step)[..., None]
    image = np.where(valid[..., None], colours * light, colours)
    return ScaledPicture((image + 0.5).astype(np.uint8), low, high)


def photograph_from_above(path: Path) -> Image:
    """An orthophoto (GeoTIFF), white where there is none.

    Raises InputError where it cannot be read.
    """
    bands, valid, _ = _reduced(path, 3)
    image = np.moveaxis(bands, 0, -1).astype(np.uint8)
    image[~valid] = _EMPTY
    return image


def coverage(cloud: Cloud, low: Floats, high: Floats) -> tuple[ScaledPicture, ScaledPicture, float]:
    """Points of each square cell between two places (x, y), and in how many photographs a point is on
    average; and the side of a cell."""
    side = float((high - low).max()) / _CELLS
    columns, rows = np.maximum(1, np.ceil((high - low) / side)).astype(int)
    count, views = np.zeros(rows * columns), np.zeros(rows * columns)
    for points in cloud.runs():
        column = np.floor((points["x"] - low[0]) / side).astype(np.int64)
        row = np.floor((high[1] - points["y"]) / side).astype(np.int64)
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        cell = (row * columns + column)[inside]
        count += np.bincount(cell, minlength=len(count))
        views += np.bincount(cell, points["views"][inside], minlength=len(count))
    known = count > 0
    mean = views / np.where(known, count, 1)
    return (
        _map(count.reshape(rows, columns), known.reshape(rows, columns)),
        _map(mean.reshape(rows, columns), known.reshape(rows, columns)),
        side,
    )


def _map(values: Floats, known: npt.NDArray[np.bool_]) -> ScaledPicture:
    low, high = _range(values[known])
    image = _coloured(values, known, low, high)
    factor = max(1, _SIDE // (2 * max(image.shape[:2])))  # cells stay sharp
    return ScaledPicture(image.repeat(factor, axis=0).repeat(factor, axis=1), low, high)


def _range(values: Floats) -> tuple[float, float]:
    """Least and greatest, without a few far outliers."""
    if len(values) == 0:
        return 0.0, 0.0
    low, high = np.percentile(values, [1, 99])
    return float(low), float(high)


def _coloured(values: Floats, known: npt.NDArray[np.bool_], low: float, high: float) -> Image:
    # One value everywhere is in the middle of the colours, not at the dark end.
    span, least = (high - low, low) if high > low else (1.0, low - 0.5)
    position = np.clip((values - least) / span, 0, 1)
    image = turbo(np.where(known, position, 0))
    image[~known] = _EMPTY
    return image


def _hill_shade(heights: Floats, step: float) -> Floats:
    """Brightness 0 to 1 of heights (rows from the north), NaN where unknown: 1 there."""
    if min(heights.shape) < 2:
        return np.ones(heights.shape)
    south, east = np.gradient(heights, step)
    normal = np.stack([-east, south, np.ones_like(heights)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = np.clip(normal @ _LIGHT, 0, 1) / _LIGHT[2]  # level ground is as bright as its colour
    shade: Floats = np.clip(_RELIEF + (1 - _RELIEF) * np.nan_to_num(light, nan=1.0), 0, 1)
    return shade


def _reduced(
    path: Path, count: int
) -> tuple[npt.NDArray[np.generic], npt.NDArray[np.bool_], float]:
    """(bands (count, height, width), where they are valid, side of a pixel) of a raster."""
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.errors import RasterioError

    try:
        with rasterio.open(path) as raster:
            factor = max(1.0, max(raster.width, raster.height) / _SIDE)
            shape = round(raster.height / factor) or 1, round(raster.width / factor) or 1
            bands = list(range(1, count + 1))
            pixels = raster.read(bands, out_shape=(count, *shape), resampling=Resampling.average)
            valid = raster.dataset_mask(out_shape=shape) > 127
            return pixels, valid, float(raster.res[0] * factor)
    except RasterioError as error:
        raise InputError(f"{path} cannot be read ({error}): make it again") from None
