"""The commands `sirpy dsm` and `sirpy ortho`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer()

WorkspaceFolder = Annotated[
    Path, typer.Argument(help="Folder of the workspace.", show_default=False)
]
Resolution = Annotated[
    float | None,
    typer.Option(help="Side of a cell, metres; the cloud's GSD, rounded up, if not given."),
]
Fill = Annotated[
    float | None,
    typer.Option(help="Fill gaps up to this width, metres, from their lower side."),
]
Tiles = Annotated[
    str | None,
    typer.Option(help="Also a file for each tile: quadkey:19, or squares of this side: 100."),
]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress, only results and errors.")]


@app.command()
def dsm(
    workspace: WorkspaceFolder,
    resolution: Resolution = None,
    fill: Fill = None,
    tiles: Tiles = None,
    quiet: Quiet = False,
) -> None:
    """The surface model of the cloud, as a Cloud-Optimised GeoTIFF."""
    from sirpy.colmap_dense import open_workspace
    from sirpy.progress import make_progress
    from sirpy.surface_model import surface_model

    path = surface_model(
        open_workspace(workspace),
        resolution=resolution,
        fill=fill,
        tiles=tiles,
        progress=make_progress(quiet),
    )
    print(f"surface model: {path}")


@app.command()
def ortho(
    workspace: WorkspaceFolder,
    resolution: Resolution = None,
    fill: Fill = None,
    tiles: Tiles = None,
    quiet: Quiet = False,
) -> None:
    """The photographs, seen straight from above, as a Cloud-Optimised GeoTIFF."""
    from sirpy.colmap_dense import open_workspace
    from sirpy.orthophoto import orthophoto
    from sirpy.progress import make_progress

    path = orthophoto(
        open_workspace(workspace),
        resolution=resolution,
        fill=fill,
        tiles=tiles,
        progress=make_progress(quiet),
    )
    print(f"orthophoto: {path}")
