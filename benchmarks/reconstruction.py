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

from sirpy.resources import Meter


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
        print(json.dumps(_measure(arguments, grid)), flush=True)


def _measure(arguments: argparse.Namespace, grid: str) -> dict[str, Any]:
    output = arguments.output / (grid or "chosen")
    command = [sys.executable, "-m", "sirpy", "reconstruct", str(arguments.images)]
    command += ["--output", str(output), "--memory", arguments.memory]
    if arguments.model:
        command += ["--model", str(arguments.model)]
    if grid:
        columns, rows = grid.split("x")
        command += ["--columns", columns, "--rows", rows]
    with Meter() as meter:
        status = subprocess.run(command, check=False).returncode
    run = json.loads((output / "run.json").read_text(encoding="utf-8"))
    return {
        "grid": run["grid"],
        "status": status,
        "points": run["points"],
        "wall_s": round(meter.wall_s, 1),
        "cpu_s": round(meter.cpu_s, 1),
        "peak_gb": round((meter.peak_bytes or 0) / 1e9, 3),
        "stages": {
            stage["name"]: {
                "cpu_s": round(stage["cpu_s"], 1),
                "peak_gb": round((stage["measured_peak"] or 0) / 1e9, 3),
                "predicted_gb": round((stage["predicted_peak"] or 0) / 1e9, 3),
            }
            for stage in run["stages"]
        },
        "quality": _judge(arguments.judge, output / "fused.ply"),
    }


def _judge(command: str, cloud: Path) -> Any:
    if not command:
        return None
    words = [word.replace("{cloud}", str(cloud)) for word in shlex.split(command)]
    printed = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    return json.loads(printed.strip().splitlines()[-1])


if __name__ == "__main__":
    main()
