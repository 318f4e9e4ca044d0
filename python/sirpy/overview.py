"""Small views of a whole native image, put together from its sub-images without holding it."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sirpy.errors import InputError
from sirpy.native_images import NativeImage, SubImage
from sirpy.windows import open_map
from sirpy.workspace import Workspace

_CACHE = 64  # of GDAL's blocks, MB


def decimation(native: NativeImage, longest_side: int) -> int:
    """The whole factor that brings a native image to at most `longest_side` pixels."""
    return max(1, -(-max(native.width, native.height) // longest_side))


def photograph(workspace: Workspace, native: NativeImage, factor: int) -> NDArray[np.uint8]:
    """RGB of a native image, decimated: one pixel for each middle of a square of factor x factor.

    Raises:
        InputError: a sub-image cannot be read.
    """
    small = np.zeros((*_size(native, factor), 3), np.uint8)
    for sub_image in native.sub_images:
        rows, columns = _place(sub_image, factor)
        if rows.stop > rows.start and columns.stop > columns.start:
            shape = (rows.stop - rows.start, columns.stop - columns.start)
            small[rows, columns] = _core_pixels(workspace.image(sub_image), sub_image, shape)
    return small


def depth_map(workspace: Workspace, native: NativeImage, factor: int) -> NDArray[np.float32]:
    """Depths of a native image at the same pixels as `photograph`.

    0 where a pixel has no depth, and where a sub-image has no depth map.

    Raises:
        InputError: a depth map is damaged or of another size than its sub-image.
    """
    small = np.zeros(_size(native, factor), np.float32)
    for sub_image in native.sub_images:
        path = workspace.depth_map(sub_image, "geometric")
        if not path.exists():
            continue
        rows, columns = _place(sub_image, factor)
        stored = open_map(path, sub_image.stored)[0]
        y = np.arange(rows.start, rows.stop) * factor + factor // 2 - sub_image.stored.y0
        x = np.arange(columns.start, columns.stop) * factor + factor // 2 - sub_image.stored.x0
        depth = stored[np.ix_(y, x)]
        small[rows, columns] = np.where(np.isfinite(depth), depth, 0)
    return small


def _place(sub_image: SubImage, factor: int) -> tuple[slice, slice]:
    """Rows and columns whose middle pixels (i * factor + factor // 2) the core owns."""
    core = sub_image.core
    return (
        slice(_before(core.y0, factor), _before(core.y1, factor)),
        slice(_before(core.x0, factor), _before(core.x1, factor)),
    )


def _size(native: NativeImage, factor: int) -> tuple[int, int]:
    return _before(native.height, factor), _before(native.width, factor)


def _before(edge: int, factor: int) -> int:
    """How many middle pixels lie before an edge."""
    return max(0, -(-(edge - factor // 2) // factor))


def _core_pixels(path: Path, sub_image: SubImage, shape: tuple[int, int]) -> NDArray[np.uint8]:
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.errors import NotGeoreferencedWarning, RasterioError
    from rasterio.windows import Window

    core, stored = sub_image.core, sub_image.stored
    window = Window(core.x0 - stored.x0, core.y0 - stored.y0, core.width, core.height)
    try:
        with warnings.catch_warnings(), rasterio.Env(GDAL_CACHEMAX=_CACHE):
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as file:
                bands = [1, 2, 3] if file.count >= 3 else [1, 1, 1]
                pixels = file.read(
                    bands,
                    window=window,
                    out_shape=(3, *shape),
                    resampling=Resampling.average,
                )
    except RasterioError as error:
        raise InputError(f"the sub-image {path} cannot be read ({error}): cut again") from None
    if pixels.dtype == np.uint16:
        pixels = pixels // 257
    return np.moveaxis(pixels.astype(np.uint8), 0, -1)
