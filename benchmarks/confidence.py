"""How right depths are, by what the estimator says of them: the coefficients of the confidence and its check.

    python benchmarks/confidence.py WORKSPACE TRUTH [WORKSPACE TRUTH ...] [--sub-images 8] [--stereo NAME]

Each WORKSPACE has been through `sirpy stereo`, with the same backend; TRUTH is the truth.npz of a rendered scene, or
a folder of exact depth maps named as those of the workspace. Stereo is run again, in a copy, to see what it says of
some sub-images before the filter. The first scene is fitted, the others check: a depth is right within RIGHT_UNITS
units of the sources or RIGHT_DEVIATIONS standard deviations (python/sirpy/filtering.py). One JSON object for each
scene; the first holds the coefficients, which belong into python/sirpy/filtering.py.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pycolmap
from numpy.typing import NDArray
from sirpy import dense_stereo
from sirpy.filtering import (
    CONFIDENCE,
    JUDGED_CONFIDENCE,
    RIGHT_DEVIATIONS,
    RIGHT_UNITS,
    Estimate,
    Reason,
    evidence,
    neighbourhood,
    probability,
)
from sirpy.native_images import NativeImage, SubImage
from sirpy.rectangle import Rectangle
from sirpy.stereo_backend import DEFAULT_BACKEND, StereoOptions
from sirpy.truth import Truth
from sirpy.windows import read_map
from sirpy.workspace import Workspace

MOST_FITTED = 1_000_000
ROUNDS = 30  # of Newton's method


@dataclass(frozen=True)
class Pixels:
    """Pixels with a true depth: evidence (9, n), reason (n,), whether the depth is right (n,)."""

    evidence: NDArray[np.float32]
    reason: NDArray[np.uint8]
    right: NDArray[np.bool_]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", type=Path, nargs="+", metavar="WORKSPACE TRUTH")
    parser.add_argument("--sub-images", type=int, default=8, help="of each scene, evenly chosen")
    parser.add_argument("--stereo", default=DEFAULT_BACKEND, help="the backend")
    arguments = parser.parse_args()
    scenes = list(zip(arguments.scenes[::2], arguments.scenes[1::2], strict=True))
    coefficients = None
    now = CONFIDENCE if arguments.stereo == DEFAULT_BACKEND else JUDGED_CONFIDENCE
    for workspace, truth in scenes:
        pixels = collect(workspace, truth, arguments.sub_images, arguments.stereo)
        result: dict[str, Any] = {"workspace": str(workspace)}
        if coefficients is None:
            coefficients = fitted(pixels)
            result["coefficients"] = [round(float(one), 3) for one in coefficients]
        result["now"] = reliability(pixels, now)
        result["fitted"] = reliability(pixels, coefficients)
        result["reasons"] = reasons(pixels)
        print(json.dumps(result, indent=1), flush=True)


def collect(folder: Path, truth: Path, most: int, backend: str) -> Pixels:
    # Links beside the original: what is made anew takes the place of a link, not of the file.
    with tempfile.TemporaryDirectory(dir=folder.parent) as copy:
        shutil.copytree(folder, copy, copy_function=os.link, dirs_exist_ok=True)
        workspace = Workspace(copy)
        everything = list(workspace.sub_images())
        chosen = np.unique(np.linspace(0, len(everything) - 1, most).round().astype(int))
        parts = estimated(workspace, [everything[i] for i in chosen], truth, backend)
    return Pixels(*(np.concatenate(maps, axis=-1) for maps in zip(*parts, strict=True)))


def true_depth(
    workspace: Workspace, native: NativeImage, sub: SubImage, truth: Path
) -> NDArray[np.float32]:
    """Of what the sub-image stores; 0 where there is no surface."""
    if truth.is_dir():
        return read_map(truth / workspace.depth_map(sub, "geometric").name)
    model = pycolmap.Reconstruction(str(workspace.native_model))
    image = next(image for image in model.images.values() if image.name == native.name)
    depth = Truth.read(truth).depth_map(image.camera, image.cam_from_world())
    return depth[sub.stored.slices_in(native.rectangle)]


def estimated(
    workspace: Workspace, chosen: list[tuple[NativeImage, SubImage]], truth: Path, backend: str
) -> list[tuple[Any, ...]]:
    """Estimates the sub-images again, all passes: their pixels of known depth."""
    parts = []
    filter_depths = dense_stereo.filter_depths
    left = iter(chosen)  # stereo works in the order of the workspace

    def recorded(
        estimate: Estimate, intrinsics: Any, window: Rectangle, masked: Any, *more: Any
    ) -> Any:
        found = filter_depths(estimate, intrinsics, window, masked, *more)
        native, sub = next(left)
        depth = true_depth(workspace, native, sub, truth)
        stored = sub.stored.slices_in(window)
        known = (depth > 0) & ~masked[stored]
        around = neighbourhood(estimate, intrinsics, window)
        evidences = evidence(estimate, intrinsics[0, 0], around)
        error = np.abs(estimate.depth[stored] - depth)
        units, sigma = estimate.units(intrinsics[0, 0])[stored], estimate.sigma[stored]
        tolerated = np.maximum(RIGHT_UNITS * units, RIGHT_DEVIATIONS * sigma)
        right = (error <= tolerated) & (estimate.depth[stored] > 0)
        parts.append((evidences[:, *stored][:, known], found[0][stored][known], right[known]))
        return found

    for _, sub in chosen:
        workspace.depth_map(sub, "geometric").unlink()
    with mock.patch.object(dense_stereo, "filter_depths", recorded):
        dense_stereo.stereo(workspace, options=StereoOptions(backend=backend))
    return parts


def fitted(pixels: Pixels) -> NDArray[np.float64]:
    """Coefficients of greatest likelihood for the pixels that are kept."""
    kept = np.flatnonzero(pixels.reason == 0)
    kept = kept[:: max(1, len(kept) // MOST_FITTED)]
    x, y = pixels.evidence[:, kept].astype(np.float64), pixels.right[kept]
    coefficients = np.zeros(len(x))
    for _ in range(ROUNDS):
        likely = probability(x.astype(np.float32), coefficients).astype(np.float64)
        hessian = (x * likely * (1 - likely)) @ x.T + 1e-6 * np.eye(len(x))
        coefficients += np.linalg.solve(hessian, x @ (y - likely))
    return coefficients


def reliability(pixels: Pixels, coefficients: NDArray[np.float64]) -> dict[str, Any]:
    """Predicted and observed shares of right depths among the kept pixels, by tenths of them."""
    kept = pixels.reason == 0
    likely = probability(pixels.evidence[:, kept], coefficients)
    order = np.argsort(likely, kind="stable")
    tenths = [
        (float(likely[part].mean()), float(pixels.right[kept][part].mean()))
        for part in np.array_split(order, 10)
    ]
    return {
        "mean_error": round(float(np.mean([abs(p - o) for p, o in tenths])), 4),
        "predicted_observed": [[round(p, 3), round(o, 3)] for p, o in tenths],
    }


def reasons(pixels: Pixels) -> dict[str, dict[str, float]]:
    """For each reason: share of all right and of all wrong depths that have it, and have it alone."""
    right, wrong = pixels.right, ~pixels.right
    table = {"kept": pixels.reason == 0}
    for reason in Reason:
        table[str(reason.name).lower()] = (pixels.reason & reason) != 0
        table[f"only {str(reason.name).lower()}"] = pixels.reason == reason
    return {
        name: {
            "right": round(float(hit[right].mean()), 4),
            "wrong": round(float(hit[wrong].mean()), 4),
        }
        for name, hit in table.items()
        if hit.any()
    }


if __name__ == "__main__":
    main()
