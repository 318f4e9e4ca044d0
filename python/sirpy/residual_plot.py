"""How well a survey fits the positions that it was given: a table and a plot for report.html."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from sirpy.alignment import Alignment, Residual, Role, read_alignment
from sirpy.workspace import Workspace

_ROWS_SHOWN = 30  # in the table before it is folded
_SOURCES = {
    "exif": "GPS of the photographs",
    "positions": "a list of camera positions",
    "control_points": "ground control",
    "declared": "the model as it came",
}
_COLOURS: dict[Role, str] = {"used": "#2f6fb5", "check": "#3f9c85", "outlier": "#c8501e"}
_SAID: dict[Role, str] = {"used": "used", "check": "for checking", "outlier": "not used"}


def residuals(workspace: Workspace) -> str:
    """A section of HTML; empty where nothing was aligned."""
    alignment = read_alignment(workspace)
    if alignment is None or not alignment.residuals:
        return ""
    unit = " m" if alignment.frame.crs else ""
    roles = [role for role in _COLOURS if any(one.role == role for one in alignment.residuals)]
    key = "".join(
        f'<li><i style="background:{_COLOURS[role]}"></i>{_SAID[role]}{_rms(alignment, role, unit)}</li>'
        for role in roles
    )
    return (
        f"<h2>Fit to the positions</h2><p>From {_SOURCES[alignment.source]}: where the model has each, less "
        f'where it should be{_in(unit)}.</p><div class="card">'
        f'<div class="pair"><figure>{_plot(alignment.residuals, unit)}</figure><div>'
        f'<ul class="key">{key}</ul></div></div>'
        f"{_table(alignment.residuals)}</div>"
    )


def _rms(alignment: Alignment, role: Role, unit: str) -> str:
    if role == "outlier":
        return ": " + escape(", ".join(alignment.outliers))
    rms = alignment.rms(role)
    pixels = f", {rms['pixels']:.2f} pixels" if "pixels" in rms else ""
    return f": rms {rms['x']:.3g}, {rms['y']:.3g}, {rms['z']:.3g}{unit} in x, y, z{pixels}"


def _in(unit: str) -> str:
    return f", in{unit}" if unit else ", in the unit of the frame"


def _plot(all_residuals: Sequence[Residual], unit: str) -> str:
    """dx and dy as places, dz as a bar beside; what is not used may lie outside and is not drawn then."""
    fitted = [one for one in all_residuals if one.role != "outlier"] or all_residuals
    most = max(max(abs(one.dx), abs(one.dy), abs(one.dz)) for one in fitted) or 1.0
    power = 10.0 ** math.floor(math.log10(most))
    ring = power * next(step for step in (1, 2, 5, 10) if step * power >= most)
    shapes = [
        f'<circle cx="110" cy="110" r="{radius}" fill="none" stroke="#dfe4ea"/>'
        for radius in (50, 100)
    ]
    shapes.append('<path d="M10,110h200M110,10v200M250,10v200M244,110h12" stroke="#dfe4ea"/>')
    for one in all_residuals:
        x, y, z = (100 * value / ring for value in (one.dx, one.dy, one.dz))
        colour, title = _COLOURS[one.role], f"<title>{escape(one.name)}</title>"
        if math.hypot(x, y) <= 105:
            shapes.append(_dot(110 + x, 110 - y, colour, title))
        if abs(z) <= 105:
            shapes.append(_dot(250, 110 - z, colour, title))
    label = 'font-size="9" fill="#5d6876"'
    shapes.append(
        f'<text x="110" y="222" text-anchor="middle" {label}>x, y: ring {ring:g}{unit}</text>'
    )
    shapes.append(f'<text x="250" y="222" text-anchor="middle" {label}>z: ±{ring:g}{unit}</text>')
    return f'<svg viewBox="0 0 290 228" role="img">{"".join(shapes)}</svg>'


def _dot(x: float, y: float, colour: str, title: str) -> str:
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{colour}" fill-opacity=".75">{title}</circle>'


def _table(all_residuals: Iterable[Residual]) -> str:
    rows = [_row(one) for one in all_residuals]
    right = "".join(
        f'<th class="right">{name}</th>' for name in ("x", "y", "z", "length", "pixels")
    )
    table = f'<div class="scroll"><table><tr><th>position of</th><th></th>{right}</tr>{"".join(rows)}</table></div>'
    if len(rows) > _ROWS_SHOWN:
        return f"<details><summary>All {len(rows)} positions</summary>{table}</details>"
    return table


def _row(one: Residual) -> str:
    length = float(np.linalg.norm([one.dx, one.dy, one.dz]))
    numbers = "".join(
        f'<td class="right">{value:.3f}</td>' for value in (one.dx, one.dy, one.dz, length)
    )
    pixels = "–" if one.pixels is None else f"{one.pixels:.2f}"
    return (
        f'<tr><td>{escape(one.name)}</td><td class="label">{_SAID[one.role]}</td>{numbers}'
        f'<td class="right">{pixels}</td></tr>'
    )
