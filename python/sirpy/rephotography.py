"""Virtual rephotography: a cloud as a photograph would see it, and how alike the two are.

After M. Waechter, M. Beljan, S. Fuhrmann, N. Moehrle, J. Kopf, M. Goesele: "Virtual Rephotography: Novel View
Prediction Error for 3D Reconstruction", ACM TOG 2017. Points are squares of a radius in pixels of the photograph,
parallel to it. The nearest one shows; but of those that are as near, as points of one surface are, the one whose
centre is nearest to the pixel's: the nearest to the camera would shift and blur the picture by up to the radius.
Results depend neither on the order of the points nor on how the photograph is divided into bands of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sirpy.coloured_points import Colours
from sirpy.posed_camera import PosedCamera
from sirpy.rectangle import Rectangle

Floats = NDArray[np.float64]
Grey = NDArray[np.float32]
Mask = NDArray[np.bool_]
Buffer = NDArray[np.uint32]

MARGIN = 4  # pixels around one that its NCC depends on: windows of 9 x 9
_NOTHING = np.uint32(2**32 - 1)
_LUMA_BITS = np.uint32(2**16 - 1)
_STEPS = 2**15 - 1  # of a square distance
_THICKNESS = 4.0  # of a surface, for each pixel of radius; pixels on the ground
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
    points: Callable[[], Iterable[tuple[Floats, Colours]]],
    window: Rectangle,
    radius: float,
) -> Buffer:
    """What a window of a photograph shows, (height, width): 16 bits each of the distance of the point from the
    pixel's centre, and of its luma.

    Args:
        points: gives places (n, 3) in the world and RGB (n, 3), some at a time; asked twice.
        window: pixels of the photograph.
        radius: half the side of a point's square, in such pixels; at least 0.5, with which each point fills
            the pixel that it falls into.
    """
    pixels = window.height * window.width
    limit = np.full(pixels, np.inf, np.float32)
    for pixel, depth, _ in _splats(view, points(), window, radius):
        np.minimum.at(limit, pixel, depth)
    limit *= np.float32(1 + _THICKNESS * radius / view.camera.mean_focal_length())
    shown = np.full(pixels, _NOTHING, np.uint32)
    for pixel, depth, key in _splats(view, points(), window, radius):
        in_front = depth <= limit[pixel]
        np.minimum.at(shown, pixel[in_front], key[in_front])
    return shown.reshape(window.height, window.width)


def _splats(
    view: PosedCamera,
    points: Iterable[tuple[Floats, Colours]],
    window: Rectangle,
    radius: float,
) -> Iterator[tuple[NDArray[np.int64], Grey, Buffer]]:
    """Of pixels whose centres lie in the squares of points: index in the window, depth of the point, and what is
    shown if it is this one; one of a square at a time."""
    size = window.width, window.height
    for world, colours in points:
        found, pixels, depths = view.project(world)
        pixels = pixels - [window.x0, window.y0]
        near = ((pixels > -radius) & (pixels < np.add(size, radius))).all(axis=1)
        pixels, depth = pixels[near], depths[near].astype(np.float32)
        grey = np.rint(luma(colours[found[near]]) * _LEVELS).astype(np.uint32)
        first = np.ceil(pixels - radius - 0.5).astype(np.int64)
        last = np.ceil(pixels + radius - 0.5).astype(np.int64)  # the first beyond the square
        side = int(np.ceil(2 * radius))
        for step in np.ndindex(side, side):
            place = first + step
            drawn = ((place < last) & (place >= 0) & (place < size)).all(axis=1)
            place = place[drawn]
            away = np.square((place + 0.5 - pixels[drawn]) / radius).sum(axis=1)  # up to 2
            distance = (away * _STEPS).astype(np.uint32) << np.uint32(16)
            yield place[:, 1] * window.width + place[:, 0], depth[drawn], distance | grey[drawn]


def shrunk_buffer(buffer: Buffer, factor: int) -> tuple[Grey, Mask]:
    """Luma of what a z-buffer shows, each pixel the mean of factor x factor, and which pixels hold points:
    in more than half of those. Rows and columns beyond a multiple of the factor are dropped."""
    height, width = (side // factor for side in buffer.shape)
    count, total = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    for part in _shifts(buffer, factor):
        full = part != _NOTHING
        count += full
        total += np.where(full, part & _LUMA_BITS, np.uint32(0))
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
