"""Rasters as files: what a GIS finds in them, and that tiles are a partition of the whole."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from cloud_scenes import UTM
from engine_scenes import Notes
from sirpy.block_store import BlockStore
from sirpy.errors import InputError, OutputError
from sirpy.frame import Frame
from sirpy.lattice import Lattice, aligned_blocks
from sirpy.raster_files import NODATA, write_raster, write_tiles
from sirpy.rectangle import Rectangle
from sirpy.workspace import Workspace

CELL, SIDE = 0.5, 64
# Beside the central meridian, where grid north is not that of Web Mercator.
EAST = Frame("EPSG:32614", translation=np.array([7.5e5, 3.3e6, 0.0]))


def heights_at(folder: Path, frame: Frame, columns: int = 300, rows: int = 220) -> BlockStore:
    """Noise with a hole and ragged borders, at the origin of the frame."""
    random = np.random.default_rng(0)
    x, y = (round(float(at) / CELL) for at in frame.translation[:2])
    window = Rectangle(x + 17, -y + 5, columns, rows)
    store = BlockStore(folder, Lattice(CELL), SIDE, 1, np.dtype(np.float32))
    for block in aligned_blocks(window, SIDE):
        values = random.normal(100, 5, (1, SIDE, SIDE)).astype(np.float32)
        inside = np.zeros((SIDE, SIDE), bool)
        inside[block.intersection(window).slices_in(block)] = True
        values[:, ~inside | (random.random((SIDE, SIDE)) < 0.2)] = np.nan
        store.write(block, values)
    return store


def read(path: Path) -> tuple[Any, Any]:
    with rasterio.open(path) as file:
        return file.read(), file.transform


def test_a_file_is_what_a_gis_expects(tmp_path: Path) -> None:
    store = heights_at(tmp_path / "blocks", UTM, 1100, 700)
    write_raster(tmp_path / "out.tif", store, UTM)
    with rasterio.open(tmp_path / "out.tif") as file:
        assert file.crs.to_epsg() == 32614
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert file.tags(ns="IMAGE_STRUCTURE")["COMPRESSION"] == "DEFLATE"
        assert file.tags(ns="IMAGE_STRUCTURE")["PREDICTOR"] == "3"
        assert file.tags()["AREA_OR_POINT"] == "Area"
        assert file.block_shapes == [(512, 512)]
        assert file.overviews(1) == [2, 4]
        assert (file.nodata, file.dtypes) == (NODATA, ("float32",))
        assert file.res == (CELL, CELL)
        assert file.bounds.left / CELL == store.window.x0
        assert file.bounds.top / CELL == -store.window.y0
        values = file.read(1, masked=True)
        small = file.read(1, masked=True, out_shape=(file.height // 2, file.width // 2))
    stored = store.read(store.window)[0]
    np.testing.assert_array_equal(values.mask, np.isnan(stored))
    np.testing.assert_array_equal(values.compressed(), stored[~np.isnan(stored)])
    # An overview is the mean of the cells that have a height.
    squares = stored[: small.shape[0] * 2, : small.shape[1] * 2]
    squares = squares.reshape(small.shape[0], 2, small.shape[1], 2).transpose(0, 2, 1, 3)
    with np.testing.suppress_warnings() as quiet:
        quiet.filter(RuntimeWarning)
        means = np.nanmean(squares.reshape(*small.shape, 4), axis=-1)
    np.testing.assert_allclose(small.filled(np.nan), means, atol=1e-3)


def test_without_a_crs_there_is_still_a_place(tmp_path: Path) -> None:
    write_raster(tmp_path / "out.tif", heights_at(tmp_path / "blocks", Frame()), Frame())
    with rasterio.open(tmp_path / "out.tif") as file:
        assert file.crs is None
        assert (file.transform.c, file.transform.f) == (17 * CELL, -5 * CELL)


def test_colours_have_an_alpha_and_transparent_cells_do_not_darken_overviews(
    tmp_path: Path,
) -> None:
    store = BlockStore(tmp_path / "blocks", Lattice(CELL), 1024, 4, np.dtype(np.uint8))
    colours = np.zeros((4, 1024, 1024), np.uint8)
    colours[:, ::3, ::2] = np.array([200, 100, 50, 255])[:, None, None]
    store.write(Rectangle(0, 0, 1024, 1024), colours)
    write_raster(tmp_path / "out.tif", store, UTM)
    with rasterio.open(tmp_path / "out.tif") as file:
        assert [one.name for one in file.colorinterp] == ["red", "green", "blue", "alpha"]
        assert file.nodata is None
        small = file.read(out_shape=(4, 512, 512))
    seen = small[3] > 0
    assert 0.5 < seen.mean() < 1
    assert (small[:3, seen] == np.array([200, 100, 50])[:, None]).all()


@pytest.mark.parametrize("frame", [UTM, EAST], ids=["meridian", "east"])
@pytest.mark.parametrize("text", ["32.3", "quadkey:20"])
def test_every_cell_is_in_one_tile(tmp_path: Path, frame: Frame, text: str) -> None:
    workspace, notes = Workspace(tmp_path / "out"), Notes()
    store = heights_at(tmp_path / "blocks", frame)
    workspace.tile("old", "dsm.tif").parent.mkdir(parents=True)
    for stale in ("dsm.tif", "laz"):
        workspace.tile("old", stale).touch()
    write_tiles(workspace, "dsm.tif", store, frame, text, notes)
    paths = sorted((tmp_path / "out" / "tiles").glob("*.dsm.tif"))
    assert len(paths) >= 4 and f"{len(paths)} written" in notes.notes[-1]
    # Of an earlier tiling; other products are left alone.
    assert not workspace.tile("old", "dsm.tif").exists() and workspace.tile("old", "laz").exists()
    window = store.window
    joined = np.full((window.height, window.width), np.nan, np.float32)
    for path in paths:
        values, transform = read(path)
        column = round(transform.c / CELL) - window.x0
        row = round(-transform.f / CELL) - window.y0
        tile = np.where(values[0] == NODATA, np.float32(np.nan), values[0])
        assert not np.isnan(tile).all()
        place = joined[row : row + tile.shape[0], column : column + tile.shape[1]]
        full = ~np.isnan(tile)
        assert np.isnan(place[full]).all()  # no cell twice
        place[full] = tile[full]
    np.testing.assert_array_equal(joined, store.read(window)[0])


def test_empty_tiles_are_left_out_and_counted(tmp_path: Path) -> None:
    store = BlockStore(tmp_path / "blocks", Lattice(1.0), 32, 1, np.dtype(np.float32))
    for x0 in (0, 320):
        store.write(Rectangle(x0, -32, 32, 32), np.ones((1, 32, 32), np.float32))
    notes = Notes()
    write_tiles(Workspace(tmp_path), "dsm.tif", store, Frame(), "32", notes)
    names = sorted(path.name for path in (tmp_path / "tiles").iterdir())
    assert names == ["x0_y0.dsm.tif", "x10_y0.dsm.tif"]
    assert "2 written, " in notes.notes[-1] and "left out since they are empty" in notes.notes[-1]


def test_tiles_like_cells_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"hardly larger than a cell of 0.5: choose larger"):
        store = heights_at(tmp_path / "blocks", Frame())
        write_tiles(Workspace(tmp_path), "dsm.tif", store, Frame(), "1", Notes())


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(disk)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("mounting a small disk needs root")
    yield disk
    subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.parametrize("size", ["1m", "3m", "6m"])
def test_a_full_disk_is_said_and_leaves_nothing(
    tmp_path: Path, small_disk: Path, size: str
) -> None:
    """Full while the plain file is written, at its end, and while the optimised one is."""
    subprocess.run(["mount", "-o", f"remount,size={size}", str(small_disk)], check=True)
    store = heights_at(tmp_path / "blocks", Frame(), 1000, 900)
    with pytest.raises(OutputError, match=r"cannot write .*out\.tif.*free some space"):
        write_raster(small_disk / "out.tif", store, Frame())
    assert list(small_disk.iterdir()) == []
    subprocess.run(["mount", "-o", "remount,size=40m", str(small_disk)], check=True)
    write_raster(small_disk / "out.tif", store, Frame())
    assert [path.name for path in small_disk.iterdir()] == ["out.tif"]
