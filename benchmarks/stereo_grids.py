"""The same depth maps again: by another run, other threads, another grid, another halo."""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from metered import Cost, run_sirpy
from numpy.typing import NDArray
from reconstruction import check_new, grid_words
from sirpy.dense_stereo import estimated_window
from sirpy.fusion import POINT
from sirpy.model_arrays import SparseModel, read_arrays, write_model
from sirpy.native_images import NativeImage
from sirpy.native_scene import read_native_scene
from sirpy.patch_match import passes
from sirpy.stereo_backend import StereoOptions
from sirpy.stereo_passes import units
from sirpy.view_selection import read_views
from sirpy.windows import read_map_window
from sirpy.workspace import Workspace
from stereo_maps import error_in_gsd, estimated_depth, quality, true_depth


@dataclass(frozen=True)
class _Run:
    workspace: Workspace
    stereo: Cost


def compare_runs(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """The first run is of the first grid with 2 threads; the others are compared with it."""
    scene = _scene(arguments)
    grid, *others = arguments.grids
    runs = [("first", grid, 2), ("second", grid, 2), ("one thread", grid, 1)]
    runs += [("other grid", other, 2) for other in others]
    first: Workspace | None = None
    for what, grid, threads in runs:
        folder = arguments.output / f"{grid}_{what.replace(' ', '_')}"
        run = _run_stages(scene, folder, grid, arguments.halo, threads)
        run_sirpy("fuse", folder, "--threads", threads, "--quiet")
        row = {"run": what, "grid": grid, "threads": threads, **_stereo_cost(run)}
        if first is None:
            first = run.workspace
            yield row
            continue
        yield {
            **row,
            "depths_differ": _share_of_pixels(first, run.workspace, "depth"),
            "normals_differ": _share_of_pixels(first, run.workspace, "normal"),
            "same_cloud_file": first.fused.read_bytes() == run.workspace.fused.read_bytes(),
            "points_differ": _share_of_points(first, run.workspace),
        }
        _discard(run, arguments)


def compare_halos(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """The first row is the full halo's; the others are compared with it."""
    scene = _scene(arguments)
    full: Workspace | None = None
    for halo in [arguments.full, *(one for one in arguments.halos if one != arguments.full)]:
        folder = arguments.output / f"halo_{halo}"
        run = _run_stages(scene, folder, arguments.grid, halo, 0)
        views = read_views(run.workspace)
        added = overhead(run.workspace.natives, views.coarsest, views.halo)
        row = {"halo": halo, **added, **_stereo_cost(run)}
        if full is None:
            full = run.workspace
        else:
            row |= _difference(full, run.workspace, arguments.gsd)
        if arguments.truth:
            row |= _judged(run.workspace, arguments.truth, arguments.gsd)
        yield row
        if run.workspace is not full:
            _discard(run, arguments)


def most_connected(model: SparseModel, count: int) -> list[int]:
    """Indices of the image that shares most points with others, and of those it shares them with."""
    images, points = len(model.images), len(model.points)
    sees = np.zeros((images, points), np.float32)
    for index in range(images):
        sees[index, model.point[model.seen(index)]] = 1
    shared = sees @ sees.T
    np.fill_diagonal(shared, 0)
    best = int(shared.sum(axis=1).argmax())
    shared[best, best] = points + 1
    order = np.argsort(-shared[best], kind="stable")
    return sorted(order[:count].tolist())


def _scene(arguments: argparse.Namespace) -> tuple[Path, Path]:
    """Folder of photographs and model; of as many photographs as asked for."""
    images, sparse = arguments.scene / "images", arguments.scene / "sparse"
    if arguments.images is None:
        return images, sparse
    few = arguments.output / "few"
    check_new(few)
    model = read_arrays(sparse)
    model = model.taking(most_connected(model, arguments.images))
    write_model(model, few / "sparse")
    for image in model.images:
        link = few / "images" / image.name
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to((images / image.name).resolve())
    return few / "images", few / "sparse"


def _run_stages(scene: tuple[Path, Path], folder: Path, grid: str, halo: str, threads: int) -> _Run:
    check_new(folder)
    images, model = scene
    words = ["--model", model, "--output", folder, "--quiet"]
    # Without loss: each grid of a JPEG would be encoded in other blocks, and so be other pixels.
    run_sirpy("cut", images, *words, *grid_words(grid), "--format", "png")
    run_sirpy("views", folder, "--halo", halo, "--quiet")
    return _Run(Workspace(folder), run_sirpy("stereo", folder, "--threads", threads, "--quiet"))


def _stereo_cost(run: _Run) -> dict[str, float]:
    return {f"stereo_{key}": run.stereo[key] for key in ("cpu_s", "wall_s", "peak_gb")}


def _discard(run: _Run, arguments: argparse.Namespace) -> None:
    if not arguments.keep:
        shutil.rmtree(run.workspace.folder)


def _share_of_pixels(one: Workspace, other: Workspace, kind: Any) -> float:
    """Of all native pixels, those of which any byte differs."""
    differ = pixels = 0
    for native in one.natives:
        bits = [
            read_map_window(workspace, native_of, native.rectangle, kind).view(np.uint32)
            for workspace, native_of in ((one, native), (other, other.native(native.name)))
        ]
        unequal = bits[0] != bits[1]
        differ += int((unequal if kind == "depth" else unequal.any(axis=0)).sum())
        pixels += native.rectangle.area
    return differ / pixels


def _share_of_points(one: Workspace, other: Workspace) -> float:
    """Of the points of both clouds, in any order, those that only one of them has."""
    first, second = (_points(workspace) for workspace in (one, other))
    return len(np.setxor1d(first, second)) / max(1, len(first) + len(second))


def _points(workspace: Workspace) -> NDArray[Any]:
    points = np.concatenate(
        [np.load(workspace.fused_part(sub)) for _, sub in workspace.sub_images()]
    )
    return np.ascontiguousarray(points).view(f"S{POINT.itemsize}")


def overhead(natives: tuple[NativeImage, ...], coarsest: int, halo: int) -> dict[str, float]:
    """What a halo adds: pixels that the native photometric pass estimates, to those of the cores; and pixels
    by sweeps of all passes, to the same without a halo."""
    options = StereoOptions()
    sweeps, bare, estimated = 0, 0, 0
    for of_pass in passes(coarsest, options):
        for unit in units(natives, of_pass.level, coarsest):
            window, kept = (estimated_window(unit, of_pass, one, options).area for one in (halo, 0))
            sweeps += window * of_pass.iterations
            bare += kept * of_pass.iterations
            if (of_pass.level, of_pass.kind) == (0, "photometric"):
                estimated += window
    cores = sum(sub.core.area for native in natives for sub in native.sub_images)
    return {"estimated_to_core": estimated / cores, "sweeps_to_no_halo": sweeps / bare}


def _difference(full: Workspace, workspace: Workspace, gsd: float | None) -> dict[str, float]:
    cameras = read_native_scene(full).cameras
    pixels = any_byte = by_a_gsd = in_one = 0
    for native in full.natives:
        pair = estimated_depth(full, native), estimated_depth(workspace, native)
        error = error_in_gsd(pair[1], pair[0], cameras[native.name], gsd)
        pixels += native.rectangle.area
        any_byte += int((pair[0].view(np.uint32) != pair[1].view(np.uint32)).sum())
        by_a_gsd += int((np.isfinite(error) & (error > 1)).sum())
        in_one += int(((pair[0] > 0) != (pair[1] > 0)).sum())
    return {
        "differ": any_byte / pixels,
        "differ_by_more_than_1_gsd": by_a_gsd / pixels,
        "depth_in_one_only": in_one / pixels,
    }


def _judged(workspace: Workspace, truth: Path, gsd: float | None) -> dict[str, float]:
    """Means over the photographs."""
    cameras = read_native_scene(workspace).cameras

    def judged(native: NativeImage) -> dict[str, float]:
        depth = estimated_depth(workspace, native)
        return quality(error_in_gsd(depth, true_depth(truth, native), cameras[native.name], gsd))

    found = [judged(native) for native in workspace.natives]
    return {key: float(np.mean([one[key] for one in found])) for key in found[0]}
