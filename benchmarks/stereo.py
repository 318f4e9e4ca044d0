"""Quality, cost and sameness of the dense stages; each line is JSON, Markdown tables follow.

    python benchmarks/stereo.py quality SCENE OUT [--memory 4GB] [--grids 1x1 3x3] [--judge JUDGE]
    python benchmarks/stereo.py budgets SCENE OUT [--memory 1GB 2GB 4GB] [--judge JUDGE]
    python benchmarks/stereo.py decimation SCENE OUT [--widths 2304 1600 1000] [--memory 1GB] [--judge JUDGE]
    python benchmarks/stereo.py threads SCENE OUT --halo FULL [--grids 1x1 3x3 5x5] [--images N]
    python benchmarks/stereo.py halo SCENE OUT --full FULL [--halos 0 16 32 64 128] [--grid 3x3] [--images N]
        [--truth MAPS]
    python benchmarks/stereo.py seams WORKSPACE --truth MAPS [--band 16] [--uncut WORKSPACE]
    python benchmarks/stereo.py yardstick [13470x8670]

SCENE has images/ and their exact model in sparse/. JUDGE is a command in which {cloud} stands for the cloud to
judge; its last line is JSON with f1_T, acc_T and comp_T for thresholds T in GSD, and by_material. MAPS is a folder of
true depth maps NAME.geometric.bin in COLMAP's format, of the sub-images of the workspace or of its uncut photographs
(NAME_r00_c00). The product runs as a user runs it, in processes of their own. No folder is written into
that is there already.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from reconstruction import measured
from sirpy.errors import SirpyError
from sirpy.memory import parse_memory
from tables import print_table


def main() -> None:
    arguments = _parser().parse_args()
    try:
        arguments.run(arguments)
    except SirpyError as error:
        sys.exit(f"stereo.py: {error}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True)

    def command(run: Any, *folders: str) -> argparse.ArgumentParser:
        added = commands.add_parser(run.__name__.strip("_"), help=run.__doc__)
        added.set_defaults(run=run)
        for folder in folders:
            added.add_argument(folder, type=Path)
        return added

    quality = command(_quality, "scene", "output")
    quality.add_argument("--memory", default="4GB")
    quality.add_argument("--grids", nargs="+", default=[""], help="1x1 3x3; chosen if not given")

    budgets = command(_budgets, "scene", "output")
    budgets.add_argument("--memory", nargs="+", default=["1GB", "2GB", "4GB"])

    decimation = command(_decimation, "scene", "output")
    decimation.add_argument("--memory", default="1GB", help="of native recapture and of the others")
    decimation.add_argument("--widths", nargs="+", type=int, default=[2304, 1600, 1000])
    decimation.add_argument("--grid", default="", help="of native recapture; chosen if not given")
    decimation.add_argument(
        "--decimated_grid", default="", help="of the decimated photographs; chosen if not given"
    )

    threads = command(_threads, "scene", "output")
    threads.add_argument("--halo", required=True, help="the full one, as `sirpy views` takes it")
    threads.add_argument("--grids", nargs="+", default=["1x1", "3x3", "5x5"])

    halo = command(_halo, "scene", "output")
    halo.add_argument("--full", required=True, help="the full halo, as `sirpy views` takes it")
    halo.add_argument("--halos", nargs="+", default=["0", "16", "32", "64", "128"])
    halo.add_argument("--grid", default="3x3")
    halo.add_argument("--truth", type=Path)

    seams = command(_seams, "workspace")
    seams.add_argument("--truth", type=Path, required=True)
    seams.add_argument("--band", type=int, default=16, help="native pixels beside a border")
    seams.add_argument("--uncut", type=Path, help="workspace of a 1x1 grid: the same pixels there")

    yardstick = command(_yardstick)
    yardstick.add_argument("size", nargs="?", default="13470x8670")

    for judged in (quality, budgets, decimation):
        judged.add_argument("--judge", default="", help='command with "{cloud}", prints JSON')
    for compared in (threads, halo):
        compared.add_argument("--images", type=int, help="only so many, which see the same place")
        compared.add_argument("--keep", action="store_true", help="the workspaces compared")
    for in_gsd in (halo, seams):
        in_gsd.add_argument("--gsd", type=float, help="world units; what a pixel spans otherwise")
    return parser


def _quality(arguments: argparse.Namespace) -> None:
    """A reconstruction from exact cameras: quality, cost and predictions, for each grid."""
    rows = [
        _printed(
            measured(
                arguments.scene / "images",
                arguments.output / (grid or "chosen"),
                arguments.scene / "sparse",
                arguments.memory,
                grid,
                arguments.judge,
            )
        )
        for grid in arguments.grids
    ]
    print_table(
        {
            **{key: row[key] for key in ("grid", "points", "wall_s", "cpu_s", "peak_gb")},
            "dense CPU s per MP": row["dense_cpu_s_per_mp"],
            **scores(row),
        }
        for row in rows
    )
    print_table(
        {
            "grid": row["grid"],
            "stage": name,
            **stage,
            "CPU s per MP": stage["cpu_s"] / row["megapixels"],
        }
        for row in rows
        for name, stage in row["stages"].items()
    )
    judged = [row for row in rows if row["quality"] and "by_material" in row["quality"]]
    if judged:
        print_table(
            {
                "completeness of": name,
                **{row["grid"]: row["quality"]["by_material"][name]["comp"] for row in judged},
            }
            for name in judged[0]["quality"]["by_material"]
        )


def _budgets(arguments: argparse.Namespace) -> None:
    """The same scene under several memory budgets: grid, peak of all processes, quality."""
    rows = []
    for memory in arguments.memory:
        row = measured(
            arguments.scene / "images",
            arguments.output / memory,
            arguments.scene / "sparse",
            memory,
            "",
            arguments.judge,
        )
        below = row["peak_gb"] * 1e9 <= parse_memory(memory)
        rows.append(_printed({**row, "below_budget": below}))
    shown = ("memory", "grid", "peak_gb", "below_budget", "points", "cpu_s")
    print_table({**{key: row[key] for key in shown}, **scores(row)} for row in rows)


def _decimation(arguments: argparse.Namespace) -> None:
    """Native recapture beside photographs decimated to fit, for the same memory."""
    from stereo_decimation import compare

    rows = []
    for row in compare(arguments):
        rows.append(_printed(row))
    shown = ("photographs", "width", "grid", "peak_gb", "points", "cpu_s")
    print_table({**{key: row[key] for key in shown}, **scores(row)} for row in rows)


def _threads(arguments: argparse.Namespace) -> None:
    """Another run, one thread, other grids with the full halo: are depth maps and clouds the same?"""
    from stereo_grids import compare_runs

    print_table([_printed(row) for row in compare_runs(arguments)])


def _halo(arguments: argparse.Namespace) -> None:
    """What a halo costs, and what differs from the full one."""
    from stereo_grids import compare_halos

    print_table([_printed(row) for row in compare_halos(arguments)])


def _seams(arguments: argparse.Namespace) -> None:
    """Depth maps beside the borders of sub-images, and elsewhere, against true ones."""
    from stereo_seams import compare_band

    photographs, means = compare_band(arguments)
    for row in photographs:
        _printed(row)
    print_table([_printed(row) for row in means])


def _yardstick(arguments: argparse.Namespace) -> None:
    """CPU time of pycolmap's undistortion of one photograph, to compare machines by."""
    import pycolmap
    import recapture

    width, height = map(int, arguments.size.split("x"))
    with tempfile.TemporaryDirectory(prefix="sirpy-") as folder:
        recapture.make(Path(folder), 1, width, height)
        cost = recapture.measure(recapture.PYCOLMAP, Path(folder))
    row = {"megapixels": round(width * height / 1e6, 1), "pycolmap": pycolmap.__version__, **cost}
    print_table([_printed(row)])


def scores(row: dict[str, Any]) -> dict[str, float]:
    """F1 at each threshold, then accuracy and completeness, as far as the judge said so."""
    quality = row["quality"] or {}
    return {
        f"{title} {key.removeprefix(prefix)} GSD": value
        for prefix, title in (("f1_", "F1"), ("acc_", "accuracy"), ("comp_", "completeness"))
        for key, value in quality.items()
        if key.startswith(prefix)
    }


def _printed(row: dict[str, Any]) -> dict[str, Any]:
    print(json.dumps(row), flush=True)
    return row


if __name__ == "__main__":
    main()
