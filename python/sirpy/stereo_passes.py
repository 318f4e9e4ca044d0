"""The units and maps of the passes of stereo, coarse to native.

Level l has pixels of 2^l native ones, counted from the corner of the native image; rectangles here are in pixels of
their level. The coarsest levels are worked on by whole photographs, the finer ones by sub-images. Every pass writes
what it finds, so the next one, of any unit, can start from it: the reach of a pass does not add to that of others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sirpy import _core
from sirpy.native_images import NativeImage, SubImage
from sirpy.npy import open_npy, write_npy
from sirpy.rectangle import Rectangle
from sirpy.stereo_backend import DepthMap, Plane, StereoBackend
from sirpy.windows import read_window
from sirpy.workspace import Workspace

_CHANNELS: dict[Plane, int] = {
    "depth": 1,
    "normal": 3,
    "views": 1,
    "sigma": 1,
    "level": 1,
    "cost": 1,
    "texture": 1,
    "counts": 1,
}
_WORDS: tuple[Plane, ...] = ("views", "level", "counts")  # whole numbers, as the bits of floats
_BAND_PIXELS = 8_000_000  # native ones, read at once to be shrunk


@dataclass(frozen=True)
class Unit:
    """What a pass estimates at once: pixels of one native image that it keeps, in pixels of the level."""

    native: NativeImage
    sub_image: SubImage | None  # None: the whole photograph
    kept: Rectangle

    @property
    def name(self) -> str:
        return self.sub_image.name if self.sub_image else self.native.name


def at_level(rectangle: Rectangle, level: int) -> Rectangle:
    """The pixels of a level whose first native pixel is inside: rectangles that tile an image tile its
    levels."""
    step = 1 << level
    return Rectangle.from_corners(
        -(-rectangle.x0 // step),
        -(-rectangle.y0 // step),
        -(-rectangle.x1 // step),
        -(-rectangle.y1 // step),
    )


def native_pixels(rectangle: Rectangle, level: int, image: Rectangle) -> Rectangle:
    """The native pixels of a rectangle of a level."""
    x0, y0, width, height = (value << level for value in rectangle.as_tuple())
    return Rectangle(x0, y0, width, height).intersection(image)


def units(natives: tuple[NativeImage, ...], level: int, coarsest: int) -> Iterator[Unit]:
    """Whole photographs (what is cut of them) at level `coarsest` and above, otherwise the cores of the
    sub-images; those without a pixel of the level are none."""
    for native in natives:
        whole = level >= coarsest
        for sub in (None,) if whole else native.sub_images:
            kept = at_level(sub.core if sub else native.covered, level)
            if kept.area:  # what is narrower than a pixel of the level may own none
                yield Unit(native, sub, kept)


def read_pixels(
    workspace: Workspace,
    native: NativeImage,
    rectangle: Rectangle,
    level: int,
    pixels: Literal["grey", "color"],
) -> npt.NDArray[np.uint8]:
    """A rectangle of a level, (height, width) or (height, width, 3): means of blocks of native pixels.

    Beyond what is cut of the photograph the nearest pixels go on.
    """
    inside = rectangle.intersection(at_level(native.covered, level))
    found = _read_inside(workspace, native, inside, level, pixels)
    if inside == rectangle:
        return found
    width = [
        (inside.y0 - rectangle.y0, rectangle.y1 - inside.y1),
        (inside.x0 - rectangle.x0, rectangle.x1 - inside.x1),
    ]
    return np.pad(found, [*width, (0, 0)][: found.ndim], mode="edge")


def _read_inside(
    workspace: Workspace,
    native: NativeImage,
    rectangle: Rectangle,
    level: int,
    pixels: Literal["grey", "color"],
) -> npt.NDArray[np.uint8]:
    if level == 0:
        return read_window(workspace, native.name, rectangle, pixels)
    channels = 1 if pixels == "grey" else 3
    found = np.empty((rectangle.height, rectangle.width, channels), np.uint8)
    rows = max(1, _BAND_PIXELS >> 2 * level) // rectangle.width + 1
    for y in range(0, rectangle.height, rows):
        band = Rectangle(
            rectangle.x0, rectangle.y0 + y, rectangle.width, min(rows, rectangle.height - y)
        )
        window = native_pixels(band, level, native.rectangle)
        read = read_window(workspace, native.name, window, pixels)
        for channel, plane in enumerate(read.reshape(*read.shape[:2], channels).transpose(2, 0, 1)):
            shrunk = _core.shrunk(np.ascontiguousarray(plane), 1 << level)
            found[y : y + band.height, :, channel] = shrunk
    return found[..., 0] if pixels == "grey" else found


def nothing_found(window: Rectangle) -> DepthMap:
    """What is found in a photograph without any source."""
    shape = window.height, window.width
    numbers, counts = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
    return DepthMap(
        depth=numbers,
        normal=np.zeros((3, *shape), np.float32),
        views=np.zeros(shape, np.uint32),
        cost=numbers,
        texture=numbers,
        num_seeing=counts,
        num_consistent=counts,
        sigma=numbers,
        motion=numbers,
        level=counts,
    )


def write_planes(
    path: Path, found: DepthMap, planes: tuple[Plane, ...], kept: tuple[slice, slice]
) -> None:
    """Writes what the next pass starts from of the rows and columns `kept`, whole or not at all."""
    parts = []
    for name in planes:
        plane = _counts(found) if name == "counts" else getattr(found, name)
        if name in _WORDS:
            plane = plane.astype(np.uint32, copy=False).view(np.float32)
        parts.append((plane if plane.ndim == 3 else plane[None])[(slice(None), *kept)])
    write_npy(path, np.concatenate(parts))


def _counts(found: DepthMap) -> npt.NDArray[np.uint32]:
    """Sources that see a pixel, and 256 times those that agree."""
    assert found.num_seeing is not None and found.num_consistent is not None
    return found.num_seeing + found.num_consistent.astype(np.uint32) * np.uint32(256)


def seeing_and_consistent(
    counts: npt.NDArray[np.uint32],
) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.uint32]]:
    """What the plane "counts" holds: sources that see a pixel, and those that agree."""
    return counts & np.uint32(255), counts >> np.uint32(8)


class PassMaps:
    """The maps that a pass has written, read in any rectangle of its level."""

    def __init__(self, workspace: Workspace, of_pass: StereoBackend, coarsest: int) -> None:
        self.level = of_pass.level
        self._place: dict[Plane, slice] = {}
        self._channels = 0
        for name in of_pass.planes:
            end = self._channels + _CHANNELS[name]
            self._place[name] = slice(self._channels, end)
            self._channels = end
        self._workspace, self._pass = workspace, of_pass
        self._units: dict[str, list[Unit]] = {one.name: [] for one in workspace.natives}
        for unit in units(workspace.natives, of_pass.level, coarsest):
            self._units[unit.native.name].append(unit)
        self._extent = {one.name: at_level(one.covered, self.level) for one in workspace.natives}

    def read(self, native: str, rectangle: Rectangle, kind: Plane) -> npt.NDArray[Any]:
        """A plane, (height, width); normals (3, height, width); sources as words of bits, uint32.

        0 where nothing was estimated.

        Raises:
            InputError: a file is missing or damaged.
        """
        planes = self._place[kind]
        count = planes.stop - planes.start
        window = np.zeros((count, rectangle.height, rectangle.width), np.float32)
        for unit in self._units[native]:
            part = unit.kept.intersection(rectangle)
            if part.area:
                found = self._open(unit)[planes]
                window[(slice(None), *part.slices_in(rectangle))] = found[
                    (slice(None), *part.slices_in(unit.kept))
                ]
        if kind in _WORDS:
            window = window.view(np.uint32)
        return window if kind == "normal" else window[0]

    def has(self, kind: Plane) -> bool:
        """Whether the pass has written a plane."""
        return kind in self._place

    def read_coarser(
        self, native: NativeImage, rectangle: Rectangle, levels: int, kind: Plane = "depth"
    ) -> npt.NDArray[np.float32]:
        """A plane in a rectangle of a level that is coarser by `levels`: what is next to the centres."""
        if levels == 0:
            return self.read(native.name, rectangle, kind)
        image = at_level(native.rectangle, self.level)
        fine = native_pixels(rectangle, levels, image)
        plane = self.read(native.name, fine, kind)
        half = 1 << (levels - 1)
        rows = np.minimum((np.arange(rectangle.height) << levels) + half, fine.height - 1)
        columns = np.minimum((np.arange(rectangle.width) << levels) + half, fine.width - 1)
        return np.ascontiguousarray(plane[np.ix_(rows, columns)])

    def start(self, native: str, rectangle: Rectangle, level: int) -> _core.StartMaps | None:
        """What a pass over a rectangle of a level starts from; the maps are of that level or one coarser.

        None where the pass before had no pixel of the native image.
        """
        rectangle = self.start_rectangle(native, rectangle, level)
        if not rectangle.area:
            return None
        known = self.has("sigma")
        return _core.StartMaps(
            level=self.level,
            x0=rectangle.x0,
            y0=rectangle.y0,
            depth=self.read(native, rectangle, "depth"),
            normal=self.read(native, rectangle, "normal"),
            views=self.read(native, rectangle, "views"),
            sigma=self.read(native, rectangle, "sigma") if known else None,
            level_of=self.read(native, rectangle, "level").astype(np.uint8) if known else None,
        )

    def start_rectangle(self, native: str, rectangle: Rectangle, level: int) -> Rectangle:
        """The pixels of these maps that a pass over a rectangle of a level, theirs or the next finer one, starts
        from: the four nearest of each pixel. Empty where there are none."""
        image = self._extent[native]
        if self.level == level or not image.area:
            return rectangle.intersection(image)
        x0, y0 = rectangle.x0 // 2, rectangle.y0 // 2
        x1, y1 = (rectangle.x1 + 1) // 2, (rectangle.y1 + 1) // 2
        return Rectangle.from_corners(x0, y0, x1, y1).padded(1).intersection(image)

    def _open(self, unit: Unit) -> npt.NDArray[np.float32]:
        path = self._workspace.pass_map(unit.name, self._pass.name)
        shape = self._channels, unit.kept.height, unit.kept.width
        return open_npy(path, np.float32, shape, "the stereo")
