"""The digital surface model: the height of what is seen from above, cell by cell (cpp/src/surface_model.h).

Blocks of cells are made one after the other of the points in and around them, and kept in files: memory depends
neither on the area nor on the number of points.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sirpy import _core
from sirpy.block_store import BlockStore
from sirpy.cloud import Cloud
from sirpy.errors import InputError
from sirpy.lattice import Lattice, aligned_blocks, choose_lattice
from sirpy.products import open_cloud
from sirpy.progress import Progress
from sirpy.raster_files import check_tiles, scratch_folder, write_raster, write_tiles
from sirpy.workspace import Workspace

BLOCK = 512  # cells, and pixels on the ground: side of what is made at a time
_LONGEST_GAP = 500  # cells
_THICKNESS = 4  # GSD of the cloud: what belongs to one layer
_HEIGHT = np.dtype(np.float32)


def surface_model(
    workspace: Workspace,
    *,
    resolution: float | None = None,
    fill: float | None = None,
    tiles: str | None = None,
    progress: Progress | None = None,
) -> Path:
    """Writes the surface model dsm.tif (float32, heights of the frame) of the workspace's cloud; returns its path.

    Args:
        resolution: side of a cell, in the unit of the frame; if None, the GSD of the cloud rounded up.
        fill: the widest gap that is filled, in the unit of the frame; if None, gaps have no height.
        tiles: also one file for each tile of this tiling (`sirpy.tiles.tiling`).

    Raises:
        InputError: there is no cloud, it is empty, or an option is not possible.
        OutputError: a file cannot be written.
    """
    progress = progress or Progress()
    cloud = open_cloud(workspace)
    lattice = check_options(cloud, resolution, fill, tiles)
    path = workspace.surface_model
    with scratch_folder(path, "blocks") as folder:
        heights = find_heights(cloud, lattice, fill, folder, progress)
        progress.note(
            f"surface model: {heights.window.width} x {heights.window.height} cells of "
            f"{lattice.cell:g}, {heights.cells / heights.window.area:.1%} with a height"
        )
        write_raster(path, heights, cloud.frame)
        if tiles is not None:
            write_tiles(workspace, "dsm.tif", heights, cloud.frame, tiles, progress)
    return path


def check_options(
    cloud: Cloud, resolution: float | None, fill: float | None, tiles: str | None
) -> Lattice:
    """The lattice of a product; raises InputError where an option is not possible, or the cloud is empty."""
    if cloud.count == 0:
        raise InputError("the cloud holds no points: there is no surface to model")
    check_tiles(tiles, cloud.frame)
    lattice = choose_lattice(resolution, cloud.gsd, cloud.low, cloud.high)
    if fill is not None and not 0 < fill <= _LONGEST_GAP * lattice.cell:
        raise InputError(
            f"--fill {fill:g} is not possible: choose a length above 0, of at most {_LONGEST_GAP} "
            f"cells, {_LONGEST_GAP * lattice.cell:g}"
        )
    return lattice


def find_heights(
    cloud: Cloud, lattice: Lattice, fill: float | None, folder: Path, progress: Progress
) -> BlockStore:
    """The heights of all cells (one band), kept in `folder`; gaps filled where asked for.

    Raises:
        InputError: there are not enough points for a single cell.
        OutputError: the disk is full.
    """
    options = _core.SurfaceOptions()
    options.cell = lattice.cell
    options.reach = max(lattice.cell, cloud.gsd)
    options.thickness = max(_THICKNESS * cloud.gsd, lattice.cell)
    store = BlockStore(folder / "heights", lattice, block_side(cloud, lattice), 1, _HEIGHT)
    around = lattice.around(cloud.low[0], cloud.low[1], cloud.high[0], cloud.high[1])
    blocks = list(aligned_blocks(around.padded(options.margin), store.side))
    with progress.stage("surface", len(blocks), "block") as steps:
        for block in blocks:
            points = cloud.inside(*lattice.box(block.padded(options.margin)))
            if len(points) > 0:
                place = dict(
                    zip(("column", "row", "width", "height"), block.as_tuple(), strict=True)
                )
                store.write(block, _core.surface_heights(points, **place, options=options)[None])
            steps.advance()
    if store.cells == 0:
        raise InputError(
            f"the cloud is too sparse for cells of {lattice.cell:g}: give a larger --resolution"
        )
    return store if fill is None else _filled(store, fill, options, folder / "filled", progress)


def block_side(cloud: Cloud, lattice: Lattice) -> int:
    """Cells along a block: of coarse cells fewer, so that it does not hold more points."""
    pixels = cloud.gsd / lattice.cell if cloud.gsd > 0 else 1.0
    return max(1, min(BLOCK, int(BLOCK * 2 * pixels)))


def _filled(
    store: BlockStore,
    fill: float,
    options: _core.SurfaceOptions,
    folder: Path,
    progress: Progress,
) -> BlockStore:
    """The same heights, gaps of at most the length `fill` filled."""
    gaps = _core.GapOptions()
    gaps.cell, gaps.step = store.lattice.cell, options.thickness
    gaps.longest = fill / gaps.cell
    filled = BlockStore(folder, store.lattice, store.side, 1, _HEIGHT)
    blocks = store.blocks(gaps.margin)
    with progress.stage("fill", len(blocks), "block") as steps:
        for block in blocks:
            heights = store.read(block.padded(gaps.margin))[0]
            filled.write(block, _core.fill_gaps(heights, options=gaps)[None])
            steps.advance()
    progress.note(
        f"fill: {filled.cells - store.cells} cells in gaps of at most {fill:g} have a height from the "
        f"lower side of their gap, {1 - store.cells / filled.cells:.1%} of all"
    )
    return filled
