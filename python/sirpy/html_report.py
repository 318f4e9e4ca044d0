"""OUT/report.html: one page that shows what a run made, what it cost and what it left out.

The page needs nothing but itself: pictures are embedded, there is no script and no address of the
network.
"""

from __future__ import annotations

from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from sirpy import overview
from sirpy.camera_report import camera_section
from sirpy.cloud_picture import draw_cloud, mean_view
from sirpy.dense_stereo import count_reasons
from sirpy.files import read_json, written_whole
from sirpy.model_arrays import read_arrays
from sirpy.native_images import NativeImage
from sirpy.photograph_detail import detail_section
from sirpy.pictures import REASON_COLOURS, data_address, depth_colours, encoded_jpeg
from sirpy.ply import read_vertices
from sirpy.progress import duration
from sirpy.survey_report import survey_sections
from sirpy.workspace import Workspace

_GRID_SIDE = 1400  # longest side of the embedded pictures, pixels
_DEPTH_SIDE = 800
_CLOUD_SIDE = 1400
_DEPTH_PICTURES = 4
_ROWS_SHOWN = 30  # photographs in the table of coverage before it is folded

# Of `valid`, and of the reasons in the order in which they first occur.
_COLOURS = ("#2f6fb5", *REASON_COLOURS)


def report(workspace: Workspace) -> Path:
    """Writes the report of a workspace, and the picture of its cloud, and returns the report's
    path.

    Reads the sub-images, the maps, the native model, the cloud and run.json; a part that is not
    there yet is left out of the page.

    Raises:
        InputError: it is no workspace, or a file of it is damaged.
        OutputError: the report cannot be written.
    """
    reasons = _reasons(workspace)
    run = _read_run(workspace.run)
    workspace.begin_stage("report", workspace.fingerprint_of("fuse"))
    parts = [
        "<h1>Reconstruction report</h1>",
        _numbers(workspace, run, reasons),
        _evaluation(run.get("evaluation")),
        _cloud(workspace),
        *survey_sections(workspace),
        camera_section(workspace),
        detail_section(workspace),
        _grid(workspace),
        _depths(workspace),
        _coverage(reasons),
        _stages(run.get("stages") or [], run.get("memory"), run.get("stereo")),
        _left_out(_all_left_out(workspace, run)),
        _notes(run.get("notes") or []),
    ]
    style = resources.files("sirpy").joinpath("report.css").read_text(encoding="utf-8")
    page = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>sirpy report</title>\n<style>\n{style}</style></head>\n<body><main>\n"
        + "\n".join(part for part in parts if part)
        + "\n</main></body></html>\n"
    )
    with written_whole(workspace.report) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return workspace.report


def _read_run(path: Path) -> dict[str, Any]:
    """What `reconstruct` noted; empty after single stages."""
    try:
        return read_json(path, lambda run: {**run}, "run the same command again")
    except FileNotFoundError:
        return {}


def _reasons(workspace: Workspace) -> dict[str, dict[str, int]]:
    """What became of the pixels; empty before stereo is complete."""
    complete = all(workspace.reason_map(sub).exists() for _, sub in workspace.sub_images())
    return count_reasons(workspace) if complete else {}


def _all_left_out(workspace: Workspace, run: dict[str, Any]) -> list[dict[str, str]]:
    """Of structure from motion too, if the run began there."""
    cut = [{"name": out.name, "reason": out.reason} for out in workspace.left_out]
    return run.get("left_out") or cut


# ---- sections


def _numbers(workspace: Workspace, run: dict[str, Any], reasons: dict[str, dict[str, int]]) -> str:
    stages = run.get("stages") or []
    peaks = [stage["measured_peak"] for stage in stages if stage.get("measured_peak")]
    pixels = sum(sub.core.area for _, sub in workspace.sub_images())
    left_out = len(_all_left_out(workspace, run))
    valid = sum(counts["valid"] for counts in reasons.values())
    total = sum(sum(counts.values()) for counts in reasons.values())
    points = len(read_vertices(workspace.fused)) if workspace.fused.exists() else 0
    budget = run.get("memory")
    numbers = [
        (f"{points:,}", "points"),
        (
            str(len(workspace.natives)),
            f"photographs, {left_out} left out" if left_out else "photographs",
        ),
        (f"{pixels / 1e6:,.1f}", "megapixels"),
        (f"{valid / total:.1%}" if total else "–", "of the pixels have a depth"),
        (duration(sum(stage.get("wall_s") or 0 for stage in stages)), "wall time"),
        (
            _bytes(max(peaks)) if peaks else "–",
            f"peak memory of {_bytes(budget)} allowed" if budget else "peak memory",
        ),
    ]
    cells = [
        f'<div class="number"><b>{escape(value)}</b>'
        f'<span class="label">{escape(label)}</span></div>'
        for value, label in numbers
    ]
    return '<div class="numbers">' + "".join(cells) + "</div>"


def _evaluation(evaluation: dict[str, Any] | None) -> str:
    if not evaluation:
        return ""
    columns = ("thresholds", "accuracy", "completeness", "f1")
    rows = "".join(
        f'<tr><td>{threshold:g} GSD</td><td class="right">{accuracy:.1%}</td>'
        f'<td class="right">{completeness:.1%}</td><td class="right">{f1:.3f}</td></tr>'
        for threshold, accuracy, completeness, f1 in zip(
            *(evaluation[column] for column in columns), strict=True
        )
    )
    return (
        "<h2>Against the ground truth</h2><p>Accuracy: points within the distance of the true "
        "surface. Completeness: true surface within the distance of a point.</p>"
        '<div class="card scroll"><table><tr><th>within</th><th class="right">accuracy</th>'
        f'<th class="right">completeness</th><th class="right">F1</th></tr>{rows}</table></div>'
    )


def _cloud(workspace: Workspace) -> str:
    if not workspace.fused.exists() or not workspace.native_model.exists():
        return ""
    if len(read_vertices(workspace.fused)) == 0:
        return "<h2>The point cloud</h2><p>It is empty; the coverage below says why.</p>"
    forward, up = mean_view(read_arrays(workspace.native_model, may_be_empty=True))
    picture = draw_cloud(
        workspace.fused, workspace.cloud_picture, forward=forward, up=up, size=_CLOUD_SIDE
    )
    return (
        "<h2>The point cloud</h2><p>Every point in its colour, seen along the mean direction of "
        'the photographs, without perspective.</p><div class="card"><figure>'
        f'<img alt="The point cloud" src="{data_address(picture.read_bytes(), "png")}"></figure></div>'
    )


def _grid(workspace: Workspace) -> str:
    if not workspace.natives:
        return ""
    native = workspace.natives[0]
    columns = len({sub.column for sub in native.sub_images})
    rows = len({sub.row for sub in native.sub_images})
    frame = overview.Frame.of_native(native, _GRID_SIDE)
    image = overview.photograph(workspace, frame)
    stroke = native.width / 500
    shapes = []
    for sub_image in native.sub_images:
        core = sub_image.core
        size = min(core.width / 9, core.height / 5, 14 * stroke)
        shapes.append(
            f'<rect x="{core.x0}" y="{core.y0}" width="{core.width}" height="{core.height}" '
            f'fill="none" stroke="#fff" stroke-width="{stroke:.1f}"/>'
            f'<text x="{core.x0 + size / 2:.1f}" y="{core.y0 + 1.3 * size:.1f}" '
            f'font-size="{size:.1f}" fill="#fff" stroke="#000" stroke-width="{size / 6:.1f}" '
            f'paint-order="stroke">r{sub_image.row} c{sub_image.column}</text>'
        )
    sizes = {(sub.stored.width, sub.stored.height) for sub in native.sub_images}
    decimated = (
        f" This picture is decimated {frame.factor} times; the reconstruction is not."
        if frame.factor > 1
        else ""
    )
    largest = max(sizes, key=lambda size: size[0] * size[1])
    return (
        "<h2>The grid</h2>"
        f"<p>{escape(native.name)}, {native.width} × {native.height} pixels, as "
        f"{_plural(len(native.sub_images), 'sub-image')} ({columns}x{rows}) of at most "
        f"{largest[0]} × {largest[1]} pixels.{decimated}</p>"
        '<div class="card">'
        f'<svg viewBox="0 0 {native.width} {native.height}" role="img" '
        'font-family="system-ui, sans-serif" font-weight="600">'
        f'<image width="{native.width}" height="{native.height}" preserveAspectRatio="none" '
        f'href="{data_address(encoded_jpeg(image), "jpeg")}"/>{"".join(shapes)}</svg></div>'
    )


def _depths(workspace: Workspace) -> str:
    natives = [native for native in workspace.natives if _has_depth(workspace, native)]
    if not natives:
        return ""
    shown = np.unique(np.linspace(0, len(natives) - 1, _DEPTH_PICTURES).round().astype(int))
    cards = [_depth_card(workspace, natives[index]) for index in shown]
    return "<h2>Depth maps</h2><p>Warm is near, cold is far, dark grey has no depth.</p>" + "".join(
        cards
    )


def _has_depth(workspace: Workspace, native: NativeImage) -> bool:
    return any(workspace.depth_map(sub, "geometric").exists() for sub in native.sub_images)


def _depth_card(workspace: Workspace, native: NativeImage) -> str:
    frame = overview.Frame.of_native(native, _DEPTH_SIDE)
    image = overview.photograph(workspace, frame)
    depth = overview.depth_map(workspace, frame)
    known = depth[depth > 0]
    nearest, farthest = np.percentile(known, [1, 99]) if len(known) else (0.0, 1.0)
    colours = depth_colours(depth, float(nearest), float(farthest))
    text = f"depths from {nearest:.4g} to {farthest:.4g}" if len(known) else "no depth at all"
    return (
        '<div class="card"><figure><div class="pair">'
        f'<img alt="{escape(native.name)}" src="{data_address(encoded_jpeg(image), "jpeg")}">'
        f'<img alt="its depth map" src="{data_address(encoded_jpeg(colours, 90), "jpeg")}"></div>'
        f"<figcaption>{escape(native.name)}: {text}, in the unit of the model</figcaption>"
        "</figure></div>"
    )


def _coverage(reasons: dict[str, dict[str, int]]) -> str:
    if not reasons:
        return ""
    names = list(dict.fromkeys(["valid", *(n for counts in reasons.values() for n in counts)]))
    colours = {name: _COLOURS[i % len(_COLOURS)] for i, name in enumerate(names)}
    totals = {name: sum(c.get(name, 0) for c in reasons.values()) for name in names}
    pixels = max(sum(totals.values()), 1)
    key = "".join(
        f'<li><i style="background:{colours[name]}"></i>{escape(_spoken(name))} '
        f"{totals[name] / pixels:.1%} ({totals[name]:,} pixels)</li>"
        for name in names
        if totals[name]
    )
    rows = [
        f'<tr><td>{escape(image)}</td><td class="wide">{_stacked(counts, names, colours)}</td>'
        f'<td class="right">{counts.get("valid", 0) / max(sum(counts.values()), 1):.1%}</td></tr>'
        for image, counts in reasons.items()
    ]
    head = '<tr><th>photograph</th><th></th><th class="right">with depth</th></tr>'
    table = f'<div class="scroll"><table>{head}{"".join(rows)}</table></div>'
    if len(rows) > _ROWS_SHOWN:
        table = f"<details><summary>All {len(rows)} photographs</summary>{table}</details>"
    return (
        "<h2>Coverage</h2><p>How many pixels have a depth, and why the others have none.</p>"
        f'<div class="card">{_stacked(totals, names, colours)}<ul class="key">{key}</ul></div>'
        f'<div class="card">{table}</div>'
    )


def _stacked(counts: dict[str, int], names: list[str], colours: dict[str, str]) -> str:
    total = max(sum(counts.values()), 1)
    parts = [
        f'<i style="width:{100 * counts[name] / total:.3f}%;background:{colours[name]}" '
        f'title="{escape(_spoken(name))}"></i>'
        for name in names
        if counts.get(name)
    ]
    return f'<div class="bar">{"".join(parts)}</div>'


def _stages(stages: list[dict[str, Any]], budget: int | None, stereo: str | None) -> str:
    if not stages:
        return ""
    peaks = [stage.get(key) or 0 for stage in stages for key in ("predicted_peak", "measured_peak")]
    scale = max([budget or 0, *peaks, 1]) * 1.02
    rows = "".join(_stage_row(stage, budget, scale) for stage in stages)
    marks = [("var(--pale)", "predicted peak"), ("var(--blue)", "measured peak")]
    if budget:
        marks.append(("var(--ink)", f"budget, {_bytes(budget)}"))
    key = "".join(f'<li><i style="background:{c}"></i>{escape(text)}</li>' for c, text in marks)
    return (
        "<h2>Stages</h2><p>Times, and the peak memory of the whole process tree."
        + (f" Stereo is {escape(stereo)}." if stereo else "")
        + "</p>"
        '<div class="card"><div class="scroll"><table><tr><th>stage</th><th></th>'
        '<th class="right">wall</th><th class="right">CPU</th><th class="right">predicted</th>'
        f'<th class="right">measured</th><th></th></tr>{rows}</table></div>'
        f'<ul class="key">{key}</ul></div>'
    )


def _stage_row(stage: dict[str, Any], budget: int | None, scale: float) -> str:
    predicted, measured = stage.get("predicted_peak"), stage.get("measured_peak")
    over = " over" if budget and measured and measured > budget else ""
    bars = ""
    if predicted:
        bars += f'<i class="predicted" style="width:{100 * predicted / scale:.2f}%"></i>'
    if measured:
        bars += f'<i class="measured{over}" style="width:{100 * measured / scale:.2f}%"></i>'
    if budget:
        bars += f'<i class="budget" style="left:{100 * budget / scale:.2f}%"></i>'
    units = _plural(stage.get("units") or 0, str(stage.get("unit") or "unit"))
    reused = ' <span class="tag">done before</span>' if stage.get("reused") else ""
    return (
        f"<tr><td>{escape(str(stage.get('name', '')))}{reused}</td>"
        f'<td class="label">{escape(units)}</td>'
        f'<td class="right">{duration(stage.get("wall_s") or 0)}</td>'
        f'<td class="right">{duration(stage.get("cpu_s") or 0)}</td>'
        f'<td class="right">{_bytes(predicted)}</td><td class="right">{_bytes(measured)}</td>'
        f'<td class="wide"><div class="peak">{bars}</div></td></tr>'
    )


def _left_out(left_out: list[dict[str, str]]) -> str:
    if not left_out:
        return ""
    rows = "".join(
        f"<tr><td>{escape(out['name'])}</td><td>{escape(out['reason'])}</td></tr>"
        for out in left_out
    )
    return (
        "<h2>Photographs left out</h2>"
        f'<div class="card scroll"><table><tr><th>photograph</th><th>reason</th></tr>{rows}'
        "</table></div>"
    )


# ---- small words


def _notes(notes: list[str]) -> str:
    """What was said on the way, as far as the sections above do not say it."""
    items = "".join(f"<li>{escape(str(note))}</li>" for note in notes)
    return f'<h2>Said on the way</h2><div class="card"><ul>{items}</ul></div>' if items else ""


def _bytes(number: int | None) -> str:
    if number is None:
        return "–"
    if number >= 1e9:
        return f"{number / 1e9:.2f} GB"
    return f"{number / 1e6:.0f} MB"


def _plural(number: int, unit: str) -> str:
    return f"{number:,} {unit}" if number == 1 else f"{number:,} {unit}s"


def _spoken(reason: str) -> str:
    return "with depth" if reason == "valid" else reason.replace("_", " ")
