"""Native recapture beside decimation on photographs without ground truth, judged by some that are held out.

    python benchmarks/rephotography.py IMAGES MODEL OUT [--hold-out NAME ...] [--every 8]
        [--decimations 1 2 4] [--radius 1] [--memory 4GB] [--columns C --rows R]
        [--area FILE] [--roi X0,Y0,WIDTH,HEIGHT] [--picture]

Reconstructs from the photographs that are left as they are and shrunk 2 and 4 times by means of areas, with scaled
cameras, and scores each cloud in the photographs that were held out, at their native size. Points are drawn with
a radius as many times larger as they lie farther apart. All clouds are asked for the same pixels: what the
sub-images of the first reconstruction see. Prints a JSON line for each, then a Markdown table.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from metered import run_sirpy
from reconstruction import check_new
from sirpy.errors import SirpyError
from sirpy.evaluation import evaluate
from sirpy.held_out import EVERY, hold_out
from sirpy.memory import parse_memory
from sirpy.model_arrays import SparseModel, read_arrays, write_model
from sirpy.photographs import Encoding, open_photograph, recapture_to_files
from sirpy.progress import make_progress
from sirpy.rectangle import Rectangle
from sirpy.rephotograph_score import RephotographOptions
from sirpy.workspace import Workspace
from stereo_decimation import rescaled
from tables import print_table

_QUALITY = 98  # of the decimated JPEG files
_PASSED_ON = ("columns", "rows", "area", "model_crs")


def main() -> None:
    arguments = _parser().parse_args()
    check_new(arguments.output)
    try:
        print_table(_row(found) for found in list(compare(arguments)))
    except SirpyError as error:
        sys.exit(f"rephotography.py: {error}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for folder in ("images", "model", "output"):
        parser.add_argument(folder, type=Path)
    parser.add_argument("--hold-out", nargs="+", default=[], help="names, as the model has them")
    parser.add_argument("--every", type=int, default=EVERY, help="if none is named")
    parser.add_argument("--decimations", nargs="+", type=int, default=[1, 2, 4])
    parser.add_argument("--radius", type=float, default=1.0, help="of points of native photographs")
    parser.add_argument("--memory", default="4GB")
    parser.add_argument("--columns")
    parser.add_argument("--rows")
    parser.add_argument("--area")
    parser.add_argument("--model_crs")
    parser.add_argument("--roi", help="in pixels of the native photographs")
    parser.add_argument("--picture", action="store_true", help="in OUT/pictures_DECIMATION")
    return parser


def compare(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Reconstructs, scores and prints one decimation after the other."""
    output = arguments.output
    names = hold_out(
        arguments.model, output / "kept", names=arguments.hold_out, every=arguments.every
    )
    first = _workspace(output, arguments.decimations[0])
    for factor in arguments.decimations:
        images, model = arguments.images, output / "kept"
        if factor > 1:
            images, model = output / f"photographs_{factor}", output / f"kept_{factor}"
            decimate(arguments.images, read_arrays(output / "kept"), factor, images, model)
        workspace = _workspace(output, factor)
        words = ["--output", workspace.folder, "--model", model, "--memory", arguments.memory]
        cost = run_sirpy("reconstruct", images, *words, *_options(arguments, factor), "--quiet")
        scores = evaluate(
            arguments.model,
            arguments.images,
            workspace.folder,
            hold_out=names,
            within=first,
            options=RephotographOptions(radius=factor * arguments.radius),
            picture=output / f"pictures_{factor}" if arguments.picture else None,
            memory=parse_memory(arguments.memory),
            progress=make_progress(quiet=False),
        )
        points = json.loads(workspace.run.read_text(encoding="utf-8"))["points"]
        found = {"decimation": factor, "points": points, **cost, **scores.as_json()}
        print(json.dumps(found), flush=True)
        yield found


def decimate(images: Path, model: SparseModel, factor: int, output: Path, sparse: Path) -> None:
    """Writes the photographs of a model shrunk by a factor, by means of areas, and their model to `sparse`."""
    scaled = rescaled(model, lambda camera: 1 / factor)
    write_model(scaled, sparse)
    for image in scaled.images:
        size = scaled.camera_of(image).width, scaled.camera_of(image).height
        target = output / image.name
        target.parent.mkdir(parents=True, exist_ok=True)
        recapture_to_files(
            open_photograph(images / image.name),
            None,
            size,
            [(target, Rectangle(0, 0, *size))],
            encoding=Encoding(_QUALITY),
        )


def _workspace(output: Path, factor: int) -> Workspace:
    return Workspace(output / f"decimated_{factor}" if factor > 1 else output / "native")


def _options(arguments: argparse.Namespace, factor: int) -> list[str]:
    """What is passed on to `sirpy reconstruct`."""
    options = []
    for name in _PASSED_ON:
        if (value := getattr(arguments, name)) is not None:
            options += [f"--{name}", value]
    if arguments.roi is not None:
        x0, y0, width, height = map(int, arguments.roi.split(","))
        low = x0 // factor, y0 // factor
        high = math.ceil((x0 + width) / factor), math.ceil((y0 + height) / factor)
        options += ["--roi", f"{low[0]},{low[1]},{high[0] - low[0]},{high[1] - low[1]}"]
    return options


def _row(found: dict[str, Any]) -> dict[str, object]:
    scores = ("covered", "right_0.5", "right_0.7", "right_0.9", "pixels")
    return {
        **{key: found[key] for key in ("decimation", "points", "radius")},
        **{key: found["all"][key] for key in scores},
        **{key: found[key] for key in ("wall_s", "cpu_s", "peak_gb")},
    }


if __name__ == "__main__":
    main()
