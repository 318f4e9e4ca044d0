"""PatchmatchNet on windows: equality with the published code, memory and speed by size, what margins buy.

    python benchmarks/learned.py parity GOLDEN
    python benchmarks/learned.py sizes [--megapixels 1 2 4 8] [--sources 4] [--device cpu] [--whole]
    python benchmarks/learned.py margins WORKSPACE IMAGE [IMAGE ...] [--grid 3x3] [--halos 0 16 32 64 128]

GOLDEN is a folder of case_X_inputs.npz and case_X_outputs.npz: images, cameras, random numbers and depths of the
published code. `sizes` takes made-up photographs; --whole runs all of one at once as the network is published, with
no bands. `margins` needs `sirpy views`. The weights are those of `sirpy weights`. Each line is JSON, tables follow.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from sirpy.dense_stereo import _Estimator
from sirpy.native_scene import NativeCamera
from sirpy.patchmatchnet import PatchmatchNet
from sirpy.patchmatchnet.backend import PatchmatchNetBackend
from sirpy.patchmatchnet.bands import Bands
from sirpy.patchmatchnet.windows import FeatureStore, estimate
from sirpy.progress import Progress
from sirpy.rectangle import Grid, Rectangle
from sirpy.stereo_backend import DepthRange, Setup, StereoOptions, View
from sirpy.stereo_passes import Unit
from sirpy.view_fields import FieldSource, ViewField
from sirpy.view_selection import read_views
from sirpy.weights import weights_file
from sirpy.workspace import Workspace
from tables import print_table


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True)

    def command(run: Any) -> argparse.ArgumentParser:
        added = commands.add_parser(run.__name__.strip("_"))
        added.set_defaults(run=run)
        return added

    command(_parity).add_argument("golden", type=Path)
    for added in (command(_sizes), command(_size)):
        added.add_argument("--megapixels", nargs="+", type=float, default=[1, 2, 4, 8])
        added.add_argument("--sources", type=int, default=4)
        added.add_argument("--device", default="cpu")
        added.add_argument("--float32", action="store_true", help="no half precision on a GPU")
        added.add_argument("--whole", action="store_true")
    margins = command(_margins)
    margins.add_argument("workspace", type=Path)
    margins.add_argument("images", nargs="+")
    margins.add_argument("--grid", default="3x3")
    margins.add_argument("--halos", nargs="+", type=int, default=[0, 16, 32, 64, 128])
    arguments = parser.parse_args()
    arguments.run(arguments)


def _parity(arguments: argparse.Namespace) -> None:
    """Relative differences of depth, stage by stage."""
    net = PatchmatchNet.from_checkpoint(weights_file("patchmatchnet"))
    rows = []
    for inputs in sorted(arguments.golden.glob("case_*_inputs.npz")):
        given = dict(np.load(inputs))
        expected = dict(np.load(str(inputs).replace("_inputs", "_outputs")))
        found = net(
            [torch.from_numpy(image).permute(2, 0, 1) for image in given["images_u8"]],
            torch.from_numpy(given["K"]),
            torch.from_numpy(given["E"]),
            float(given["depth_min"]),
            float(given["depth_max"]),
            initial=torch.from_numpy(given["rand_s3"]),
        )
        depths = {f"s{s}_i{i}": d for s, ds in found.stages.items() for i, d in enumerate(ds, 1)}
        depths |= {"": found.depth}
        for name, depth in depths.items():
            truth = expected[f"depth_{name}" if name else "depth"]
            error = np.abs(depth.numpy() - truth) / truth
            row = {"case": inputs.stem.split("_")[1], "depth": name or "refined"}
            quantiles = np.percentile(error, [50, 99, 99.9, 100])
            row |= dict(
                zip(
                    ("median", "99 %", "99.9 %", "max"),
                    map("{:.1e}".format, quantiles),
                    strict=True,
                )
            )
            rows.append(row)
            print(json.dumps(row), flush=True)
    print_table(rows)


def _sizes(arguments: argparse.Namespace) -> None:
    """Each size in a process of its own."""
    given = ["--sources", str(arguments.sources), "--device", arguments.device]
    given += ["--float32"] * arguments.float32 + ["--whole"] * arguments.whole
    rows = []
    for megapixels in arguments.megapixels:
        command = [sys.executable, __file__, "size", "--megapixels", str(megapixels), *given]
        found = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
        rows.append(json.loads(found))
        print(json.dumps(rows[-1]), flush=True)
    if len(rows) > 1:
        sizes, peaks = ([row[key] for row in rows] for key in ("megapixels", "peak_gb"))
        slope, base = np.polyfit(sizes, peaks, 1)
        at_50 = f"{base + 50 * slope:.1f}"
        print(
            json.dumps(
                {
                    "bytes_per_pixel": round(slope * 1e3),
                    "base_gb": round(base, 2),
                    "gb_at_50": at_50,
                }
            )
        )
    print_table(rows)


def _size(arguments: argparse.Namespace) -> None:
    side = round((arguments.megapixels[0] * 1e6) ** 0.5 / 8) * 8
    whole = Rectangle(0, 0, side, side)
    device = torch.device(arguments.device)
    net = PatchmatchNet.from_checkpoint(weights_file("patchmatchnet"), device)
    bands = Bands(device, most_bytes=1 << 60 if arguments.whole else None)
    views = [_view(whole, index) for index in range(-1, arguments.sources)]
    field = ViewField(
        views[0].name,
        side,
        tuple(FieldSource(view.name, 0) for view in views[1:]),
        np.full((1, 1), (1 << arguments.sources) - 1, np.uint32),
        np.full((1, 1), 8, np.float32),
        np.full((1, 1), 13, np.float32),
    )
    half = not arguments.float32 and device.type != "cpu"
    for _ in range(1 if device.type == "cpu" else 2):  # a GPU's first run chooses kernels
        with tempfile.TemporaryDirectory() as folder:
            cpu, begin = time.process_time(), time.monotonic()
            if arguments.whole:
                _published(net, views, bands)
            else:
                store = FeatureStore(net, Path(folder), bands, half)
                estimate(net, store, views[0], views[1:], DepthRange(field, whole), 1, bands)
            if device.type != "cpu":
                torch.cuda.synchronize()
            cpu, wall = time.process_time() - cpu, time.monotonic() - begin
    on_gpu = torch.cuda.max_memory_allocated() if device.type == "cuda" else 0
    peak = on_gpu or 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    pixels = whole.area / 1e6
    row = {
        "megapixels": round(pixels, 2),
        "sources": arguments.sources,
        "peak_gb": round(peak / 1e9, 3),
        "cpu_s_per_mp": round(cpu / pixels, 2),
        "wall_s_per_mp": round(wall / pixels, 3),
    }
    print(json.dumps(row))


def _published(net: PatchmatchNet, views: list[View], bands: Bands) -> None:
    images = [torch.from_numpy(view.image).permute(2, 0, 1) for view in views]
    intrinsics = torch.from_numpy(np.stack([view.intrinsics for view in views]))
    poses = [np.vstack([view.camera.cam_from_world, [0, 0, 0, 1]]) for view in views]
    net(images, intrinsics, torch.from_numpy(np.stack(poses)), 8, 13, bands=bands)


def _view(whole: Rectangle, index: int) -> View:
    """Of a plane at a depth of 10 with a random texture; source i is some steps to a side."""
    side = whole.width
    intrinsics = np.array([[side, 0, side / 2], [0, side, side / 2], [0, 0, 1.0]])
    pose = np.eye(3, 4)
    pose[index % 2, 3] = 0 if index < 0 else (-1) ** (index // 2) * 0.5 * (1 + index // 4)
    camera = NativeCamera(f"{index}.jpg", side, side, intrinsics, pose)
    texture = np.random.default_rng(1).integers(0, 256, (512, 512, 3), np.uint8)

    def read(rectangle: Rectangle, kind: str) -> NDArray[np.uint8]:
        shift = np.rint(pose[:2, 3] * side / 10).astype(int)
        rows = (np.arange(rectangle.y0, rectangle.y1) - shift[1]) // 4 % 512
        columns = (np.arange(rectangle.x0, rectangle.x1) - shift[0]) // 4 % 512
        return texture[np.ix_(rows, columns)]

    return View(camera, whole, 0, whole, read, index)


def _margins(arguments: argparse.Namespace) -> None:
    """Photographs uncut and by sub-images with halos, the same network and features."""
    workspace = Workspace(arguments.workspace)
    views, options = read_views(workspace), StereoOptions(backend="patchmatchnet")
    columns, rows = map(int, arguments.grid.split("x"))
    table: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(dir=workspace.folder) as folder:
        backend = PatchmatchNetBackend(Setup(views.coarsest, options, Path(folder)))
        estimator = _Estimator(workspace, views, options)

        def depth(name: str, window: Rectangle) -> NDArray[np.float32]:
            native = workspace.native(name)
            unit = Unit(native, None, window)
            found = estimator._estimate(unit, window.aligned(8), backend, None, Progress()).depth
            return found[window.slices_in(window.aligned(8))]

        whole = {name: depth(name, workspace.native(name).rectangle) for name in arguments.images}
        for halo in arguments.halos:
            estimated, differences = 0, []
            for name in arguments.images:
                image = workspace.native(name).rectangle
                for _, _, core in Grid(columns, rows).tiles(image):
                    window = core.padded(halo).intersection(image)
                    part = depth(name, window)[core.slices_in(window)]
                    differences.append(
                        np.abs(part / whole[name][core.slices_in(image)] - 1).ravel()
                    )
                    estimated += window.aligned(8).area
            relative = np.concatenate(differences)
            row = {
                "halo": halo,
                "estimated_to_core": round(estimated / len(relative), 3),
                "within_0.1_percent": round(float((relative < 1e-3).mean()), 5),
                "99.9 %": f"{np.percentile(relative, 99.9):.1e}",
                "max": f"{relative.max():.1e}",
            }
            table.append(row)
            print(json.dumps(row), flush=True)
    print_table(table)


if __name__ == "__main__":
    main()
