"""A picture of a point cloud, seen from far away along one direction."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sirpy.errors import InputError
from sirpy.files import written_whole
from sirpy.model_arrays import SparseModel
from sirpy.pictures import encoded_png
from sirpy.ply import read_chunks, read_vertices

Floats = NDArray[np.float64]

_CHUNK = 250_000  # points held at a time
_BOUNDS_SAMPLE = 200_000
_SUPERSAMPLING = 2
_CLOSINGS = 3
_BACKGROUND = (24, 27, 32)  # white walls stand out against it


def draw_cloud(
    cloud: Path | str,
    picture: Path | str,
    *,
    forward: tuple[float, float, float] = (0.0, 0.0, -1.0),
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    size: int = 800,
) -> Path:
    """Draws the points of a PLY file in their colours (grey where it has none) as a PNG file.

    The projection is orthographic; the nearest point of a pixel is drawn, and small holes between
    points are closed. The frame holds 99 % of the points in each direction. Memory is bounded by
    the picture, whatever the size of the cloud.

    Args:
        forward: the viewing direction in the cloud's frame; need not have unit length.
        up: what points to the top of the picture; not parallel to `forward`.
        size: of the picture's longer side, in pixels.

    Raises:
        InputError: the cloud cannot be read, or it holds no finite point.
        OutputError: the picture cannot be written.
    """
    cloud, count = Path(cloud), len(read_vertices(cloud))
    picture_from_world = _view(forward, up)
    low, high = _bounds(cloud, count, picture_from_world)
    # A cloud of few points makes a small picture rather than one with more holes than points.
    side = int(min(size, max(64, np.sqrt(count))))
    pixel = max(float((high - low).max()), 1e-12) / (side * _SUPERSAMPLING)
    width, height = (
        max(1, int(np.ceil(extent / pixel / _SUPERSAMPLING))) * _SUPERSAMPLING
        for extent in high - low
    )
    canvas = _Canvas(width, height)
    for part in read_chunks(cloud, _CHUNK):
        points, finite = _finite_points(part)
        seen = points @ picture_from_world.T
        column = np.floor((seen[:, 0] - low[0]) / pixel).astype(np.int64)
        row = np.floor((seen[:, 1] - low[1]) / pixel).astype(np.int64)
        canvas.draw(column, row, seen[:, 2], _colours(part[finite]))
    picture = Path(picture)
    with written_whole(picture) as temporary:
        temporary.write_bytes(encoded_png(canvas.developed()))
    return picture


def mean_view(model: SparseModel) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """(forward, up) for `draw_cloud` from the cameras of a model.

    Forward is the mean viewing direction. Up is that of the first photograph by name: strips flown
    in opposite directions would cancel in a mean.
    """
    images = sorted(model.images, key=lambda image: image.name)
    if not images:
        raise InputError("the model holds no photographs: there is nothing to draw")
    rotations = [image.cam_from_world[:, :3] for image in images]
    forward = np.mean([rotation[2] for rotation in rotations], axis=0)
    if np.linalg.norm(forward) < 0.1:  # photographs all around have no mean direction
        forward = rotations[0][2]
    up = -rotations[0][1]
    return (
        (float(forward[0]), float(forward[1]), float(forward[2])),
        (float(up[0]), float(up[1]), float(up[2])),
    )


class _Canvas:
    """A z-buffer with colours."""

    def __init__(self, width: int, height: int) -> None:
        self._width, self._height = width, height
        self._depth = np.full(width * height, np.inf)
        self._colours = np.zeros((width * height, 3), np.uint8)

    def draw(
        self, column: NDArray[np.int64], row: NDArray[np.int64], depth: Floats, colours: Any
    ) -> None:
        inside = (column >= 0) & (row >= 0) & (column < self._width) & (row < self._height)
        pixel = row[inside] * self._width + column[inside]
        depth, colours = depth[inside], colours[inside]
        in_front = depth < self._depth[pixel]
        pixel, depth, colours = pixel[in_front], depth[in_front], colours[in_front]
        # The farthest first: of several points of a pixel the last one that is written stays.
        order = np.argsort(depth, kind="stable")[::-1]
        self._depth[pixel[order]] = depth[order]
        self._colours[pixel[order]] = colours[order]

    def developed(self) -> NDArray[np.uint8]:
        """RGB of the picture: squares of pixels averaged, holes of a pixel or two closed."""
        shape = (self._height // _SUPERSAMPLING, _SUPERSAMPLING, -1, _SUPERSAMPLING)
        weight = np.isfinite(self._depth).astype(np.float32).reshape(shape).sum(axis=(1, 3))
        weighted = self._colours.astype(np.float32).reshape(*shape, 3).sum(axis=(1, 3))
        for _ in range(_CLOSINGS):
            weight, weighted = _closed(weight, weighted)
        empty = weight == 0
        image = weighted / np.where(empty, 1, weight)[..., None]
        image[empty] = _BACKGROUND
        levels: NDArray[np.uint8] = (image + 0.5).astype(np.uint8)
        return levels


def _closed(
    weight: NDArray[np.float32], weighted: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Fills each empty pixel that has at least four full ones around it with their mean."""
    height, width = weight.shape
    around = np.pad(weight, 1)
    around_weighted = np.pad(weighted, ((1, 1), (1, 1), (0, 0)))
    places = [(y, x) for y in range(3) for x in range(3) if (y, x) != (1, 1)]
    parts = [around[y : y + height, x : x + width] for y, x in places]
    full = np.sum([part > 0 for part in parts], axis=0)
    hole = (weight == 0) & (full >= 4)
    weight, weighted = weight.copy(), weighted.copy()
    weight[hole] = np.sum([part[hole] for part in parts], axis=0)
    weighted[hole] = np.sum(
        [around_weighted[y : y + height, x : x + width][hole] for y, x in places], axis=0
    )
    return weight, weighted


def _view(forward: tuple[float, float, float], up: tuple[float, float, float]) -> Floats:
    """picture_from_world (3, 3): x to the right, y down, z away from the viewer."""
    z = np.array(forward, np.float64)
    x = np.cross(z, np.array(up, np.float64))
    if np.linalg.norm(x) <= 1e-9 * np.linalg.norm(z) * np.linalg.norm(up):
        raise ValueError(f"forward {forward} and up {up} must not be parallel")
    z /= np.linalg.norm(z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _bounds(cloud: Path, count: int, picture_from_world: Floats) -> tuple[Floats, Floats]:
    """Least and greatest (x, y) in the picture's frame, without a few far outliers."""
    step = max(1, -(-count // _BOUNDS_SAMPLE))
    samples = [_finite_points(part[::step])[0] for part in read_chunks(cloud, _CHUNK)]
    points = np.concatenate([np.empty((0, 3)), *samples])
    if len(points) == 0:
        raise InputError(f"the point cloud {cloud} holds no points: there is nothing to draw")
    seen = points @ picture_from_world[:2].T
    low, high = np.percentile(seen, [0.5, 99.5], axis=0)
    margin = 0.02 * (high - low).max()
    return low - margin, high + margin


def _finite_points(part: NDArray[Any]) -> tuple[Floats, NDArray[np.bool_]]:
    """The points (n, 3) of those vertices that have finite ones, and which these are."""
    points = np.stack([part["x"], part["y"], part["z"]], axis=1).astype(np.float64)
    finite = np.asarray(np.isfinite(points).all(axis=1))
    return points[finite], finite


def _colours(part: NDArray[Any]) -> NDArray[np.uint8]:
    if not {"red", "green", "blue"} <= set(part.dtype.names or ()):
        return np.full((len(part), 3), 128, np.uint8)
    return np.stack([part["red"], part["green"], part["blue"]], axis=1).astype(np.uint8)
