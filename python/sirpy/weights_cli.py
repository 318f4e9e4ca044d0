"""The commands `sirpy weights ...`: what there is, to download it, to verify it."""

from __future__ import annotations

from typing import Annotated

import typer

from sirpy.errors import InputError

app = typer.Typer(
    help="Weights of trained networks: what there is, where it is, whether it is whole.",
    no_args_is_help=True,
)

Name = Annotated[str, typer.Argument(help="As `sirpy weights list` has it.", show_default=False)]


@app.command("list")
def list_() -> None:
    """What can be downloaded, under which licence, and where it is."""
    from sirpy.weights import manifest, problem

    for entry in manifest().values():
        print(f"{entry.name}: {entry.what}")
        print(f"  source:  {entry.source}")
        print(f"  licence: {entry.licence}, {entry.copyright}")
        print(f"  size:    {entry.size / 1e6:.1f} MB")
        print(f"  file:    {problem(entry) or entry.path}")


@app.command()
def download(
    name: Name,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress.")] = False,
) -> None:
    """Fetches weights once, and checks what came; what is there and whole is kept."""
    from sirpy.progress import make_progress
    from sirpy.weights import download as run

    print(f"weights: {run(name, make_progress(quiet))}")


@app.command()
def verify(
    name: Annotated[
        str | None, typer.Argument(help="All if not given.", show_default=False)
    ] = None,
) -> None:
    """Size and sha256 of the downloaded files; exit status 2 when one is missing or damaged."""
    from sirpy.weights import manifest, weights_file

    wrong = []
    for each in [name] if name is not None else manifest():
        try:
            print(f"{each}: ok, {weights_file(each)}")
        except InputError as error:
            wrong.append(str(error))
    if wrong:
        raise InputError("; ".join(wrong))
