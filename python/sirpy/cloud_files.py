"""The cloud as files: PLY or LAZ, in one piece or one for each tile of the ground."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Literal

from sirpy.cloud import POINT, Cloud, Points
from sirpy.errors import InputError
from sirpy.georeference import read_frame
from sirpy.laz import write_laz
from sirpy.ply import write_vertices
from sirpy.point_selection import PointSelection
from sirpy.products import open_cloud
from sirpy.progress import Progress
from sirpy.tiles import tiling
from sirpy.workspace import Workspace

Format = Literal["ply", "laz"]


def export_cloud(
    workspace: Workspace,
    *,
    format: Format = "laz",
    tiles: str | None = None,
    spacing: float | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """Writes the fused cloud in the frame of the workspace; returns the files.

    Args:
        tiles: one file for each tile with points, OUT/tiles/NAME.laz: "250" for squares of that side, "quadkey:19"
            for Bing's; every point is in exactly one. None for one file, OUT/fused.laz or
            OUT/cloud.ply. (OUT/fused.ply is in the frame of the model.)
        spacing: keeps only the best point of each cube of that side; all points if None.

    Raises:
        InputError: there is no cloud, or an option is not possible.
        OutputError: a file cannot be written.
    """
    _check_format(format)
    progress = progress or Progress()
    cloud = open_cloud(workspace)
    selection = PointSelection(cloud, spacing)
    write = _WRITERS[format]
    if tiles is None:
        path = workspace.fused_laz if format == "laz" else workspace.cloud_ply
        with progress.stage(format, cloud.count, "point") as step:
            write(path, cloud, selection.all(step))
        return [path]
    wanted = selection.tiles(tiling(tiles, cloud.frame))
    made, empty = [], 0
    with progress.stage(format, len(wanted), "tile") as step:
        for tile in wanted:
            parts = (points for points in selection.of(tile) if len(points))
            path = workspace.tile(tile.name, format)
            if (head := next(parts, None)) is None:
                empty += 1
            else:
                write(path, cloud, chain([head], parts))
                made.append(path)
            step.advance()
    for old in set(workspace.tiles_made(format)) - set(made):  # of another tiling
        old.unlink()
    progress.note(
        f"{format}: {len(made)} tiles" + (f", {empty} more have no points" if empty else "")
    )
    return made


def check_export(
    workspace: Workspace, format: str, tiles: str | None, spacing: float | None
) -> None:
    """Raises InputError unless the cloud of the workspace can be written so, whatever points it has."""
    _check_format(format)
    if tiles is not None:
        tiling(tiles, read_frame(workspace))
    if spacing is not None and not 0 < spacing < float("inf"):
        raise InputError(f"--spacing {spacing:g} is not possible: choose a length above 0")


def _check_format(format: str) -> None:
    if format not in _WRITERS:
        raise InputError(f"--format {format} is not known: choose {' or '.join(_WRITERS)}")


def write_ply(path: Path, cloud: Cloud, points: Iterator[Points]) -> int:
    """Writes some points of a cloud with all that is known of them; returns their number.

    Raises OutputError where the file cannot be written.
    """
    return write_vertices(path, POINT, points)


_WRITERS: dict[str, Callable[[Path, Cloud, Iterator[Points]], int]] = {
    "ply": write_ply,
    "laz": write_laz,
}
