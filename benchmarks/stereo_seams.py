"""Depth maps in bands beside the borders of sub-images, against true ones and against what lies beside the bands.

Content and overlap of photographs vary over an image, so a band is compared with the pixels next to it, as wide again
three times, photograph by photograph; with a workspace that was not cut also with the same pixels there.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sirpy.native_images import NativeImage
from sirpy.native_scene import read_native_scene
from sirpy.rectangle import Rectangle
from sirpy.workspace import Workspace
from stereo_maps import error_in_gsd, estimated_depth, quality, true_depth

_BESIDE = 3  # widths of a band


def compare_band(
    arguments: argparse.Namespace,
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Figures of each photograph, and of each measure the means over photographs."""
    workspace = Workspace(arguments.workspace)
    uncut = Workspace(arguments.uncut) if arguments.uncut else None
    if all(len(native.sub_images) == 1 for native in workspace.natives):
        sys.exit(f"{workspace.folder} was not cut: there are no borders to look at")
    cameras = read_native_scene(workspace).cameras
    rows = []
    for native in workspace.natives:
        truth = true_depth(arguments.truth, native)
        regions = _regions(native, arguments.band)
        row: dict[str, Any] = {"photograph": native.name}
        row["pixels"] = {name: int(region.sum()) for name, region in regions.items()}
        for what, of in (("cut", workspace), ("uncut", uncut)):
            if of is not None:
                depth = estimated_depth(of, of.native(native.name))
                error = error_in_gsd(depth, truth, cameras[native.name], arguments.gsd)
                row[what] = {name: quality(error[region]) for name, region in regions.items()}
        rows.append(row)
    return rows, [_means(rows, measure) for measure in rows[0]["cut"]["band"]]


def band_mask(native: NativeImage, width: int) -> NDArray[np.bool_]:
    """True at pixels less than `width` from a border between their core and another; (height, width)."""

    def is_cut(x: int, y: int) -> bool:
        return any(sub.core.contains(Rectangle(x, y, 1, 1)) for sub in native.sub_images)

    mask = np.zeros((native.height, native.width), np.bool_)
    for sub in native.sub_images:  # of a grid: beside a core lies one other, or none
        at = sub.core
        core = mask[at.slices_in(native.rectangle)]
        if is_cut(at.x0 - 1, at.y0):
            core[:, :width] = True
        if is_cut(at.x1, at.y0):
            core[:, -width:] = True
        if is_cut(at.x0, at.y0 - 1):
            core[:width] = True
        if is_cut(at.x0, at.y1):
            core[-width:] = True
    return mask


def _regions(native: NativeImage, band: int) -> dict[str, NDArray[np.bool_]]:
    inner, outer = band_mask(native, band), band_mask(native, (1 + _BESIDE) * band)
    cut = np.zeros_like(inner)
    for sub in native.sub_images:
        cut[sub.core.slices_in(native.rectangle)] = True
    return {"band": inner, "beside": outer & ~inner, "elsewhere": cut & ~inner}


def _means(rows: list[dict[str, Any]], measure: str) -> dict[str, Any]:
    def each(what: str, region: str) -> NDArray[np.float64]:
        return np.array([row[what][region][measure] for row in rows])

    means: dict[str, Any] = {"measure": measure}
    for region in ("band", "beside", "elsewhere"):
        means[region] = float(each("cut", region).mean())
    step = each("cut", "band") - each("cut", "beside")
    means |= _noise("band - beside", step)
    if "uncut" in rows[0]:
        uncut_step = each("uncut", "band") - each("uncut", "beside")
        means["uncut: band - beside"] = float(uncut_step.mean())
        means |= _noise("cut - uncut", step - uncut_step)
    return means


def _noise(name: str, values: NDArray[np.float64]) -> dict[str, Any]:
    """The mean, and whether it is within two standard errors of zero; by photograph."""
    mean = float(values.mean())
    if len(values) < 2:
        return {name: mean}
    error = float(values.std(ddof=1) / np.sqrt(len(values)))
    return {
        name: mean,
        f"{name}: standard error": error,
        f"{name}: within noise": abs(mean) <= 2 * error,
    }
