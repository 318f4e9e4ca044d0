"""Virtual rephotography: a cloud as a photograph would see it, and how alike the two are.

After M. Waechter, M. Beljan, S. Fuhrmann, N. Moehrle, J. Kopf, M. Goesele: "Virtual Rephotography: Novel View
Prediction Error for 3D Reconstruction", ACM TOG 2017. Points are squares of a radius in pixels of the photograph,
parallel to it; the nearest one wins. Results depend neither on the order of the points nor on how the
photograph is divided into bands of rows.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sirpy.coloured_points import Colours
from sirpy.posed_camera import PosedCamera
from sirpy.rectangle import Rectangle

Floats = NDArray[np.float64]
Grey = NDArray[np.float32]
Mask = NDArray[np.bool_]
Buffer = NDArray[np.uint64]

MARGIN = 4  # pixels around one that its NCC depends on: windows of 9 x 9
_NOTHING = np.uint64(2**64 - 1)
_LUMA_BITS = np.uint64(2**32 - 1)
_LEVELS = 256  # steps of luma between two grey values
_LUMA = (0.299, 0.587, 0.114)
_LEAST_COMMON = 60  # pixels of the 81 of a window
_LEAST_VARIANCE = 4.0  # of grey values; below it noise would be compared


def luma(colours: NDArray[Any]) -> Grey:
    """(...) of RGB, or of one grey channel, (..., channels)."""
    if colours.shape[-1] == 1:
        return colours[..., 0].astype(np.float32)
    total = np.zeros(colours.shape[:-1], np.float32)
    for channel, weight in enumerate(_LUMA):
        total += np.float32(weight) * colours[..., channel]
    return total


def draw(
    view: PosedCamera,
    points: Iterable[tuple[Floats, Colours]],
    window: Rectangle,
    radius: float,
) -> Buffer:
    """The z-buffer (height, width) of a window of a photograph: depth in the upper 32 bits of a pixel, luma in
    the lower ones.

    Args:
        points: places (n, 3) in the world and RGB (n, 3), some at a time.
        window: pixels of the photograph.
        radius: half the side of a point's square, in such pixels; at least 0.5, with which each point fills
            the pixel that it falls into.
    """
    buffer = np.full((window.height, window.width), _NOTHING, np.uint64)
    for world, colours in points:
        found, pixels, depth = view.project(world)
        pixels = pixels - [window.x0, window.y0]
        near = ((pixels > -radius) & (pixels < np.add(buffer.shape[::-1], radius))).all(axis=1)
        grey = np.rint(luma(colours[found[near]]) * _LEVELS).astype(np.uint64)
        # The bits of positive floats are in the order of the floats.
        bits = depth[near].astype(np.float32).view(np.uint32).astype(np.uint64)
        _splat(buffer, pixels[near], bits << np.uint64(32) | grey, radius)
    return buffer


def _splat(buffer: Buffer, pixels: Floats, key: Buffer, radius: float) -> None:
    """Gives the pixels whose centres lie in the square around each of `pixels` (n, 2) the least of the keys."""
    rows, width = buffer.shape
    first = np.ceil(pixels - radius - 0.5).astype(np.int64)
    last = np.ceil(pixels + radius - 0.5).astype(np.int64)  # the first beyond the square
    flat, side = buffer.reshape(-1), int(np.ceil(2 * radius))
    for step in np.ndindex(side, side):
        place = first + step
        drawn = ((place < last) & (place >= 0) & (place < (width, rows))).all(axis=1)
        column, row = place[drawn].T
        np.minimum.at(flat, row * width + column, key[drawn])


def shrunk_buffer(buffer: Buffer, factor: int) -> tuple[Grey, Mask]:
    """Luma of what a z-buffer shows, each pixel the mean of factor x factor, and which pixels hold points:
    in more than half of those. Rows and columns beyond a multiple of the factor are dropped."""
    height, width = (side // factor for side in buffer.shape)
    count, total = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    for part in _shifts(buffer, factor):
        full = part != _NOTHING
        count += full
        total += np.where(full, part & _LUMA_BITS, np.uint64(0))
    mean: Grey = total / np.maximum(count, 1) / np.float32(_LEVELS)
    covered: Mask = 2 * count > factor * factor
    return mean, covered


def shrunk(grey: Grey, factor: int) -> Grey:
    """The mean of each block of factor x factor pixels; what is beyond the last whole one is dropped."""
    height, width = (side // factor for side in grey.shape)
    total = np.zeros((height, width), np.float32)
    for part in _shifts(grey, factor):
        total += part
    total /= factor * factor
    return total


def _shifts(image: NDArray[Any], factor: int) -> Iterable[NDArray[Any]]:
    height, width = (side // factor * factor for side in image.shape)
    for y, x in np.ndindex(factor, factor):
        yield image[y:height:factor, x:width:factor]


def ncc(cloud: Grey, photograph: Grey, covered: Mask) -> Grey:
    """Normalised cross-correlation of 9 x 9 windows, (height, width), over the pixels that hold points.

    -1 where a pixel holds none, fewer than 60 of its window do, or one of the two has no texture there.
    """
    weight = covered.astype(np.float32)
    count = np.maximum(_window_sums(weight), 1)
    a, b = (weight * (grey - np.float32(128)) for grey in (cloud, photograph))
    mean_a, mean_b = _window_sums(a) / count, _window_sums(b) / count
    variance_a = _window_sums(a * a) / count - mean_a**2
    variance_b = _window_sums(b * b) / count - mean_b**2
    covariance = _window_sums(a * b) / count - mean_a * mean_b
    known = covered & (count >= _LEAST_COMMON)
    known &= (variance_a > _LEAST_VARIANCE) & (variance_b > _LEAST_VARIANCE)
    spread = np.sqrt(np.where(known, variance_a * variance_b, 1))
    alike: Grey = np.where(known, covariance / spread, np.float32(-1))
    return alike


def comparable(photograph: Grey) -> Mask:
    """Which pixels have a whole window in the photograph, with grey values that differ enough."""
    levels = photograph - np.float32(128)
    count = _window_sums(np.ones_like(levels))
    variance = _window_sums(levels * levels) / count - (_window_sums(levels) / count) ** 2
    enough: Mask = (count == (2 * MARGIN + 1) ** 2) & (variance > _LEAST_VARIANCE)
    return enough


def _window_sums(values: Grey) -> Grey:
    """Over the 9 x 9 pixels around each; 0 beyond the border. In one order everywhere: the same bits
    whatever part of a photograph is looked at."""
    for axis in (0, 1):
        margin = [(MARGIN, MARGIN) if axis == i else (0, 0) for i in (0, 1)]
        padded, size = np.pad(values, margin), values.shape[axis]
        taken = [slice(None), slice(None)]
        total = np.zeros_like(values)
        for shift in range(2 * MARGIN + 1):
            taken[axis] = slice(shift, shift + size)
            total += padded[tuple(taken)]
        values = total
    return values
