"""What a reconstruction costs and, with ground truth, how good it is: one JSON line for each grid.

    python benchmarks/reconstruction.py IMAGES OUTPUT [--model SPARSE] [--memory 4GB]
        [--grids 1x1 3x3] [--judge "COMMAND {cloud}"]

`sirpy reconstruct` runs as a process of its own; wall time, CPU time and peak memory are those of its whole
process tree. The judge is any command whose last line is JSON about a cloud.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

from metered import run_sirpy
from sirpy.workspace import Workspace

_NOT_DENSE = {"sparse", "cut"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("images", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--memory", default="8GB")
    parser.add_argument("--grids", nargs="*", default=[""], help="1x1 3x3; chosen if not given")
    parser.add_argument("--judge", default="", help='command with "{cloud}", prints JSON')
    arguments = parser.parse_args()
    for grid in arguments.grids:
        output = arguments.output / (grid or "chosen")
        found = measured(
            arguments.images, output, arguments.model, arguments.memory, grid, arguments.judge
        )
        print(json.dumps(found), flush=True)


def measured(
    images: Path, output: Path, model: Path | None, memory: str, grid: str, judge: str
) -> dict[str, Any]:
    """Reconstructs into `output`, which must not be there yet: what is reused costs nothing.

    Args:
        grid: 3x3; chosen for `memory` if empty.
        judge: command with {cloud} whose last line is JSON; not judged if empty.
    """
    check_new(output)
    words = ["reconstruct", images, "--output", output, "--memory", memory]
    if model:
        words += ["--model", model]
    cost = run_sirpy(*words, *grid_words(grid))
    workspace = Workspace(output)
    if not workspace.run.exists():
        sys.exit(f"sirpy reconstruct made nothing of {images}")
    run = json.loads(workspace.run.read_text(encoding="utf-8"))
    megapixels = sum(sub.core.area for _, sub in workspace.sub_images()) / 1e6
    dense = sum(stage["cpu_s"] for stage in run["stages"] if stage["name"] not in _NOT_DENSE)
    return {
        "grid": run["grid"],
        "memory": memory,
        "points": run["points"],
        **cost,
        "megapixels": round(megapixels, 2),
        "dense_cpu_s": round(dense, 1),
        "dense_cpu_s_per_mp": round(dense / megapixels, 2),
        "stages": {stage["name"]: _stage(stage) for stage in run["stages"]},
        "quality": _judged(judge, workspace.fused),
    }


def grid_words(grid: str) -> list[str]:
    """Options of `sirpy` for a grid such as 3x2, columns first."""
    if not grid:
        return []
    columns, rows = grid.split("x")
    return ["--columns", columns, "--rows", rows]


def check_new(folder: Path) -> None:
    """Ends the program if there is something under that name."""
    if folder.exists():
        sys.exit(f"{folder} is there already: choose another folder, or remove it")


def _stage(stage: dict[str, Any]) -> dict[str, Any]:
    measured, predicted = stage["measured_peak"], stage["predicted_peak"]
    return {
        "cpu_s": round(stage["cpu_s"], 1),
        "wall_s": round(stage["wall_s"], 1),
        "peak_gb": round((measured or 0) / 1e9, 3),
        "predicted_gb": round((predicted or 0) / 1e9, 3),
        "predicted_to_measured": round(predicted / measured, 3) if predicted and measured else None,
    }


def _judged(command: str, cloud: Path) -> Any:
    if not command:
        return None
    words = [word.replace("{cloud}", str(cloud)) for word in shlex.split(command)]
    judge = subprocess.run(words, check=False, stdout=subprocess.PIPE, text=True)
    if judge.returncode != 0:
        # The reconstruction may have taken hours: its costs are still printed.
        print(f"the judge ended with status {judge.returncode}: {words}", file=sys.stderr)
        return None
    return json.loads(judge.stdout.strip().splitlines()[-1])


if __name__ == "__main__":
    main()
