"""The command `sirpy georeference`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from sirpy.alignment import Alignment

_MOST_ROWS = 40


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command()(georeference)


def georeference(
    workspace: Annotated[Path, typer.Argument(help="Folder of the workspace.", show_default=False)],
    images: Annotated[
        Path | None,
        typer.Option(help="Folder of the photographs: aligns to the GPS in their EXIF."),
    ] = None,
    positions: Annotated[
        Path | None,
        typer.Option(help="Table of camera positions: name, and x,y,z or lon,lat,alt."),
    ] = None,
    positions_crs: Annotated[
        str | None,
        typer.Option(
            help="CRS of the coordinates in a table; if not given WGS84 for lon,lat, else --crs."
        ),
    ] = None,
    gcp: Annotated[
        Path | None,
        typer.Option(help="Table of control points: id, x,y,z or lon,lat,alt, sigma, check."),
    ] = None,
    marks: Annotated[
        Path | None, typer.Option(help="Table of their marks: image, id, x,y in its pixels.")
    ] = None,
    check: Annotated[str, typer.Option(help="Control points that are only compared: 12,17.")] = "",
    model: Annotated[
        Path | None,
        typer.Option(
            help="For --gcp: the COLMAP model of the photographs; OUT/sfm/sparse if not given."
        ),
    ] = None,
    as_is: Annotated[
        bool, typer.Option("--as-is", help="The model lies in --crs already: nothing moves.")
    ] = False,
    crs: Annotated[
        str | None,
        typer.Option(
            help="Projected CRS of the products, as EPSG:25832; if not given the UTM zone."
        ),
    ] = None,
    max_residual: Annotated[
        float | None,
        typer.Option(
            help="Positions or points that are further off are not used; else five sigma."
        ),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="No progress, only results and errors.")
    ] = False,
) -> None:
    """Where on the Earth the model lies, by GPS, camera positions or ground control points."""
    from sirpy.colmap_dense import open_workspace
    from sirpy.georeference import georeference as run
    from sirpy.progress import make_progress

    folder = open_workspace(workspace)
    found = run(
        folder,
        images=images,
        positions=positions,
        positions_crs=positions_crs,
        control_points=gcp,
        marks=marks,
        check=tuple(name.strip() for name in check.split(",") if name.strip()),
        model=model,
        as_is=as_is,
        crs=crs,
        max_residual=max_residual,
        progress=make_progress(quiet),
    )
    print_alignment(found)
    print(f"georeference: {folder.georeference} ({found.frame.crs or 'no CRS'})")


def print_alignment(alignment: Alignment) -> None:
    """Prints the residuals: all of them where they are few, else the largest."""
    from rich.console import Console

    if not alignment.residuals:
        return
    console = Console(highlight=False)
    console.print(_table(alignment))
    used = sum(one.role == "used" for one in alignment.residuals)
    console.print(f"{used} of {len(alignment.residuals)} used, scale {alignment.frame.scale:.6g}")


def _table(alignment: Alignment) -> Table:
    from rich.table import Table

    control = alignment.source == "control_points"
    unit, factor = ("cm", 100.0) if control else ("m", 1.0)
    shown = sorted(alignment.residuals, key=lambda one: -(one.dx**2 + one.dy**2 + one.dz**2))[
        :_MOST_ROWS
    ]
    what = "control point" if control else "photograph"
    most = "" if len(shown) == len(alignment.residuals) else f", the {len(shown)} largest"
    table = Table(title=f"Residuals (model less given{most})", title_justify="left")
    table.add_column(what)
    for name in (f"x ({unit})", f"y ({unit})", f"z ({unit})", *(["pixels"] if control else [])):
        table.add_column(name, justify="right")
    table.add_column("")
    for one in sorted(shown, key=lambda one: one.name):
        lengths = [f"{factor * value:,.1f}" for value in (one.dx, one.dy, one.dz)]
        pixels = [f"{one.pixels:.1f}"] if control and one.pixels is not None else []
        table.add_row(one.name, *lengths, *pixels, "" if one.role == "used" else one.role)
    for title, rms in (("rms", alignment.rms()), ("rms of check points", alignment.rms("check"))):
        if rms:
            table.add_section()
            lengths = [f"{factor * rms[axis]:,.1f}" for axis in "xyz"]
            table.add_row(
                title, *lengths, *([f"{rms['pixels']:.1f}"] if "pixels" in rms else []), ""
            )
    return table
