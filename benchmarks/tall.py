"""Towers and a wood two thirds as tall as the flight is high, with sparse points on them and with none.

    python benchmarks/tall.py render SCENE
    python benchmarks/tall.py run OUT [--memory 4GB] [--threads 0]

SCENE has images/, their exact model in sparse/, the same without its points above the ground in sparse_ground/, true
depth maps in depth/, the places of the surface that at least three photographs see in places.npz, and truth.npz.
`run` renders it into OUT/scene, reconstructs it with each model into OUT/MODEL, and prints a JSON line for each, then
a table. Completeness is the share of the places that have a point of the cloud within 1, 2, 5 GSD: of those on tall
things and of the rest. Depth maps are judged where they show tall things: the share of pixels with a depth, and with
one right within two pixels' worth.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import sirpy
from numpy.typing import NDArray
from reconstruction import check_new
from sirpy import _core
from sirpy.flight import GSD, flying_height
from sirpy.memory import parse_memory
from sirpy.native_scene import read_native_scene
from sirpy.ply import read_vertices
from sirpy.synthetic import read_truth, render_scene
from sirpy.truth import places_to_find
from sirpy.windows import write_map
from sirpy.workspace import Workspace
from stereo_maps import error_in_gsd, estimated_depth, true_depth
from tables import print_table

Floats = NDArray[np.float64]

SEED = 6
MIDDLE = (20.0, 6.0)  # between the wood and the row of towers that the town of this seed has
TALL = 2 / 3  # of the flying height
TALLEST_ROOF = (
    15.0  # of the town, m above the ground: what is higher is a tower or a tree of the wood
)
LOW = 1.0  # m above the ground: no higher are the points of sparse_ground/
THRESHOLDS = (1, 2, 5)  # GSD
RIGHT = 2  # pixels' worth
MODELS = ("sparse", "sparse_ground")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("render").add_argument("scene", type=Path)
    running = commands.add_parser("run")
    running.add_argument("output", type=Path)
    running.add_argument("--memory", default="4GB")
    running.add_argument("--threads", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.command == "render":
        check_new(arguments.scene)
        render(arguments.scene)
    else:
        run(arguments.output, parse_memory(arguments.memory), arguments.threads)


def render(
    scene: Path,
    *,
    image_count: int = 10,
    size: tuple[int, int] = (1200, 900),
    middle: tuple[float, float] = MIDDLE,
) -> Path:
    """Renders the scene, with both models, true depth maps and places to find; returns the folder."""
    render_scene(
        scene,
        image_count=image_count,
        size=size,
        camera_model="PINHOLE",
        seed=SEED,
        tall=TALL * flying_height(size),
        middle=middle,
    )
    truth, model = read_truth(scene), pycolmap.Reconstruction(str(scene / "sparse"))
    for image in model.images.values():
        name = Path(image.name)
        depth = truth.depth_map(image.camera, image.cam_from_world())
        write_map(scene / "depth" / f"{name.stem}_r00_c00{name.suffix}.geometric.bin", depth)
    places = places_to_find(truth, model)
    np.savez(scene / "places.npz", places=places, tall=heights(places) > TALLEST_ROOF)
    _remove_high_points(model)
    (scene / "sparse_ground").mkdir()
    model.write_binary(str(scene / "sparse_ground"))
    return scene


def heights(points: Floats) -> Floats:
    """Of points (n, 3), above the ground below them, m."""
    above: Floats = points[:, 2] - _core.terrain_heights(SEED, np.ascontiguousarray(points[:, :2]))
    return above


def _remove_high_points(model: Any) -> None:
    ids = np.array(sorted(model.points3D))
    points = np.array([model.point3D(index).xyz for index in ids])
    for index in ids[heights(points) > LOW]:
        model.delete_point3D(index)


def run(output: Path, memory: int, threads: int) -> None:
    """Reconstructs with both models; prints what each found, and the difference."""
    for model in MODELS:
        check_new(output / model)
    scene = output / "scene"
    if not (scene / "sparse_ground").exists():
        render(scene)
    rows = []
    for model in MODELS:
        made = sirpy.reconstruct(
            scene / "images", output / model, model=scene / model, memory=memory, threads=threads
        )
        found = {**completeness(scene, made.workspace), **density(scene, made.workspace)}
        rows.append({"model": model, "points": made.points, **found})
        print(json.dumps(rows[-1]), flush=True)
    lost = {key: rows[1][key] - rows[0][key] for key in rows[0] if key != "model"}
    print_table([*rows, {"model": "difference", **lost}])


def completeness(scene: Path, workspace: Workspace) -> dict[str, float]:
    """Shares of the places to find, tall and not, near which the cloud has a point."""
    with np.load(scene / "places.npz") as file:
        places, tall = file["places"], file["tall"]
    vertices = read_vertices(workspace.fused)
    points = np.column_stack([vertices[axis].astype(np.float64) for axis in "xyz"])
    distance = _core.nearest_distances(places, points, max(THRESHOLDS) * GSD)
    return {
        f"{part}_{threshold}_gsd": round(float((distance[of_part] <= threshold * GSD).mean()), 4)
        for part, of_part in (("tall", tall), ("rest", ~tall))
        for threshold in THRESHOLDS
    }


def density(scene: Path, workspace: Workspace) -> dict[str, float]:
    """Shares of the pixels that show tall things: with a depth, and with a right one."""
    cameras = read_native_scene(workspace).cameras
    errors = []
    for native in workspace.natives:
        camera, truth = cameras[native.name], true_depth(scene / "depth", native)
        rows, columns = np.nonzero(truth)
        surface = camera.world(np.column_stack([columns, rows]) + 0.5, truth[rows, columns])
        high = heights(surface) > TALLEST_ROOF
        error = error_in_gsd(estimated_depth(workspace, native), truth, camera, None)
        errors.append(error[rows[high], columns[high]])
    error = np.concatenate(errors)
    return {
        "tall_depths": round(float(np.isfinite(error).mean()), 4),
        "tall_right_depths": round(float((error <= RIGHT).mean()), 4),
    }


if __name__ == "__main__":
    main()
