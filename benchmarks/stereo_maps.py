"""Depth maps of whole native images, put together of sub-images, and their errors in GSD."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sirpy.native_images import NativeImage
from sirpy.native_scene import NativeCamera
from sirpy.windows import open_map, read_map, read_map_window
from sirpy.workspace import Workspace

Floats = NDArray[np.floating]


def estimated_depth(workspace: Workspace, native: NativeImage) -> NDArray[np.float32]:
    """(height, width), 0 where there is none."""
    return read_map_window(workspace, native, native.rectangle, "depth")


def true_depth(folder: Path, native: NativeImage) -> NDArray[np.float32]:
    """The same of the files NAME.geometric.bin of the sub-images, or of one of the uncut photograph."""
    name = re.sub(r"_r\d+_c\d+(\.[^.]*)$", r"_r00_c00\1", native.sub_images[0].name)
    uncut = folder / f"{name}.geometric.bin"
    if uncut.exists():
        depth = read_map(uncut)
        if depth.shape == (native.height, native.width):
            return depth
    whole = np.zeros((native.height, native.width), np.float32)
    for sub in native.sub_images:
        planes = open_map(folder / f"{sub.name}.geometric.bin", sub.stored)
        whole[sub.stored.slices_in(native.rectangle)] = planes[0]
    return whole


def error_in_gsd(depth: Floats, truth: Floats, camera: NativeCamera, gsd: float | None) -> Floats:
    """Distances along the rays, GSD: infinity without a depth, NaN without a true one.

    Args:
        gsd: in world units; what a pixel spans at the true depth if None.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        if gsd is None:
            error = np.abs(depth - truth) * (camera.intrinsics[0, 0] / truth)
        else:
            x = (np.arange(camera.width) + 0.5 - camera.intrinsics[0, 2]) / camera.intrinsics[0, 0]
            y = (np.arange(camera.height) + 0.5 - camera.intrinsics[1, 2]) / camera.intrinsics[1, 1]
            error = np.abs(depth - truth) * np.sqrt(1 + x**2 + y[:, None] ** 2) / gsd
    return np.where(truth > 0, np.where(depth > 0, error, np.inf), np.nan)


def quality(error: Floats) -> dict[str, float]:
    """Of errors as above: shares within 1 and 2 GSD, of all that have a truth, and the median error."""
    error = error[~np.isnan(error)]
    with_depth = error[np.isfinite(error)]
    return {
        "complete_1_gsd": float((error <= 1).mean()) if error.size else float("nan"),
        "complete_2_gsd": float((error <= 2).mean()) if error.size else float("nan"),
        "median_error_gsd": float(np.median(with_depth)) if with_depth.size else float("nan"),
    }
