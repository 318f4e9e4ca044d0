"""The command `sirpy sfm`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, cast

import typer

CameraModel = Annotated[
    str, typer.Option(help="COLMAP's name: OPENCV, SIMPLE_RADIAL, OPENCV_FISHEYE ...")
]
CameraPer = Annotated[
    str,
    typer.Option(help="What shares a camera: auto (a lens by EXIF), image, folder, single."),
]
NoNative = Annotated[
    bool, typer.Option("--no-native", help="Leave the cameras as decimated photographs give them.")
]


def register(app: typer.Typer) -> None:
    app.command()(sfm)


def sfm(
    images: Annotated[Path, typer.Argument(help="Folder of photographs.", show_default=False)],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the COLMAP model.")],
    max_image_size: Annotated[
        int, typer.Option(help="Longest side of the decimated photographs, pixels.")
    ] = 2304,
    no_native: NoNative = False,
    camera_model: CameraModel = "OPENCV",
    camera_per: CameraPer = "auto",
    matcher: Annotated[
        str,
        typer.Option(help="auto (by number and GPS), exhaustive, sequential, spatial."),
    ] = "auto",
    mapper: Annotated[str, typer.Option(help="incremental or global.")] = "incremental",
    rig: Annotated[
        Path | None,
        typer.Option(help="Cameras that are exposed together: COLMAP's rig_config.json."),
    ] = None,
    gps: Annotated[
        str,
        typer.Option(help="auto: which pairs are matched; use: also where cameras are; off."),
    ] = "auto",
    memory: Annotated[
        str, typer.Option(help="What the whole process tree may take: 8GB, 500MB.")
    ] = "8GB",
    threads: Annotated[int, typer.Option(help="0: one for each core.")] = 0,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="No progress, only results and errors.")
    ] = False,
) -> None:
    """Cameras of the photographs, good enough for native resolution, as a COLMAP model."""
    from sirpy.left_out import report_left_out
    from sirpy.memory import parse_memory
    from sirpy.progress import make_progress
    from sirpy.sfm import sfm as run
    from sirpy.sfm_options import SfmOptions

    result = run(
        images,
        output,
        # The class checks the words.
        options=SfmOptions(
            max_image_size,
            camera_model,
            cast(Any, camera_per),
            cast(Any, matcher),
            cast(Any, mapper),
            cast(Any, gps),
            rig,
        ),
        native=not no_native,
        memory=parse_memory(memory),
        threads=threads,
        progress=make_progress(quiet),
    )
    print(f"model: {result.model} ({len(result.components[0])} photographs)")
    if result.refinement is not None:
        print(f"refinement: {result.refinement}")
    report_left_out(result.left_out)
