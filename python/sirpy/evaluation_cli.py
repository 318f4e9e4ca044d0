"""The commands `sirpy evaluate split` and `sirpy evaluate score`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    help="Judges a cloud without ground truth, by photographs that were held out of it.",
    no_args_is_help=True,
)

Model = Annotated[
    Path,
    typer.Argument(help="COLMAP model of all photographs, in native pixels.", show_default=False),
]
HoldOut = Annotated[
    list[str] | None,
    typer.Option(help="Name of a photograph, as the model has it; may be given more than once."),
]


@app.command()
def split(
    model: Model,
    output: Annotated[
        Path, typer.Argument(help="Folder for the model without them.", show_default=False)
    ],
    hold_out: HoldOut = None,
    every: Annotated[
        int, typer.Option(help="Every n-th photograph by name, if none is named.")
    ] = 8,
) -> None:
    """Writes a model without some photographs: reconstruct with it, then `score`."""
    from sirpy.held_out import hold_out as run

    names = run(model, output, names=hold_out or [], every=every)
    print(f"model: {output}")
    print(f"held out: {', '.join(names)}")


@app.command()
def score(
    model: Model,
    images: Annotated[Path, typer.Argument(help="Folder of photographs.", show_default=False)],
    cloud: Annotated[
        Path,
        typer.Argument(help="Workspace, or a PLY or LAZ file with colours.", show_default=False),
    ],
    hold_out: HoldOut = None,
    radius: Annotated[
        float, typer.Option(help="Half the side of a point's square, pixels of the photograph.")
    ] = 1.0,
    shrink: Annotated[
        int, typer.Option(help="Cloud and photograph are compared shrunk so many times.")
    ] = 2,
    min_views: Annotated[
        int, typer.Option(help="Photographs of the cloud that must see a pixel that counts.")
    ] = 2,
    within: Annotated[
        Path | None,
        typer.Option(help="Workspace whose sub-images count; the cloud's own if not given."),
    ] = None,
    masks: Annotated[
        Path | None, typer.Option(help="Folder of masks NAME.png, black where not to be compared.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(help="Folder for pictures: photograph, cloud and NCC side by side."),
    ] = None,
    json: Annotated[Path | None, typer.Option(help="File for the scores.")] = None,
    memory: Annotated[
        str, typer.Option(help="What it may take, beside the sparse model: 8GB, 500MB.")
    ] = "8GB",
    quiet: Annotated[
        bool, typer.Option("--quiet", help="No progress, only results and errors.")
    ] = False,
) -> None:
    """Compares a cloud, as photographs that were held out would see it, with these: 9x9 NCC.

    covered: of the pixels that enough other photographs see, the share that holds a point.

    right: of those with texture, the share whose NCC is at least .5, .7, .9; a hole is wrong.

    Without --hold-out: all photographs of the model that the cloud's workspace did not use.
    """
    from sirpy.colmap_dense import open_workspace
    from sirpy.evaluation import evaluate
    from sirpy.files import write_json
    from sirpy.left_out import report_left_out
    from sirpy.memory import parse_memory
    from sirpy.progress import make_progress
    from sirpy.rephotograph_score import RephotographOptions

    made = evaluate(
        model,
        images,
        cloud,
        hold_out=hold_out or [],
        within=open_workspace(within) if within is not None else None,
        options=RephotographOptions(radius, shrink, min_views),
        masks=masks,
        picture=picture,
        memory=parse_memory(memory),
        progress=make_progress(quiet),
    )
    print(made)
    if json is not None:
        write_json(json, made.as_json())
    report_left_out(made.left_out)
