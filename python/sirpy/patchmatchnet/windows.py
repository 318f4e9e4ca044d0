"""PatchmatchNet on windows of images of any size.

Everything that a pixel is given is a field over the whole image: features, random numbers, depth range, which sources
may be matched, and where the published network samples. So a window changes nothing but what lies beyond its margin.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from threading import Lock

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from sirpy.npy import open_npy, write_npy
from sirpy.patchmatchnet.bands import Bands
from sirpy.patchmatchnet.features import CHANNELS, REACH, STEP
from sirpy.patchmatchnet.network import PatchmatchNet, projection, source_from_reference
from sirpy.patchmatchnet.refinement import as_float, doubled
from sirpy.patchmatchnet.sampling import Frame, SourceMap
from sirpy.patchmatchnet.stage import INITIAL, SETTINGS, InverseRange, Problem
from sirpy.rectangle import Rectangle
from sirpy.stereo_backend import DepthMap, DepthRange, View

_ROW = 4096  # pixels of a row of tiles that are read at once
TILE = 512  # pixels on a side, whose features are found at once


class FeatureStore:
    """Features of photographs on disk, found once, by tiles that do not depend on any window.

    As 16-bit floats: 14 bytes for each pixel. (Depths differ by some millionths.)

    Args:
        half: find them in half precision, on a GPU.
    """

    def __init__(self, net: PatchmatchNet, folder: Path, bands: Bands, half: bool) -> None:
        self._folder, self._bands = folder, bands
        self._device = next(net.parameters()).device
        self._finding = Lock()
        self._kind = torch.float16 if half else torch.float32
        self._feature = copy.deepcopy(net.feature).to(self._kind)

    def find(self, views: Sequence[View]) -> None:
        """Finds and writes what is missing of the windows of photographs."""
        if not any(map(self._missing, views)):
            return
        with self._finding:  # by another thread perhaps, for the next window
            rows = [
                (view, list(tiles))
                for view in views
                for _, tiles in groupby(
                    self._missing(view), key=lambda tile: (tile.y0, tile.x0 // _ROW)
                )
            ]
            self._bands.map(lambda row: self._find_row(*row), rows)

    def read(self, view: View, stage: int) -> Tensor:
        """Features [C, h, w] of the window of a view, whose sides are multiples of `STEP`.

        On the CPU the channels of a pixel lie side by side.
        """
        window = _reduced(view.window, stage)
        channels = CHANNELS[stage]
        found = torch.empty(window.height, window.width, channels, device=self._device)
        for tile in _tiles(view):
            reduced = _reduced(tile, stage)
            part = reduced.intersection(window)
            shape = reduced.height, reduced.width, channels
            stored = open_npy(self._path(view, tile, stage), np.float16, shape, "the stereo")
            pixels = torch.from_numpy(np.array(stored[part.slices_in(reduced)]))
            found[part.slices_in(window)] = pixels.to(self._device)
        maps = found.permute(2, 0, 1)
        return maps if self._device.type == "cpu" else maps.contiguous()

    def _missing(self, view: View) -> list[Rectangle]:
        # The last stage that is written.
        return [tile for tile in _tiles(view) if not self._path(view, tile, 1).exists()]

    def _find_row(self, view: View, tiles: list[Rectangle]) -> None:
        """Of tiles beside each other: an image file gives its rows for all of them at once."""
        image = view.extent.aligned(STEP)
        row = Rectangle.from_corners(tiles[0].x0, tiles[0].y0, tiles[-1].x1, tiles[-1].y1)
        row = row.padded(REACH).intersection(image)
        pixels = view.read(row, "color")
        for tile in tiles:
            around = tile.padded(REACH).intersection(image)
            self._write(view, tile, around, pixels[around.slices_in(row)])

    def _write(
        self, view: View, tile: Rectangle, around: Rectangle, pixels: npt.NDArray[np.uint8]
    ) -> None:
        image = as_float(_tensor(pixels, self._device)).to(self._kind)[None]
        for stage, features in self._feature(image).items():
            kept = _reduced(tile, stage).slices_in(_reduced(around, stage))
            found = features.permute(1, 2, 0)[kept].half().cpu().numpy()
            write_npy(self._path(view, tile, stage), found)

    def _path(self, view: View, tile: Rectangle, stage: int) -> Path:
        name = f"{tile.y0}-{tile.x0}.stage{stage}.npy"
        return self._folder / f"{view.name}.level{view.level}" / name


def estimate(
    net: PatchmatchNet,
    features: FeatureStore,
    reference: View,
    sources: Sequence[View],
    depth_range: DepthRange,
    seed: int,
    bands: Bands,
) -> DepthMap:
    """Depths of the window of `reference`, whose sides are multiples of `STEP`."""
    device = next(net.parameters()).device
    features.find([reference, *sources])
    whole = Rectangle(0, 0, reference.camera.width, reference.camera.height).aligned(STEP)
    depth = view_weights = None
    for settings in SETTINGS:
        stage = settings.stage
        window, image = _reduced(reference.window, stage), _reduced(whole, stage)
        x, y = ((np.arange(a, b) << stage) + 0.5 for a, b in _sides(window))
        limits = InverseRange(
            *(torch.from_numpy(one).to(device) for one in depth_range.inverse(x, y))
        )
        maps = [
            SourceMap(
                features.read(source, stage),
                source_from_reference(
                    *(projection(*_camera(view), stage) for view in (source, reference))
                ).to(device),
                behind=(float(source.window.width), float(source.window.height)),
                allowed=torch.from_numpy(depth_range.allowed(x, y, source.index)).to(device),
            )
            for source in sources
        ]
        frame = Frame(window.x0 - image.x0, window.y0 - image.y0, image.width, image.height)
        problem = Problem(features.read(reference, stage), maps, limits, frame)
        initial = drawn(window, seed).to(device) if depth is None else None
        with torch.inference_mode():
            found = net.stage(stage)(problem, depth, view_weights, initial, bands)
            depth, view_weights = found.depths[-1], found.view_weights
            del problem, maps  # before those of the next stage are read
            if stage > 1:
                depth, view_weights = doubled(depth), doubled(view_weights)
    assert depth is not None
    with torch.inference_mode():
        refined = net.upsample_net(
            _tensor(reference.image, device), depth, 1 / limits.near, 1 / limits.far, bands
        )
    return DepthMap(refined.cpu().numpy())


def drawn(window: Rectangle, seed: int) -> Tensor:
    """[48, h, w]: random numbers from 0 to 1 of the pixels of a window, the same in every window."""
    y, x = (
        np.arange(a, b, dtype=np.uint64)
        for b, a in ((window.y1, window.y0), (window.x1, window.x0))
    )
    hashed = _mixed(_mixed(np.uint64(seed) << np.uint64(32) | x) ^ (y[:, None] << np.uint64(32)))
    found = np.empty((INITIAL, window.height, window.width), np.float32)
    for number, of_bin in enumerate(found):
        of_bin[:] = _mixed(hashed ^ np.uint64(number)) >> np.uint64(40)
    found /= 1 << 24
    return torch.from_numpy(found)


def _mixed(values: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """The finaliser of SplitMix64 (Steele, Lea, Flood, OOPSLA 2014)."""
    values = values + np.uint64(0x9E3779B97F4A7C15)
    values = (values ^ values >> np.uint64(30)) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ values >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
    return values ^ values >> np.uint64(31)


def _camera(view: View) -> tuple[Tensor, Tensor]:
    """Intrinsics of the window and extrinsics [4, 4]."""
    extrinsics = np.vstack([view.camera.cam_from_world, [0, 0, 0, 1]])
    return torch.from_numpy(view.intrinsics), torch.from_numpy(extrinsics)


def _tiles(view: View) -> list[Rectangle]:
    """The tiles that touch the window of a view, cut to the photograph."""
    image, window = view.extent.aligned(STEP), view.window
    grid = window.aligned(TILE)
    return [
        Rectangle(x, y, TILE, TILE).intersection(image)
        for y in range(grid.y0, grid.y1, TILE)
        for x in range(grid.x0, grid.x1, TILE)
    ]


def _reduced(rectangle: Rectangle, stage: int) -> Rectangle:
    """In pixels of a stage; corners are multiples of `STEP`."""
    return Rectangle(*(value >> stage for value in rectangle.as_tuple()))


def _sides(rectangle: Rectangle) -> tuple[tuple[int, int], tuple[int, int]]:
    return (rectangle.x0, rectangle.x1), (rectangle.y0, rectangle.y1)


def _tensor(image: npt.NDArray[np.uint8], device: torch.device) -> Tensor:
    """[3, h, w] of an image (h, w, 3), still 8 bit."""
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1))).to(device)
