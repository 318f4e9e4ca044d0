"""Small views of a native image or of one sub-image, put together without holding what they show."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sirpy import _core
from sirpy.errors import InputError
from sirpy.native_images import NativeImage, SubImage
from sirpy.rectangle import Rectangle
from sirpy.windows import open_map
from sirpy.workspace import Workspace

_CACHE = 64  # of GDAL's blocks, MB


@dataclass(frozen=True)
class Frame:
    """What a small view shows: a rectangle of a native image, and of each sub-image the pixels to show.

    A view has one pixel for each middle of a square of factor x factor of the rectangle.
    """

    rectangle: Rectangle
    parts: tuple[tuple[SubImage, Rectangle], ...]
    factor: int

    @classmethod
    def of_native(cls, native: NativeImage, longest_side: int) -> Frame:
        """A whole native image in at most `longest_side` pixels: each sub-image shows its core."""
        parts = tuple((sub, sub.core) for sub in native.sub_images)
        return cls(native.rectangle, parts, _decimation(native.rectangle, longest_side))

    @classmethod
    def of_sub_image(cls, sub_image: SubImage, longest_side: int) -> Frame:
        """All that a sub-image stores in at most `longest_side` pixels."""
        stored = sub_image.stored
        return cls(stored, ((sub_image, stored),), _decimation(stored, longest_side))

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of a view."""
        return self._before(self.rectangle.height), self._before(self.rectangle.width)

    def places(self) -> Iterator[tuple[SubImage, Rectangle, tuple[slice, slice]]]:
        """The parts that hold a middle, with the rows and columns of the view that they fill."""
        for sub_image, shown in self.parts:
            rows, columns = shown.slices_in(self.rectangle)
            place = (
                slice(self._before(rows.start), self._before(rows.stop)),
                slice(self._before(columns.start), self._before(columns.stop)),
            )
            if all(one.stop > one.start for one in place):
                yield sub_image, shown, place

    def held(self) -> NDArray[np.bool_]:
        """True at the middles that a sub-image holds, (height, width)."""
        held = np.zeros(self.shape, np.bool_)
        for _, _, place in self.places():
            held[place] = True
        return held

    def middles(self, place: tuple[slice, slice]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """y and x of the middles of a place, native pixels."""
        y, x = (np.arange(one.start, one.stop) * self.factor + self.factor // 2 for one in place)
        return y + self.rectangle.y0, x + self.rectangle.x0

    def _before(self, edge: int) -> int:
        """How many middles lie before an edge."""
        return max(0, -(-(edge - self.factor // 2) // self.factor))


def photograph(workspace: Workspace, frame: Frame) -> NDArray[np.uint8]:
    """RGB (height, width, 3), decimated by averages; 16 bits become 8 as in `windows.read_window`.

    Raises:
        InputError: a sub-image cannot be read.
    """
    small = np.zeros((*frame.shape, 3), np.uint8)
    for sub_image, shown, (rows, columns) in frame.places():
        shape = (rows.stop - rows.start, columns.stop - columns.start)
        pixels = _mean_pixels(workspace.image(sub_image), sub_image, shown, shape)
        small[rows, columns] = _core.convert_pixels(pixels, "color", workspace.white)
    return small


def depth_map(workspace: Workspace, frame: Frame) -> NDArray[np.float32]:
    """Depths at the middles (height, width).

    0 where a pixel has no depth, and where a sub-image has no depth map.

    Raises:
        InputError: a depth map is damaged or of another size than its sub-image.
    """

    def path_of(sub_image: SubImage) -> Path | None:
        path = workspace.depth_map(sub_image, "geometric")
        return path if path.exists() else None

    depth = sampled_map(frame, path_of)[0]
    return np.where(np.isfinite(depth), depth, np.float32(0))


def sampled_map(
    frame: Frame, path_of: Callable[[SubImage], Path | None], channels: int = 1
) -> NDArray[np.float32]:
    """Any map at the middles, (channels, height, width); 0 where a sub-image has none.

    Raises:
        InputError: a map is missing, damaged or of another size than its sub-image.
    """
    small = np.zeros((channels, *frame.shape), np.float32)
    for sub_image, _, place in frame.places():
        path = path_of(sub_image)
        if path is not None:
            y, x = frame.middles(place)
            stored = open_map(path, sub_image.stored, channels)
            for plane, target in zip(stored, small, strict=True):
                target[place] = plane[np.ix_(y - sub_image.stored.y0, x - sub_image.stored.x0)]
    return small


def _decimation(rectangle: Rectangle, longest_side: int) -> int:
    """The whole factor that brings a rectangle to at most `longest_side` pixels."""
    return max(1, -(-max(rectangle.width, rectangle.height) // longest_side))


def _mean_pixels(
    path: Path, sub_image: SubImage, shown: Rectangle, shape: tuple[int, int]
) -> NDArray[Any]:
    """RGB as stored."""
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.errors import NotGeoreferencedWarning, RasterioError
    from rasterio.windows import Window

    stored = sub_image.stored
    window = Window(shown.x0 - stored.x0, shown.y0 - stored.y0, shown.width, shown.height)
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
    return np.ascontiguousarray(np.moveaxis(pixels, 0, -1))
