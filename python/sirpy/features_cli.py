"""The command `sirpy features`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, cast

import typer

from sirpy.left_out import report_left_out
from sirpy.sfm_cli import CameraModel, CameraPer


def register(app: typer.Typer) -> None:
    app.command()(features)


def features(
    images: Annotated[Path, typer.Argument(help="Folder of photographs.", show_default=False)],
    database: Annotated[Path, typer.Option(help="COLMAP database that is made, or continued.")],
    max_features: Annotated[
        int, typer.Option(help="Of a photograph; spread evenly, the largest of each cell.")
    ] = 20_000,
    first_octave: Annotated[
        int, typer.Option(help="0; or -1 for features of half the scale, in 4 times the time.")
    ] = 0,
    camera_model: CameraModel = "SIMPLE_RADIAL",
    camera_per: CameraPer = "auto",
    memory: Annotated[
        str, typer.Option(help="What the whole process tree may take: 8GB, 500MB.")
    ] = "1GB",
    tile: Annotated[
        int | None,
        typer.Option(
            help="Side of a sub-image with its overlap, pixels; by --memory if not given."
        ),
    ] = None,
    threads: Annotated[int, typer.Option(help="0: one for each core.")] = 0,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="No progress, only results and errors.")
    ] = False,
) -> None:
    """SIFT features at native resolution in a COLMAP database, for any matcher and mapper."""
    from sirpy.features import features as run
    from sirpy.memory import parse_memory
    from sirpy.progress import make_progress

    result = run(
        images,
        database,
        max_features=max_features,
        first_octave=first_octave,
        camera_model=camera_model,
        camera_per=cast(Any, camera_per),  # checked there
        memory=parse_memory(memory),
        tile=tile,
        threads=threads,
        progress=make_progress(quiet),
    )
    print(f"database: {result.database}")
    report_left_out(result.left_out)
