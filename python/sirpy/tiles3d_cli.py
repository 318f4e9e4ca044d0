"""The command `sirpy tiles3d`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    app.command()(tiles3d)


def tiles3d(
    workspace: Annotated[Path, typer.Argument(help="Folder of the workspace.", show_default=False)],
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress.")] = False,
) -> None:
    """3D Tiles of the cloud for a browser: OUT/tiles3d/tileset.json. Needs py3dtiles, sirpy's extra tiles3d."""
    from sirpy.colmap_dense import open_workspace
    from sirpy.progress import make_progress
    from sirpy.tiles3d import tiles3d as run

    print(f"3D Tiles: {run(open_workspace(workspace), progress=make_progress(quiet))}")
