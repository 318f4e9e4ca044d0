"""The true orthophoto: the photographs as they would look straight from above, on the heights of the surface model.

Each cell has the colour of the photograph that sees it best (sirpy.best_views). Photographs keep their exposures:
where these differ, seams show.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sirpy.best_views import BestViews
from sirpy.block_store import BlockStore
from sirpy.errors import InputError, first_few
from sirpy.lattice import Lattice, aligned_blocks
from sirpy.products import open_cloud
from sirpy.progress import Progress
from sirpy.raster_files import scratch_folder, write_raster, write_tiles
from sirpy.rectangle import Rectangle
from sirpy.surface_model import BLOCK, check_options, find_heights
from sirpy.workspace import Workspace

_SAMPLE = np.dtype(np.uint8)
_LEAST_SHARE = 0.5  # of the parts of a cell that have a colour


def orthophoto(
    workspace: Workspace,
    *,
    resolution: float | None = None,
    fill: float | None = None,
    tiles: str | None = None,
    progress: Progress | None = None,
) -> Path:
    """Writes the orthophoto ortho.tif (8 bit, red, green, blue, alpha); returns its path.

    A cell is transparent where the surface has no height, or no photograph sees it. It lies cell on cell on a surface
    model of the same resolution. Cells of several pixels are the means of finer ones.

    Args:
        resolution: side of a cell, in the unit of the frame; if None, the GSD of the cloud rounded up.
        fill: the widest gap of the surface that is filled, in the unit of the frame.
        tiles: also one file for each tile of this tiling (`sirpy.tiles.tiling`).

    Raises:
        InputError: there is no cloud, it is empty, an option is not possible, or there is no depth map.
        OutputError: a file cannot be written.
    """
    progress = progress or Progress()
    cloud = open_cloud(workspace)
    lattice = check_options(cloud, resolution, fill, tiles)
    parts = max(1, round(lattice.cell / cloud.gsd)) if cloud.gsd > 0 else 1
    path = workspace.orthophoto
    with scratch_folder(path, "blocks") as folder:
        fine = Lattice(lattice.cell / parts)
        heights = find_heights(cloud, fine, fill, folder, progress)
        views = BestViews(workspace, cloud.frame)
        if views.left_out:
            names = first_few([out.name for out in views.left_out])
            progress.note(f"orthophoto: without sub-images that have no sound depth map: {names}")
        colours = BlockStore(folder / "colours", lattice, max(1, BLOCK // parts), 4, _SAMPLE)
        _colour(colours, heights, views, parts, progress)
        progress.note(
            f"orthophoto: {colours.window.width} x {colours.window.height} cells of "
            f"{lattice.cell:g}, {colours.cells / colours.window.area:.1%} with a colour"
        )
        write_raster(path, colours, cloud.frame)
        if tiles is not None:
            write_tiles(workspace, "ortho.tif", colours, cloud.frame, tiles, progress)
    return path


def _colour(
    colours: BlockStore, heights: BlockStore, views: BestViews, parts: int, progress: Progress
) -> None:
    """Fills `colours`; each of its cells is parts x parts cells of the heights. Raises InputError where none has a
    colour."""
    fine = heights.window.aligned(parts)
    coarse = Rectangle.from_corners(
        fine.x0 // parts, fine.y0 // parts, fine.x1 // parts, fine.y1 // parts
    )
    blocks = [
        (block, window)
        for block in aligned_blocks(coarse, colours.side)
        if heights.touches(window := Rectangle(*(parts * edge for edge in block.as_tuple())))
    ]
    with progress.stage("orthophoto", len(blocks), "block") as steps:
        for block, window in blocks:
            seen = _seen_colours(views, heights.lattice, window, heights.read(window)[0])
            colours.write(block, _mean(seen, parts))
            steps.advance()
    if colours.cells == 0:
        raise InputError(
            "no photograph shows the surface: check that cloud and cameras belong together"
        )


def _seen_colours(
    views: BestViews, lattice: Lattice, window: Rectangle, heights: NDArray[np.float32]
) -> NDArray[np.uint8]:
    """Red, green, blue and alpha (4, height, width) of the cells of a window."""
    colours = np.zeros((4, *heights.shape), np.uint8)
    known = ~np.isnan(heights)
    if known.any():
        places = np.column_stack([lattice.centres(window)[known], heights[known]])
        colour, seen = views.colours(places)
        colours[:3, known] = colour.T
        colours[3, known] = np.where(seen, 255, 0)
    return colours


def _mean(colours: NDArray[np.uint8], parts: int) -> NDArray[np.uint8]:
    """Cells of parts x parts finer ones: the mean of those that have a colour, if enough have."""
    bands, height, width = colours.shape
    shape = (bands, height // parts, parts, width // parts, parts)
    alpha = (colours[3:] > 0).astype(np.uint32)
    count = alpha.reshape(1, *shape[1:]).sum(axis=(2, 4))
    total = (colours * alpha).reshape(shape).sum(axis=(2, 4))
    mean = (2 * total + count) // np.maximum(2 * count, 1)
    mean[:, (count < _LEAST_SHARE * parts**2)[0]] = 0
    cells: NDArray[np.uint8] = mean.astype(np.uint8)
    return cells
