"""How good cameras are, beside exact ones.

    python benchmarks/cameras.py judge MODEL TRUTH [--points N]
    python benchmarks/cameras.py run IMAGES TRUTH OUT [--max_image_size 480] [--camera_per lens]
        [--camera_model OPENCV] [--steps decimated refined native_sift]

MODEL and TRUTH are COLMAP models of native photographs with the same names; TRUTH has exact cameras and points.
`judge` prints one JSON line (`camera_errors.judge` says what is in it). `run` makes models by `sirpy sfm` without
and with its native refinement and by COLMAP's SIFT at native size (native_sift.py), each as a process of its own,
and prints for each a line with its costs as well, then a table.

`--camera_per lens` has one camera for the photographs that share one in TRUTH: they are linked into a folder for
each, OUT/images/CAMERA/NAME, and judged under these names.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from camera_errors import judge
from metered import Cost, measured, run_sirpy
from reconstruction import check_new
from sirpy.files import place
from sirpy.model_arrays import SparseModel, read_arrays
from tables import print_table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    judging = commands.add_parser("judge")
    judging.add_argument("model", type=Path)
    running = commands.add_parser("run")
    running.add_argument("images", type=Path)
    for command in (judging, running):
        command.add_argument("truth", type=Path)
        command.add_argument("--points", type=int, default=20000, help="at most so many true ones")
    running.add_argument("output", type=Path)
    running.add_argument("--max_image_size", type=int, default=2304, help="of the decimated step")
    running.add_argument("--camera_model", default="OPENCV")
    running.add_argument(
        "--camera_per", choices=["auto", "image", "folder", "single", "lens"], default="lens"
    )
    running.add_argument("--steps", nargs="+", choices=_STEPS, default=list(_STEPS))
    arguments = parser.parse_args()
    truth = read_arrays(arguments.truth)
    if arguments.command == "judge":
        print(json.dumps(judge(read_arrays(arguments.model), truth, arguments.points)))
    else:
        check_new(arguments.output)
        run(arguments, truth)


def run(arguments: argparse.Namespace, truth: SparseModel) -> None:
    """Makes, judges and prints the model of each step."""
    images, camera_per = arguments.images, arguments.camera_per
    if camera_per == "lens":
        truth = linked_by_lens(images, truth, arguments.output / "images")
        images, camera_per = arguments.output / "images", "folder"
    lenses = ["--camera_model", arguments.camera_model, "--camera_per", camera_per]
    rows = []
    for step in arguments.steps:
        folder = arguments.output / step
        cost = _STEPS[step](images, folder, arguments.max_image_size, lenses)
        found = {"step": step, **cost, **judge(read_arrays(folder), truth, arguments.points)}
        print(json.dumps(found), flush=True)
        rows.append(_row(found))
    print_table(rows)


def linked_by_lens(images: Path, truth: SparseModel, output: Path) -> SparseModel:
    """Gives the photographs of `truth` a second name `output`/CAMERA/NAME, and `truth` with these names."""
    renamed = []
    for image in truth.images:
        name = f"{image.camera_id}/{image.name.replace('/', '-')}"
        (output / name).parent.mkdir(parents=True, exist_ok=True)
        place(images / image.name, output / name, "hard-link")
        renamed.append(replace(image, name=name))
    return replace(truth, images=tuple(renamed))


def _decimated(images: Path, folder: Path, longest: int, lenses: list[str]) -> Cost:
    size = ["--max_image_size", longest]
    return run_sirpy("sfm", images, "--output", folder, "--no-native", *size, *lenses)


def _refined(images: Path, folder: Path, longest: int, lenses: list[str]) -> Cost:
    return run_sirpy("sfm", images, "--output", folder, "--max_image_size", longest, *lenses)


def _native_sift(images: Path, folder: Path, _: int, lenses: list[str]) -> Cost:
    script = Path(__file__).with_name("native_sift.py")
    cost = measured(sys.executable, script, images, folder, *lenses)
    if cost["status"] != 0:
        sys.exit(f"{script.name} ended with status {cost['status']}")
    return cost


_STEPS: dict[str, Callable[[Path, Path, int, list[str]], Cost]] = {
    "decimated": _decimated,
    "refined": _refined,
    "native_sift": _native_sift,
}


def _row(found: dict[str, Any]) -> dict[str, object]:
    centres, points = found["by_centres"], found["by_points"]
    return {
        "step": found["step"],
        "photographs": found["photographs"],
        "centres, GSD": centres["centres_gsd"]["rms"],
        "angles, degrees": centres["rotations_deg"]["rms"],
        "reprojection by centres, px": centres["reprojection_px"]["rms"],
        "by points, px": points["reprojection_px"]["rms"],
        "true points, GSD": found["points_gsd"]["rms"],
        "consistency, px": found["consistency_px"]["rms"],
        "CPU s": found["cpu_s"],
        "wall s": found["wall_s"],
        "peak GB": found["peak_gb"],
    }


if __name__ == "__main__":
    main()
