"""How well a model fits ground control: the residuals of `sirpy georeference` on a block with surveyed points.

    python benchmarks/ground_control.py FOLDER

FOLDER is a block of the DBAT toolbox (https://github.com/niclasborlin/dbat, data/prague2016/sxb): images/, their
COLMAP model in sparse_gt/, and in source/ the control points (ctrlpts-weighted.txt) and their marks as PhotoModeler
exports them (w-op0-with-orient-2dpts.txt; its photographs count from 1 in the order of the images' names).

The model is first turned, scaled and moved at random, so that nothing of its frame is left. Then all control points
align it; and once more for each of them without it, so that it checks. One JSON object; lengths in centimetres.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from sirpy.alignment import Alignment
from sirpy.cutting import cut
from sirpy.georeference import georeference
from sirpy.layout import Region
from sirpy.model_files import read_model
from sirpy.photographs import find_photographs
from sirpy.rectangle import Grid, Rectangle


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--seed", type=int, default=0, help="of the random similarity")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="sirpy-") as scratch:
        print(json.dumps(measure(arguments.folder, Path(scratch), arguments.seed), indent=1))


def measure(folder: Path, scratch: Path, seed: int) -> dict[str, Any]:
    source = folder / "source"
    points = scratch / "points.csv"
    write_points(source / "ctrlpts-weighted.txt", points)
    names = find_photographs(folder / "images")
    marks = scratch / "marks.csv"
    write_marks(source / "w-op0-with-orient-2dpts.txt", names, marks)

    model = read_model(folder / "sparse_gt")
    random = np.random.default_rng(seed)
    turn = pycolmap.Rotation3d(random.normal(size=4))
    turn.normalize()
    model.transform(pycolmap.Sim3d(random.uniform(0.01, 100), turn, random.normal(size=3) * 1000))
    lost = scratch / "lost"
    lost.mkdir()
    model.write(lost)
    # Only the cameras are of interest: a corner of each photograph is enough.
    workspace = cut(
        folder / "images",
        model,
        scratch / "workspace",
        identity="lost",
        grid=Grid(1, 1),
        region=Region(Rectangle(0, 0, 64, 64)),
    )

    def aligned(*check: str) -> Alignment:
        return georeference(workspace, control_points=points, marks=marks, model=lost, check=check)

    together = aligned()
    usable = [one.name for one in together.residuals]  # those with two marks
    alone = [one for name in usable for one in aligned(name).residuals if one.role == "check"]
    apart = np.array([[one.dx, one.dy, one.dz] for one in alone])
    return {
        "control_points": len(together.residuals),
        "outliers": together.outliers,
        "marks_left_out": [mark.point for mark in together.marks_left_out],
        "residuals_cm": {
            one.name: [round(100 * value, 1) for value in (one.dx, one.dy, one.dz)]
            for one in together.residuals
        },
        "rms_cm": {axis: round(100 * together.rms()[axis], 1) for axis in "xyz"},
        "rms_pixels": round(together.rms()["pixels"], 2),
        "rms_cm_left_out": dict(
            zip("xyz", (100 * np.sqrt((apart**2).mean(axis=0))).round(1).tolist(), strict=True)
        ),
    }


def write_points(source: Path, target: Path) -> None:
    """Writes a table of control points."""
    rows = [line.split(",") for line in source.read_text().splitlines() if line[:1].isdigit()]
    lines = [",".join([row[0], *(field.strip() for field in row[2:])]) for row in rows]
    target.write_text("\n".join(["id,x,y,z,sigma_x,sigma_y,sigma_z", *lines]) + "\n")


def write_marks(source: Path, names: list[str], target: Path) -> None:
    """Writes a table of marks."""
    rows = [line.split(",") for line in source.read_text().splitlines() if line[:1].isdigit()]
    lines = [f"{names[int(row[1]) - 1]},{row[0]},{row[2]},{row[3]}" for row in rows]
    target.write_text("\n".join(["image,id,x,y", *lines]) + "\n")


if __name__ == "__main__":
    main()
