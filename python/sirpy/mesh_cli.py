"""The command `sirpy mesh`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sirpy.errors import InputError


def register(app: typer.Typer) -> None:
    app.command()(mesh)


def mesh(
    workspace: Annotated[Path, typer.Argument(help="Folder of the workspace.", show_default=False)],
    tiles: Annotated[
        str | None,
        typer.Option(help="A length, 50, or quadkey:19; squares that fit --memory if not given."),
    ] = None,
    resolution: Annotated[
        float | None,
        typer.Option(help="Size of the finest cells, unit of the cloud; 1.5 GSD if not given."),
    ] = None,
    keep: Annotated[
        float, typer.Option(help="Share of the triangles that simplification leaves; 1: all.")
    ] = 0.5,
    reach: Annotated[
        float, typer.Option(help="Cells from the nearest point that the surface may go.")
    ] = 6.0,
    collar: Annotated[
        float, typer.Option(help="Cells around a tile whose points shape its surface too.")
    ] = 24.0,
    per_tile: Annotated[
        bool, typer.Option("--per-tile", help="Also each tile in tiles/NAME.mesh.ply and .glb.")
    ] = False,
    memory: Annotated[
        str, typer.Option(help="What the whole process tree may take: 8GB, 500MB.")
    ] = "8GB",
    threads: Annotated[int, typer.Option(help="0: one for each core.")] = 0,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="No progress, only results and errors.")
    ] = False,
) -> None:
    """A surface with colours of the fused points: mesh.ply and mesh.glb."""
    from sirpy.colmap_dense import open_workspace
    from sirpy.memory import parse_memory
    from sirpy.mesh import MeshOptions
    from sirpy.mesh import mesh as run
    from sirpy.progress import make_progress

    result = run(
        open_workspace(workspace),
        tiles=tiles,
        options=MeshOptions(resolution, keep, reach, collar, per_tile),
        memory=parse_memory(memory),
        threads=threads,
        progress=make_progress(quiet),
    )
    print(f"mesh: {result.path} ({result.triangles} triangles)")
    for path in result.glb:
        print(f"mesh: {path}")
    if result.failed:
        reasons = "; ".join(f"{tile.name}: {tile.reason}" for tile in result.failed[:3])
        more = f"; and {len(result.failed) - 3} more" if len(result.failed) > 3 else ""
        raise InputError(
            f"the mesh is made without {len(result.failed)} of its tiles ({reasons}{more}): "
            "mend that, then run the same command again"
        )
