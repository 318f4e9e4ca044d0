"""Undistorting a camera: its PINHOLE camera by COLMAP's rules, and its lens sampled on nodes.

Positions are in pixels, the centre of the top-left pixel at (0.5, 0.5). pycolmap alone knows the
camera models; the C++ warp sees only the nodes and interpolates between them.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
import pycolmap
from numpy.typing import NDArray

from sirpy import _core
from sirpy.errors import InputError

_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
# Bound of the interpolation error that is checked, in pixels; what users are promised is 1/100.
_TOLERANCE = 1 / 400
_COARSEST_SPACING = 128.0
_CHECKED_POINTS = 4096


def _check(holds: bool, value: str, bound: str) -> None:
    if not holds:
        raise InputError(f"{value} is not possible: it must be {bound}")


@dataclass(frozen=True)
class UndistortOptions:
    """The options of COLMAP's image_undistorter that shape the undistorted camera."""

    blank_pixels: float = 0.0
    """0: no blank pixels at the border; 1: all pixels of the photograph are kept."""
    min_scale: float = 0.2
    """Least size of the undistorted image, relative to the photograph."""
    max_scale: float = 2.0
    """Greatest size of the undistorted image, relative to the photograph."""
    max_image_size: int = -1
    """Longest side in pixels; a longer image is shrunk by area averages. -1: no limit."""
    roi_min_x: float = 0.0
    roi_min_y: float = 0.0
    roi_max_x: float = 1.0
    roi_max_y: float = 1.0

    def __post_init__(self) -> None:
        _check(0 <= self.blank_pixels <= 1, f"blank_pixels = {self.blank_pixels}", "0 to 1")
        _check(self.min_scale > 0, f"min_scale = {self.min_scale}", "greater than 0")
        _check(
            self.max_scale >= self.min_scale,
            f"max_scale = {self.max_scale}",
            f"at least min_scale, {self.min_scale}",
        )
        _check(
            self.max_image_size == -1 or self.max_image_size > 0,
            f"max_image_size = {self.max_image_size}",
            "positive, or -1 for no limit",
        )
        for axis, low, high in (
            ("x", self.roi_min_x, self.roi_max_x),
            ("y", self.roi_min_y, self.roi_max_y),
        ):
            _check(
                0 <= low < high <= 1,
                f"roi_min_{axis} = {low}, roi_max_{axis} = {high}",
                "0 <= min < max <= 1",
            )


@dataclass(frozen=True)
class LensNodes:
    """The lens on a lattice of nodes, evenly spaced from the first to the last pixel centre.

    `nodes` is float64 (rows, columns, 2): the (x, y) in the photograph of each node; `spacing` the
    greater distance between neighbouring nodes, in undistorted pixels; `error` the greatest
    interpolation error that the check found, in pixels.
    """

    nodes: NDArray[np.float64]
    size: tuple[int, int]
    spacing: float
    error: float

    def map(self) -> _core.LensMap:
        return _core.LensMap(self.nodes, self.size)


@dataclass(frozen=True)
class Undistortion:
    """How the pixels of a camera are undistorted.

    `camera` is the PINHOLE camera of the image that is cut; `lens` maps the pixels of the
    undistorted image at native scale to the photograph, None where the photograph is such an image
    already. Where `camera` is smaller (max_image_size), the undistorted image is shrunk to it.
    """

    camera: pycolmap.Camera
    lens: _core.LensMap | None


def undistorted_camera(
    camera: pycolmap.Camera, options: UndistortOptions = UndistortOptions()
) -> pycolmap.Camera:
    """The PINHOLE camera that COLMAP's image_undistorter gives, with the id of `camera`.

    Raises:
        InputError: no pinhole camera can see what this camera sees.
    """
    try:
        undistorted = pycolmap.undistort_camera(
            pycolmap.UndistortCameraOptions(**asdict(options)), camera
        )
    except (ValueError, RuntimeError) as error:
        raise _not_a_pinhole(camera) from error
    if min(undistorted.width, undistorted.height) < 1 or not np.isfinite(undistorted.params).all():
        raise _not_a_pinhole(camera)
    undistorted.camera_id = camera.camera_id
    return undistorted


def undistortion(
    camera: pycolmap.Camera, options: UndistortOptions = UndistortOptions()
) -> Undistortion:
    """Camera and lens map of the undistorted image. Raises InputError as `undistorted_camera`."""
    target = undistorted_camera(camera, options)
    native_scale = undistorted_camera(
        camera, UndistortOptions(**{**asdict(options), "max_image_size": -1})
    )
    if _same_pixels(camera, native_scale):
        return Undistortion(target, None)
    return Undistortion(target, lens_nodes(camera, native_scale).map())


def lens_nodes(camera: pycolmap.Camera, undistorted: pycolmap.Camera) -> LensNodes:
    """Samples the lens, the spacing halved until interpolation is good to 1/400 pixel.

    The check compares with the camera model at the centres of cells, at random points and along the
    border, with the interpolation that the warp uses.

    Raises:
        InputError: part of the undistorted image cannot be projected into the photograph.
    """
    width, height = undistorted.width, undistorted.height
    points = _check_points(width, height)
    truth = _photograph_from_undistorted(camera, undistorted, points)
    spacing = _COARSEST_SPACING
    while True:
        columns, rows = (max(4, math.ceil((side - 1) / spacing) + 1) for side in (width, height))
        x, y = (
            np.linspace(0.5, max(side - 1, 1) + 0.5, count)
            for side, count in ((width, columns), (height, rows))
        )
        lattice = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        nodes = _photograph_from_undistorted(camera, undistorted, lattice)
        sampled = LensNodes(
            nodes.reshape(rows, columns, 2), (width, height), max(x[1] - x[0], y[1] - y[0]), 0.0
        )
        centres = np.stack(np.meshgrid((x[1:] + x[:-1]) / 2, (y[1:] + y[:-1]) / 2), axis=-1)
        centres = centres.reshape(-1, 2)[:: max(1, (rows * columns) // (8 * _CHECKED_POINTS))]
        checked = np.concatenate([points, centres])
        expected = np.concatenate(
            [truth, _photograph_from_undistorted(camera, undistorted, centres)]
        )
        error = float(np.abs(sampled.map().at(checked) - expected).max())
        if error <= _TOLERANCE:
            return LensNodes(sampled.nodes, sampled.size, sampled.spacing, error)
        if spacing <= 1:
            raise InputError(
                f"the lens of camera {camera.camera_id} ({camera.model_name}) bends too sharply "
                f"to be undistorted (by {error:.2g} pixels between neighbouring pixels): solve the "
                "camera again"
            )
        spacing /= 2


def moved_between(
    source: pycolmap.Camera, target: pycolmap.Camera, points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Where `target`, of the same pose, sees what `source` sees at `points`, n x 2 pixels.

    Not finite where a camera model has no such ray.
    """
    if len(points) == 0:
        return points
    rays = np.asarray(source.cam_from_img(points), np.float64)
    return np.asarray(target.img_from_cam(np.column_stack([rays, np.ones(len(rays))])), np.float64)


def _photograph_from_undistorted(
    camera: pycolmap.Camera, undistorted: pycolmap.Camera, points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """n x 2 positions in the photograph of n x 2 positions in the undistorted image."""
    positions = moved_between(undistorted, camera, points)
    if not np.isfinite(positions).all():
        raise _not_a_pinhole(camera)
    return positions


def _check_points(width: int, height: int) -> NDArray[np.float64]:
    """Random positions in the undistorted image and on its border, the same at every call."""
    random = np.random.default_rng(0)
    points = random.uniform(0, 1, (_CHECKED_POINTS, 2))
    border = np.arange(_CHECKED_POINTS // 4)
    points[border, border % 2] = (border // 2) % 2
    inside: NDArray[np.float64] = 0.5 + points * np.maximum([width - 1, height - 1], 1)
    return inside


def _same_pixels(camera: pycolmap.Camera, undistorted: pycolmap.Camera) -> bool:
    return (
        camera.model_name in _PINHOLES
        and (camera.width, camera.height) == (undistorted.width, undistorted.height)
        and np.array_equal(camera.calibration_matrix(), undistorted.calibration_matrix())
    )


def _not_a_pinhole(camera: pycolmap.Camera) -> InputError:
    return InputError(
        f"camera {camera.camera_id} ({camera.model_name}, {camera.width}x{camera.height}) cannot "
        "be undistorted to a pinhole camera: use a smaller --blank_pixels or --max_scale, or solve "
        "it again"
    )
