"""Windows: any rectangle of an undistorted native image, read across the borders of its sub-images.

Every pixel comes from the sub-image that owns it, so a window does not depend on the grid. Also the
depth and normal maps of sub-images, in COLMAP's format: the header `width&height&channels&`, then
little-endian float32 planes, row-major.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sirpy import _core
from sirpy.errors import InputError
from sirpy.files import written_whole
from sirpy.rectangle import Rectangle
from sirpy.workspace import NativeImage, Pass, SubImage, Workspace

_LONGEST_HEADER = 64


def read_window(
    workspace: Workspace, native: NativeImage, rectangle: Rectangle, *, color: bool = False
) -> NDArray[np.uint8]:
    """The pixels of `rectangle`: (height, width) grey, or (height, width, 3) RGB with `color`.

    Grey is (4899 R + 9617 G + 1868 B + 8192) >> 14 in whole numbers. What no sub-image owns, where
    some were left out (see `cut`), is black.

    Raises:
        ValueError: the rectangle is not inside the native image.
        InputError: a sub-image is missing or damaged.
    """
    shape = (rectangle.height, rectangle.width, 3) if color else (rectangle.height, rectangle.width)
    window = np.zeros(shape, np.uint8)
    for sub, part in _parts(native, rectangle):
        x0, y0 = part.x0 - sub.stored.x0, part.y0 - sub.stored.y0
        window[part.slices_in(rectangle)] = _core.read_window(
            workspace.image(sub), x0, y0, part.width, part.height, color
        )
    return window


def read_map_window(
    workspace: Workspace,
    native: NativeImage,
    rectangle: Rectangle,
    kind: Literal["depth", "normal"],
    of_pass: Pass = "geometric",
) -> NDArray[np.float32]:
    """`rectangle` of a depth map, (height, width), or of a normal map, (3, height, width).

    Zero, as where there is no depth, where the sub-image was left out.

    Raises:
        ValueError: the rectangle is not inside the native image.
        InputError: a map is missing, truncated, or of another size than its sub-image.
    """
    path_of: Callable[[SubImage, Pass], Path] = (
        workspace.depth_map if kind == "depth" else workspace.normal_map
    )
    channels = 1 if kind == "depth" else 3
    window = np.zeros((channels, rectangle.height, rectangle.width), np.float32)
    for sub, part in _parts(native, rectangle):
        planes = open_map(path_of(sub, of_pass), sub.stored, channels)
        pixels = planes[(slice(None), *part.slices_in(sub.stored))]
        window[(slice(None), *part.slices_in(rectangle))] = pixels
    return window[0] if kind == "depth" else window


def open_map(path: Path, stored: Rectangle, channels: int = 1) -> NDArray[np.float32]:
    """The map of a sub-image, (channels, height, width), on disk: rows are read when they are used.

    Raises:
        InputError: the map is missing, truncated, or of another size than its sub-image.
    """
    planes = _open_map(path)
    if planes.shape != (channels, stored.height, stored.width):
        raise InputError(
            f"map {path} has the shape {planes.shape}, but its sub-image "
            f"{(channels, stored.height, stored.width)}: delete it and run the stereo again"
        )
    return planes


def read_map(path: Path) -> NDArray[np.float32]:
    """A whole map: (height, width), or (channels, height, width). Raises InputError as above."""
    planes = np.array(_open_map(path))
    return planes[0] if len(planes) == 1 else planes


def write_map(path: Path, array: NDArray[np.float32]) -> None:
    """Writes a map, (height, width) or (channels, height, width), whole or not at all.

    Raises:
        ValueError: the array has another number of dimensions, or is not float32.
        OutputError: the file cannot be written.
    """
    if array.ndim not in (2, 3) or array.dtype != np.float32:
        raise ValueError(f"a map is float32 of 2 or 3 dimensions, not {array.dtype} {array.shape}")
    planes = array[None] if array.ndim == 2 else array
    channels, height, width = planes.shape
    with written_whole(path) as temporary, temporary.open("wb") as file:
        file.write(f"{width}&{height}&{channels}&".encode())
        for plane in planes:
            file.write(plane.astype("<f4", copy=False).tobytes())


def _parts(native: NativeImage, rectangle: Rectangle) -> Iterator[tuple[SubImage, Rectangle]]:
    """The sub-images that own pixels of `rectangle`, each with those, in native pixels."""
    if rectangle.area == 0 or not native.rectangle.contains(rectangle):
        raise ValueError(f"{rectangle} is not inside {native.name}, {native.rectangle}")
    for sub in native.sub_images:
        part = sub.core.intersection(rectangle)
        if part.area > 0:
            yield sub, part


def _open_map(path: Path) -> NDArray[np.float32]:
    """The planes (channels, height, width) on disk; rows are read when they are used."""
    try:
        with path.open("rb") as file:
            header = file.read(_LONGEST_HEADER).split(b"&", 3)
            size = file.seek(0, 2)
        width, height, channels = (int(field) for field in header[:3])
    except FileNotFoundError:
        raise InputError(f"there is no map {path}: run the stereo again") from None
    except (ValueError, OSError) as error:
        raise InputError(
            f"{path} is no depth or normal map: delete it and run the stereo again"
        ) from error
    offset = sum(len(field) + 1 for field in header[:3])
    if (
        min(width, height, channels) < 1
        or len(header) < 4
        or size != offset + 4 * width * height * channels
    ):
        raise InputError(
            f"map {path} is damaged ({size} bytes for {width}x{height}x{channels} numbers): delete "
            "it and run the stereo again"
        )
    return np.memmap(path, "<f4", "r", offset, (channels, height, width))
