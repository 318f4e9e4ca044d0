"""Recapture on demand: any rectangle of a photograph, as the photograph of a camera of its own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pycolmap
from numpy.typing import NDArray

from sirpy.errors import InputError
from sirpy.lens import UndistortOptions, undistortion
from sirpy.photographs import (
    Bands,
    Interpolation,
    check_choice,
    open_photograph,
    recapture_to_array,
)
from sirpy.rectangle import Rectangle


@dataclass(frozen=True)
class Recaptured:
    """Pixels (height, width, channels), uint8 or uint16, and the recapture camera that sees them."""

    pixels: NDArray[Any]
    camera: pycolmap.Camera


def recapture(
    image: Path | str,
    camera: pycolmap.Camera,
    rectangle: Rectangle,
    *,
    undistort: UndistortOptions | None = None,
    bands: Bands = "color",
    interpolation: Interpolation = "bilinear",
) -> Recaptured:
    """A rectangle of a photograph with its recapture camera (Wang, arXiv 2503.06818, section 3).

    Only the rows that it needs are decoded and held.

    Args:
        image: the photograph.
        camera: its camera, of any model, in native pixels.
        rectangle: of the photograph as it is (for features), or of its undistorted image.
        undistort: how the undistorted image is made, its camera a PINHOLE (for stereo); None
            leaves the lens in.
        bands: "color", or "all" for alpha and infrared too.
        interpolation: of the undistorted image.

    Raises:
        InputError: the photograph cannot be read or has another size than its camera, the
            rectangle is not inside the image, or the camera cannot be undistorted.
    """
    check_choice("bands", bands, get_args(Bands))
    check_choice("interpolation", interpolation, get_args(Interpolation))
    photograph = open_photograph(Path(image), bands)
    if (photograph.width, photograph.height) != (camera.width, camera.height):
        raise InputError(
            f"{photograph.path} has {photograph.width}x{photograph.height} pixels, but its camera "
            f"{camera.width}x{camera.height}: give the camera of the native photograph"
        )
    lens, whole = None, camera
    if undistort is not None:
        found = undistortion(camera, undistort)
        lens, whole = found.lens, found.camera
    if rectangle.area == 0 or not Rectangle(0, 0, whole.width, whole.height).contains(rectangle):
        raise InputError(
            f"the rectangle {rectangle.as_list()} (x0, y0, width, height) is not inside the image "
            f"of {whole.width}x{whole.height} pixels"
        )
    pixels = recapture_to_array(
        photograph, lens, (whole.width, whole.height), rectangle, interpolation=interpolation
    )
    return Recaptured(pixels, recapture_camera(whole, rectangle))


def recapture_camera(camera: pycolmap.Camera, rectangle: Rectangle) -> pycolmap.Camera:
    """The camera of a rectangle: the principal point moves by its origin, nothing else changes."""
    params = np.array(camera.params)
    x, y = camera.principal_point_idxs()
    params[x] -= rectangle.x0
    params[y] -= rectangle.y0
    return pycolmap.Camera(
        model=camera.model,
        width=rectangle.width,
        height=rectangle.height,
        params=params,
        camera_id=camera.camera_id,
    )
