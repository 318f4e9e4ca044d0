"""Rasters as Cloud-Optimised GeoTIFF, whole and tile by tile, of a store of blocks.

Lossless, so that a cell has the same value in its tile and in the whole.
"""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sirpy.block_store import BlockStore, held
from sirpy.errors import InputError, OutputError
from sirpy.files import written_whole
from sirpy.frame import Frame
from sirpy.progress import Progress
from sirpy.rectangle import Rectangle
from sirpy.tiles import Tile, tiling
from sirpy.workspace import Workspace

NODATA = -9999.0  # of heights: what every reader takes
_BLOCK = 512  # cells, of the files
_CACHE = 64  # of GDAL's blocks, MB
_SMALLEST_TILE = 8  # cells

_Read = Callable[[Rectangle], NDArray[Any]]


@contextmanager
def scratch_folder(product: Path, what: str) -> Iterator[Path]:
    """A folder beside a product for what it is made of; removed at the end, and after a crash with other unfinished
    files (sirpy.workspace)."""
    folder = product.with_name(f".{product.stem}.{what}.{os.getpid()}.tmp")
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def write_raster(path: Path, store: BlockStore, frame: Frame) -> None:
    """All that a store holds as one file.

    Raises:
        OutputError: it cannot be written.
    """
    _write(path, store, frame, store.window, store.read)


def write_tiles(
    workspace: Workspace,
    extension: str,
    store: BlockStore,
    frame: Frame,
    text: str,
    progress: Progress,
) -> None:
    """A file for each tile of the ground that holds something; those of an earlier tiling are removed.

    Cells belong to the tile that their centre lies in.

    Raises:
        InputError: `text` is no tiling (sirpy.tiles), or its tiles are hardly larger than a cell.
        OutputError: a file cannot be written.
    """
    for old in workspace.tile("x", extension).parent.glob(f"*.{extension}"):
        old.unlink()
    tiles = list(_tiles(store, frame, text))
    written = 0
    with progress.stage(f"tiles of {extension}", len(tiles), "tile") as steps:
        for tile, window in tiles:
            inside = _inside(store, tile)
            if any(held(inside(part)).any() for part in _parts(window) if store.touches(part)):
                _write(workspace.tile(tile.name, extension), store, frame, window, inside)
                written += 1
            steps.advance()
    progress.note(
        f"tiles of {extension}: {written} written, {len(tiles) - written} left out since they are empty"
    )


def check_tiles(text: str | None, frame: Frame) -> None:
    """Raises InputError where `text` is no tiling, before anything is done."""
    if text is not None:
        tiling(text, frame)


def _tiles(store: BlockStore, frame: Frame, text: str) -> Iterator[tuple[Tile, Rectangle]]:
    """The tiles that touch the cells of a store, and which cells they may own."""
    lattice = store.lattice
    for tile in tiling(text, frame).tiles(*lattice.box(store.window)):
        x0, y0, x1, y1 = tile.bounds
        if min(x1 - x0, y1 - y0) < _SMALLEST_TILE * lattice.cell:
            raise InputError(
                f"--tiles {text} are hardly larger than a cell of {lattice.cell:g}: choose larger tiles"
            )
        window = lattice.around(x0, y0, x1, y1).intersection(store.window)
        if window.area > 0:
            yield tile, window


def _inside(store: BlockStore, tile: Tile) -> _Read:
    empty = np.nan if store.dtype.kind == "f" else 0

    def read(window: Rectangle) -> NDArray[Any]:
        values = store.read(window)
        centres = store.lattice.centres(window).reshape(-1, 2)
        values[:, ~tile.contains(centres).reshape(values.shape[1:])] = empty
        return values

    return read


def _parts(window: Rectangle) -> Iterator[Rectangle]:
    """The blocks of a file, clipped to it."""
    for y0 in range(window.y0, window.y1, _BLOCK):
        for x0 in range(window.x0, window.x1, _BLOCK):
            yield Rectangle(x0, y0, _BLOCK, _BLOCK).intersection(window)


def _write(path: Path, store: BlockStore, frame: Frame, window: Rectangle, read: _Read) -> None:
    """First an ordinary GeoTIFF beside, since a cloud-optimised one cannot be written in parts."""
    import rasterio
    from rasterio import shutil as copying
    from rasterio.errors import NotGeoreferencedWarning

    with written_whole(path) as temporary, scratch_folder(path, "plain") as folder:
        folder.mkdir()
        plain, optimised = folder / "plain.tif", folder / "optimised.tif"
        with (
            warnings.catch_warnings(),
            rasterio.Env(GDAL_CACHEMAX=_CACHE),
            _gdal_errors(path),
        ):
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            _write_plain(plain, store, frame, window, read)
            copying.copy(plain, optimised, driver="COG", **_creation(store))
        plain.unlink()
        os.replace(optimised, temporary)


def _write_plain(
    plain: Path, store: BlockStore, frame: Frame, window: Rectangle, read: _Read
) -> None:
    import rasterio
    from rasterio.enums import ColorInterp
    from rasterio.windows import Window

    cell = store.lattice.cell
    heights = store.dtype.kind == "f"
    profile = {
        "driver": "GTiff",
        "width": window.width,
        "height": window.height,
        "count": store.bands,
        "dtype": store.dtype.name,
        "crs": frame.crs,
        "transform": rasterio.Affine(cell, 0, window.x0 * cell, 0, -cell, -window.y0 * cell),
        "nodata": NODATA if heights else None,
        "tiled": True,
        "blockxsize": _BLOCK,
        "blockysize": _BLOCK,
        "interleave": "pixel",
        "bigtiff": "yes",
    }
    with rasterio.open(plain, "w", **profile) as file:
        file.update_tags(AREA_OR_POINT="Area")
        if heights:
            file.set_band_description(1, "height")
        else:
            file.colorinterp = [
                ColorInterp.red,
                ColorInterp.green,
                ColorInterp.blue,
                ColorInterp.alpha,
            ]
        for part in _parts(window):
            values = read(part)
            if heights:
                values = np.where(np.isnan(values), np.float32(NODATA), values)
            place = Window(part.x0 - window.x0, part.y0 - window.y0, part.width, part.height)
            file.write(values, window=place)
    # GDAL may lose what it has kept back when it closes a file on a full disk, and not say so.
    if plain.stat().st_size < window.area * store.bands * store.dtype.itemsize:
        raise OSError(28, "No space left on device")


def _creation(store: BlockStore) -> dict[str, Any]:
    return {
        "compress": "DEFLATE",
        "predictor": "YES",  # 3 of floating point, 2 of whole numbers
        "blocksize": _BLOCK,
        "overviews": "AUTO",
        "overview_resampling": "AVERAGE",  # of the cells that hold something
        "bigtiff": "IF_SAFER",
    }


@contextmanager
def _gdal_errors(path: Path) -> Iterator[None]:
    """Raises OutputError for GDAL's errors, which do not tell their cause."""
    from rasterio._err import CPLE_BaseError
    from rasterio.errors import RasterioError

    try:
        yield
    except (CPLE_BaseError, RasterioError) as error:
        raise OutputError(
            f"cannot write {path} ({error.__cause__ or error}): free some space or choose another output folder, "
            "then run the same command again"
        ) from error
