"""What the photographs of a survey carry, and what native resolution adds: for the plan and the report."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from html import escape
from pathlib import Path

import numpy as np

from sirpy import _core
from sirpy.detail import WINDOW, Detail, measure_detail, sample_windows
from sirpy.errors import InputError
from sirpy.native_images import NativeImage
from sirpy.noise import Grey
from sirpy.photographs import open_photograph, push_rows, recapture_to_array, white_level
from sirpy.rectangle import Rectangle
from sirpy.windows import read_window
from sirpy.workspace import Workspace

_MOST = 24  # photographs that are measured
_NAMED = 3  # of those that are said in a sentence, the first
_LITTLE = 2.0  # native pixels: a photograph that resolves no less loses little by decimation


def photograph_details(images: Path, names: Sequence[str]) -> dict[str, Detail]:
    """Of at most 24 of the photographs `names` in the folder `images`, evenly chosen, by name; those that cannot be
    read are left out. Each is decoded once, in bounded memory."""
    found = {}
    for name in _some(names):
        try:
            found[name] = photograph_detail(images / name)
        except InputError:
            continue  # the plan says so
    return found


def photograph_detail(path: Path) -> Detail:
    """Of an original photograph. Raises InputError where it cannot be read."""
    photograph = open_photograph(path)
    size = photograph.width, photograph.height
    white = white_level(photograph) if photograph.bits == 16 else 255
    windows = sample_windows(*size)
    read: dict[Rectangle, Grey] = {}
    if min(size) >= WINDOW:  # all in one pass over the rows
        origins = np.array([(one.x0, one.y0) for one in windows], np.int64)
        cutter = _core.PatchCutter(photograph.shape, origins, WINDOW)
        push_rows(photograph, cutter)
        scale = 255 / white if photograph.bits == 16 else 1 / 256
        for one, luma in zip(windows, cutter.take(WINDOW), strict=True):
            read[one] = np.minimum(luma * np.float32(scale) + 0.5, 255).astype(np.uint8)
    else:
        for one in windows:
            pixels = recapture_to_array(photograph, None, size, one)
            read[one] = _core.convert_pixels(pixels, "grey", white)
    return measure_detail(read.__getitem__, *size)


def stored_details(workspace: Workspace) -> dict[str, Detail]:
    """The same of undistorted photographs, from their sub-images.

    Raises:
        InputError: a sub-image is missing or damaged.
    """
    found = {}
    for name in _some([native.name for native in workspace.natives]):
        found[name] = stored_detail(workspace, workspace.native(name))
    return found


def stored_detail(workspace: Workspace, native: NativeImage) -> Detail:
    """Of an undistorted photograph, from its sub-images; raises InputError as `stored_details`."""
    covered = native.covered
    read = partial(_read_stored, workspace, native.name, covered)
    return measure_detail(read, covered.width, covered.height)


def _read_stored(workspace: Workspace, name: str, covered: Rectangle, one: Rectangle) -> Grey:
    inside = Rectangle(covered.x0 + one.x0, covered.y0 + one.y0, one.width, one.height)
    return read_window(workspace, name, inside)


def spoken_details(details: dict[str, Detail], photographs: int) -> list[str]:
    """What to say of a survey of so many photographs: what native pixels add, and the coarsest photographs."""
    if not details:
        return []
    soft = [one for one in details.values() if one.resolution >= _LITTLE]
    measured = f"{len(details)} photographs"
    if len(details) < photographs:
        measured += f" measured, of {photographs:,}"
    said = f"native pixels carry detail in {len(details) - len(soft)} of {measured}"
    if soft:
        verb, these = ("resolves", "it") if len(soft) == 1 else ("resolve", "these")
        said += (
            f"; {len(soft)} {verb} no less than {_LITTLE:g} pixels: decimating {these} by 2 would "
            "lose little"
        )
    coarsest = sorted(details, key=lambda name: -details[name].resolution)[:_NAMED]
    return [said, *(spoken_detail(name, details[name]) for name in coarsest)]


def spoken_detail(name: str, detail: Detail) -> str:
    return f"{name} resolves {detail.resolution:.1f} pixels; noise {detail.noise_level:.1f} grey levels"


def detail_section(workspace: Workspace) -> str:
    """The section of report.html, or nothing. Raises InputError as `stored_details`."""
    details = stored_details(workspace)
    if not details:
        return ""
    rows = "".join(
        f'<tr><td>{escape(name)}</td><td class="right">{one.resolution:.1f}</td>'
        f'<td class="right">{one.noise_level:.1f}</td></tr>'
        for name, one in details.items()
    )
    summary = spoken_details(details, len(workspace.natives))[0]
    return (
        f"<h2>What photographs carry</h2><p>{escape(summary[0].upper() + summary[1:])}.</p>"
        '<div class="card"><details><summary>By photograph</summary><div class="scroll"><table>'
        '<tr><th>photograph</th><th class="right">resolves, pixels</th>'
        f'<th class="right">noise, grey levels</th></tr>{rows}</table></div></details></div>'
    )


def _some(names: Sequence[str]) -> list[str]:
    """At most 24 of them, evenly chosen."""
    chosen = np.linspace(0, len(names) - 1, min(len(names), _MOST)).round().astype(int)
    return [names[index] for index in chosen]
