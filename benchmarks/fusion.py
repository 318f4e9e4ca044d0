"""Fusion: beside COLMAP's on the same maps, and of surveys that grow.

    python benchmarks/fusion.py compare DENSE [--scene SCENE]
        DENSE: a dense workspace of COLMAP with depth and normal maps, of which copies are made; SCENE: where `sirpy`
        rendered its photographs, to judge the clouds
    python benchmarks/fusion.py dense WORKSPACE DENSE
        makes a dense workspace of COLMAP of one of ours: its sub-images with all maps
    python benchmarks/fusion.py survey FOLDER [--photographs 56 111 223]
        towns photographed from the air, 3x3 sub-images of each photograph, true depths by ray casting

One JSON line for each measurement: CPU and wall seconds, peak memory of all processes.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from metered import __file__ as metered
from metered import run_sirpy
from sirpy.cutting import cut
from sirpy.judging import normals
from sirpy.native_scene import read_native_scene
from sirpy.ply import read_vertices
from sirpy.rectangle import Grid
from sirpy.synthetic import evaluate, read_truth, render_scene
from sirpy.view_selection import views
from sirpy.windows import open_map, write_map
from sirpy.workspace import Workspace

_COLMAP = """
import sys, pycolmap
pycolmap.stereo_fusion(sys.argv[2], sys.argv[1], input_type="geometric", output_type="PLY")
"""


def compare(dense: Path, scene: Path | None) -> None:
    """Both in one run, one after the other, twice."""
    for attempt in range(2):
        for name in ("pycolmap", "sirpy"):
            copy = dense.with_name(f"{dense.name}.{name}")
            shutil.rmtree(copy, ignore_errors=True)
            copy.mkdir()
            for part in ("images", "sparse", "stereo"):
                (copy / part).symlink_to((dense / part).resolve())
            cloud = copy / "fused.ply"
            if name == "sirpy":
                cost = run_sirpy("fuse", copy, "--quiet")
            else:
                command = [sys.executable, "-c", _COLMAP, copy, cloud]
                printed = subprocess.run(
                    [sys.executable, metered, *map(str, command)],
                    check=True,
                    stdout=subprocess.PIPE,
                    text=True,
                ).stdout
                cost = json.loads(printed)
            found = {"fusion": name, **cost, "points": len(read_vertices(cloud))}
            if scene and attempt == 0:
                judged = evaluate(scene, cloud)
                found["f1"] = [round(one, 4) for one in judged.f1]
            print(json.dumps(found), flush=True)


def make_dense(workspace: Workspace, dense: Path) -> None:
    """Images, cameras and maps of the sub-images, with normals of the depths where there are none."""
    shutil.copytree(workspace.images, dense / "images")
    shutil.copytree(workspace.sparse, dense / "sparse")
    made = Workspace(dense)
    scene = read_native_scene(workspace)
    names = []
    for native, sub in workspace.sub_images():
        depth = np.array(open_map(workspace.depth_map(sub, "geometric"), sub.stored)[0])
        if workspace.normal_map(sub, "geometric").exists():
            normal = np.array(
                open_map(workspace.normal_map(sub, "geometric"), sub.stored, channels=3)
            )
        else:
            normal = normals(depth, scene.cameras[native.name].intrinsics, sub.stored)
        write_map(made.depth_map(sub, "geometric"), depth)
        write_map(made.normal_map(sub, "geometric"), normal)
        names.append(sub.name)
    lists = {
        made.fusion_config: names,
        made.patch_match_config: [line for name in names for line in (name, "__auto__, 20")],
    }
    for path, lines in lists.items():
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def survey(folder: Path, photographs: int) -> None:
    """One survey of so many photographs of 960x640."""
    scene, workspace = folder / "scene", Workspace(folder / "out")
    if not workspace.views.exists():
        render_scene(scene, image_count=photographs, camera_model="PINHOLE")
        cut(scene / "images", scene / "sparse", workspace.folder, grid=Grid(3, 3))
        views(workspace)
        _write_true_maps(scene, workspace)
    shutil.rmtree(workspace.folder / "fusion", ignore_errors=True)
    cost = run_sirpy("fuse", workspace.folder, "--quiet")
    judged = evaluate(scene, workspace.fused)
    count = sum(1 for _ in workspace.sub_images())
    found = {
        "sub_images": count,
        **cost,
        "cpu_ms_per_sub_image": round(1000 * cost["cpu_s"] / count, 1),
        "points": len(read_vertices(workspace.fused)),
        "f1": [round(one, 4) for one in judged.f1],
    }
    print(json.dumps(found), flush=True)


def _write_true_maps(scene: Path, workspace: Workspace) -> None:
    import pycolmap

    truth = read_truth(scene)
    model = pycolmap.Reconstruction(str(workspace.sparse))
    for image in model.images.values():
        depth = truth.depth_map(model.cameras[image.camera_id], image.cam_from_world())
        write_map(workspace.stereo / "depth_maps" / f"{image.name}.geometric.bin", depth)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("compare")
    one.add_argument("dense", type=Path)
    one.add_argument("--scene", type=Path)
    one = commands.add_parser("dense")
    one.add_argument("workspace", type=Path)
    one.add_argument("dense", type=Path)
    one = commands.add_parser("survey")
    one.add_argument("folder", type=Path)
    one.add_argument("--photographs", type=int, nargs="+", default=[56, 111, 223])
    arguments = parser.parse_args()
    if arguments.command == "compare":
        compare(arguments.dense, arguments.scene)
    elif arguments.command == "dense":
        make_dense(Workspace(arguments.workspace), arguments.dense)
    else:
        for photographs in arguments.photographs:
            survey(arguments.folder / str(photographs), photographs)


if __name__ == "__main__":
    main()
