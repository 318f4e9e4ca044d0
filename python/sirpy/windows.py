"""Windows: any rectangle of an undistorted native image, read across the borders of its sub-images.

Every pixel comes from the sub-image that owns it, so a window does not depend on the grid; the few that have
no owner from one that stores them. Also the
depth and normal maps of sub-images, in COLMAP's format: the header `width&height&channels&`, then
little-endian float32 planes, row-major.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator
from mmap import ACCESS_READ, mmap
from pathlib import Path
from threading import Lock
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sirpy import _core
from sirpy.errors import InputError
from sirpy.files import file_identity, written_whole
from sirpy.memory import IMAGE_CACHE_BYTES
from sirpy.native_images import NativeImage, SubImage
from sirpy.photographs import open_photograph, recapture_to_array
from sirpy.rectangle import Rectangle
from sirpy.workspace import Pass, Workspace

_LONGEST_HEADER = 64
_BYTES_PER_PIXEL = {"grey": 1, "color": 3, "all": 8}


Pixels = Literal["grey", "color", "all"]
FloatMap = NDArray[np.float32]


def read_window(
    workspace: Workspace,
    native_name: str,
    rectangle: Rectangle,
    pixels: Pixels = "grey",
    *,
    again: bool = True,
) -> NDArray[Any]:
    """The pixels of `rectangle` of a native image; 0 where no sub-image holds any.

    Args:
        rectangle: in native pixels.
        pixels: "grey": 8 bit, (height, width), (4899 R + 9617 G + 1868 B + 8192) >> 14 in whole
            numbers; "color": 8 bit, (height, width, 3); "all": as stored, (height, width, channels),
            8 or 16 bit. 16-bit samples become 8 bit so that the brightest photograph's white is
            255.
        again: whether more is going to be read of the same sub-images, which are then kept, decoded,
            within a bound of memory.

    Raises:
        ValueError: the rectangle is not inside the native image.
        InputError: there is no such native image, or a sub-image is missing or damaged.
    """
    native = workspace.native(native_name)
    window: NDArray[Any] | None = None
    for sub, part in _parts(native, rectangle):
        rows, columns = part.slices_in(sub.stored)
        seen = _CACHE.read(
            workspace.image(sub), sub.stored, (rows, columns), pixels, workspace.white, again
        )
        if window is None:
            window = np.zeros((rectangle.height, rectangle.width, *seen.shape[2:]), seen.dtype)
        window[part.slices_in(rectangle)] = seen
    if window is None:
        shape = (rectangle.height, rectangle.width)
        return np.zeros(shape if pixels == "grey" else (*shape, 3), np.uint8)
    return window


def read_mask_window(
    workspace: Workspace, native_name: str, rectangle: Rectangle
) -> NDArray[np.bool_]:
    """True where the pixels of `rectangle` are masked out, (height, width).

    Raises:
        ValueError, InputError: as `read_window`.
    """
    native = workspace.native(native_name)
    masked = np.zeros((rectangle.height, rectangle.width), np.bool_)
    if native.masked:
        for sub, part in _parts(native, rectangle):
            slices = part.slices_in(sub.stored)
            seen = _CACHE.read(workspace.mask(sub), sub.stored, slices, "grey", 255)
            masked[part.slices_in(rectangle)] = seen == 0
    return masked


class _ImageCache:
    """Decoded sub-images, those used last, within a bound of memory; safe with threads.

    A window of a compressed image costs nearly what the whole costs, so the whole is kept where it
    takes no more than a quarter of the bound.
    """

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._bytes = 0
        self._images: OrderedDict[tuple[object, ...], NDArray[Any]] = OrderedDict()
        self._lock = Lock()

    def read(
        self,
        path: Path,
        stored: Rectangle,
        slices: tuple[slice, slice],
        pixels: Pixels,
        white: int,
        again: bool = True,
    ) -> NDArray[Any]:
        """Rows and columns of an image file of the size of `stored`."""
        rows, columns = slices
        try:
            identity = file_identity(path)
        except OSError as error:
            raise InputError(
                f"cannot open image {path} ({error.strerror}): cut the photographs again"
            ) from None
        key = (path, identity, pixels, white)
        with self._lock:
            if (found := self._images.get(key)) is not None:
                self._images.move_to_end(key)
                return found[slices]
        size = _BYTES_PER_PIXEL[pixels] * stored.area
        if not again or 4 * size > self._most_bytes:
            window = columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start
            return _read_file(path, Rectangle(*window), pixels, white)
        image = _read_file(path, Rectangle(0, 0, stored.width, stored.height), pixels, white)
        with self._lock:
            if key not in self._images:
                self._images[key] = image
                self._bytes += image.nbytes
            while self._bytes > self._most_bytes:
                self._bytes -= self._images.popitem(last=False)[1].nbytes
        return image[slices]


_CACHE = _ImageCache(IMAGE_CACHE_BYTES)


def _read_file(path: Path, window: Rectangle, pixels: Pixels, white: int) -> NDArray[Any]:
    if path.suffix == ".tif":
        photograph = open_photograph(path, "all" if pixels == "all" else "color")
        size = photograph.width, photograph.height
        stored = recapture_to_array(photograph, None, size, window)
        return _core.convert_pixels(stored, pixels, white)
    return _core.read_window(path, window.x0, window.y0, window.width, window.height, pixels, white)


def read_map_window(
    workspace: Workspace,
    native: NativeImage,
    rectangle: Rectangle,
    kind: Literal["depth", "normal", "confidence", "sigma", "level"],
    of_pass: Pass = "geometric",
) -> FloatMap:
    """`rectangle` of a map, (height, width), or of a normal map, (3, height, width).

    0 where no sub-image holds any.

    Raises:
        ValueError: the rectangle is not inside the native image.
        InputError: a map is missing, truncated, or of another size than its sub-image.
    """
    paths: dict[str, Callable[[SubImage], Path]] = {
        "depth": lambda sub: workspace.depth_map(sub, of_pass),
        "normal": lambda sub: workspace.normal_map(sub, of_pass),
        "confidence": workspace.confidence_map,
        "sigma": workspace.sigma_map,
        "level": workspace.level_map,
    }
    channels = 3 if kind == "normal" else 1
    window = np.zeros((channels, rectangle.height, rectangle.width), np.float32)
    for sub, part in _parts(native, rectangle):
        planes = open_map(paths[kind](sub), sub.stored, channels)
        pixels = planes[(slice(None), *part.slices_in(sub.stored))]
        window[(slice(None), *part.slices_in(rectangle))] = pixels
    return window if kind == "normal" else window[0]


def open_map(path: Path, stored: Rectangle, channels: int = 1) -> NDArray[np.float32]:
    """The map of a sub-image, (channels, height, width), on disk: rows are read when they are used.

    Raises:
        InputError: the map is missing, truncated, or of another size than its sub-image.
    """
    planes = _open_map(path)
    if planes.shape != (channels, stored.height, stored.width):
        raise InputError(
            f"map {path} has the shape {planes.shape}, but its sub-image "
            f"{(channels, stored.height, stored.width)}: delete it and run the stereo again (COLMAP's with "
            "--PatchMatchStereo.max_image_size -1)"
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
    """Sub-images with the parts of `rectangle` to be taken from them, in native pixels; later ones
    replace earlier ones.

    Pixels come from their owner; those that have none (outside a region of interest, for example) from a
    sub-image that stores them as its overlap.
    """
    if rectangle.area == 0 or not native.rectangle.contains(rectangle):
        raise ValueError(f"{rectangle} is not inside {native.name}, {native.rectangle}")
    cores = [(sub, sub.core.intersection(rectangle)) for sub in native.sub_images]
    if sum(part.area for _, part in cores) < rectangle.area:
        stored = [(sub, sub.stored.intersection(rectangle)) for sub in native.sub_images]
        yield from ((sub, part) for sub, part in stored if part.area > 0)
    yield from ((sub, part) for sub, part in cores if part.area > 0)


def _open_map(path: Path) -> NDArray[np.float32]:
    """The planes (channels, height, width) on disk; rows are read when they are used."""
    try:
        with path.open("rb", buffering=0) as file:
            header = file.read(_LONGEST_HEADER).split(b"&", 3)
            width, height, channels = (int(field) for field in header[:3])
            mapped = mmap(file.fileno(), 0, access=ACCESS_READ)
    except FileNotFoundError:
        raise InputError(f"there is no map {path}: run the stereo again") from None
    except (ValueError, OSError) as error:
        raise InputError(
            f"{path} is no depth or normal map: delete it and run the stereo again"
        ) from error
    size, offset = len(mapped), sum(len(field) + 1 for field in header[:3])
    if (
        min(width, height, channels) < 1
        or len(header) < 4
        or size != offset + 4 * width * height * channels
    ):
        raise InputError(
            f"map {path} is damaged ({size} bytes for {width}x{height}x{channels} numbers): delete "
            "it and run the stereo again"
        )
    planes = np.frombuffer(mapped, "<f4", channels * height * width, offset)
    return planes.reshape(channels, height, width)
