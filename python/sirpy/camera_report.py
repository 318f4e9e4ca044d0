"""How well cameras fit their tie points, before and after the refinement: a section of report.html.

A lens that its camera model does not follow leaves residuals that point the same way in the same part of every
photograph. Means over the cells of a grid over the frame show them, as arrows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
import numpy.typing as npt

from sirpy.files import read_json
from sirpy.frame import Floats
from sirpy.workspace import Workspace

_ROWS_SHOWN = 30  # photographs in the table before it is folded
_LENSES_SHOWN = 6  # those with most observations: with one for each photograph there are too many
_FEW = 10  # observations of a cell: its mean is mostly chance
_WIDTH = 480.0  # of a plot, in its own units
_LONGEST = 0.95  # of the side of a cell: the longest arrow
_INK, _PALE = "#2f6fb5", "#b9c6d4"


@dataclass(frozen=True, eq=False)
class LensResiduals:
    """Mean residuals, observed less projected, native px, of the cells of a grid over the frame.

    Attributes:
        count: (rows, columns), observations; where 0, the means have no meaning.
        before, after: (rows, columns, 2).
    """

    camera_id: int
    model: str
    width: int
    height: int
    count: npt.NDArray[np.int64]
    before: Floats
    after: Floats


@dataclass(frozen=True)
class ImageResiduals:
    """Of one photograph; rms in native px, over the observations that were not rejected."""

    name: str
    observations: int
    rejected: int
    rms_before: float
    rms_after: float


@dataclass(frozen=True)
class Residuals:
    """What refinement.json says; `kept`: why the cameras are not those that were adjusted, or None."""

    points: int
    observations: int
    rms_before: float
    rms_after: float
    images: tuple[ImageResiduals, ...]
    lenses: tuple[LensResiduals, ...]
    kept: str | None


def read_residuals(workspace: Workspace) -> Residuals | None:
    """None where the cameras were not refined.

    Raises InputError where the file is damaged.
    """
    try:
        return read_json(workspace.refinement, _parsed, "run the same command again")
    except FileNotFoundError:
        return None


def camera_section(workspace: Workspace) -> str:
    """A section of HTML; empty where the cameras were not refined.

    Raises InputError where refinement.json is damaged.
    """
    found = read_residuals(workspace)
    if found is None:
        return ""
    shown = sorted(found.lenses, key=lambda lens: -int(lens.count.sum()))[:_LENSES_SHOWN]
    more = len(found.lenses) - len(shown)
    lenses = "".join(_lens(lens) for lens in sorted(shown, key=lambda lens: lens.camera_id))
    others = f" Of {len(found.lenses)} cameras, those with most observations." if more else ""
    kept = f"<p>{escape(found.kept[0].upper() + found.kept[1:])}.</p>" if found.kept else ""
    return (
        f"<h2>The cameras</h2>{kept}<p>{found.points:,} tie points were measured at native resolution, "
        f"{found.observations:,} times. Their residuals, observed less projected, had an rms of "
        f"{found.rms_before:.3f} px before the adjustment and have {found.rms_after:.3f} after it.</p>"
        f'<div class="card">{_table(found.images)}</div>'
        "<p>Mean residuals over the frame. Arrows that point the same way side by side are an error of the "
        f"lens that its model does not follow. The scales before and after differ; pale dots have fewer than "
        f"{_FEW} observations.{others}</p>{lenses}"
    )


def _lens(lens: LensResiduals) -> str:
    title = f"Camera {lens.camera_id}, {escape(lens.model)}, {lens.width} × {lens.height}"
    plots = "".join(
        f"<figure>{plot(lens, means)}<figcaption>{when}: rms of the means "
        f"{_rms(lens.count, means)}</figcaption></figure>"
        for when, means in (("Before", lens.before), ("After", lens.after))
    )
    return f'<div class="card"><p class="label">{title}</p><div class="pair">{plots}</div></div>'


def _rms(count: npt.NDArray[np.int64], means: Floats) -> str:
    """Over the observations: each counts with the mean of its cell."""
    if not count.any():
        return "–"
    squares = (np.where(count > 0, (means**2).sum(axis=2), 0.0) * count).sum()
    return f"{math.sqrt(squares / count.sum()):.3f} px"


def plot(lens: LensResiduals, means: Floats) -> str:
    """An SVG of the frame with an arrow from the middle of each cell and a scale.

    Where others have more, a cell of few observations has a pale dot; without observations it has nothing.
    """
    rows, columns = lens.count.shape
    high = _WIDTH * lens.height / lens.width
    cell = np.array([_WIDTH / columns, high / rows])
    sure = lens.count >= (_FEW if lens.count.max() >= _FEW else 1)
    chance = (lens.count > 0) & ~sure
    longest = float(np.linalg.norm(means[sure], axis=1).max(initial=0.0))
    per_pixel = _LONGEST * float(cell.min()) / longest if longest else 0.0

    def middles(which: npt.NDArray[np.bool_]) -> Floats:
        places: Floats = (np.argwhere(which)[:, ::-1] + 0.5) * cell
        return places

    beside = float(cell.max()) / 2  # so far an arrow reaches over the border of the frame
    shapes = [
        f'<rect x="0" y="0" width="{_WIDTH:g}" height="{high:.1f}" fill="none" stroke="#dfe4ea"/>',
        _dots(middles(chance), _PALE),
        _arrows(middles(sure), means[sure] * per_pixel, _INK),
        _scale(longest, per_pixel, high + beside + 8),
    ]
    box = -beside, -beside, _WIDTH + 2 * beside, high + 2 * beside + 16
    view = " ".join(f"{value:.1f}" for value in box)
    return f'<svg viewBox="{view}" role="img">{"".join(shapes)}</svg>'


def _arrows(begins: Floats, vectors: Floats, colour: str) -> str:
    """Arrows from `begins` (n, 2) along `vectors` (n, 2), units of the plot, x to the right, y down."""
    tips = begins + vectors
    along = 0.3 * vectors
    across = 0.5 * along[:, ::-1] * [-1, 1]
    ends = (tips - along + across, tips, tips - along - across)
    path = "".join(
        f"M{x:.1f},{y:.1f}L{tx:.1f},{ty:.1f}M{ax:.1f},{ay:.1f}L{tx:.1f},{ty:.1f}L{bx:.1f},{by:.1f}"
        for (x, y), (ax, ay), (tx, ty), (bx, by) in zip(begins, *ends, strict=True)
    )
    return (
        f'{_dots(begins, colour)}<path d="{path}" fill="none" stroke="{colour}" stroke-width="1.2" '
        'stroke-linejoin="round" stroke-linecap="round"/>'
    )


def _dots(places: Floats, colour: str) -> str:
    path = "".join(f"M{x:.1f},{y:.1f}h0" for x, y in places)
    return f'<path d="{path}" stroke="{colour}" stroke-width="2.6" stroke-linecap="round"/>'


def _scale(longest: float, per_pixel: float, y: float) -> str:
    """An arrow of a round number of pixels, not longer than the longest."""
    label = f'y="{y + 4:.1f}" font-size="12" fill="#5d6876"'
    if not longest:
        return f'<text x="2" {label}>no residuals</text>'
    power = 10.0 ** math.floor(math.log10(longest))
    length = power * max(step for step in (1, 2, 5) if step * power <= longest * (1 + 1e-9))
    arrow = _arrows(np.array([[4.0, y]]), np.array([[length * per_pixel, 0.0]]), "#1d2530")
    return f'{arrow}<text x="{length * per_pixel + 12:.1f}" {label}>{length:g} px</text>'


def _table(images: Sequence[ImageResiduals]) -> str:
    heads = ("observations", "rejected", "rms before", "rms after")
    right = "".join(f'<th class="right">{head}</th>' for head in heads)
    rows = "".join(_row(one) for one in images)
    table = f'<div class="scroll"><table><tr><th>photograph</th>{right}</tr>{rows}</table></div>'
    if len(images) > _ROWS_SHOWN:
        return f"<details><summary>All {len(images)} photographs</summary>{table}</details>"
    return table


def _row(one: ImageResiduals) -> str:
    values = (
        f"{one.observations:,}",
        f"{one.rejected:,}",
        f"{one.rms_before:.3f}",
        f"{one.rms_after:.3f}",
    )
    cells = "".join(f'<td class="right">{value}</td>' for value in values)
    return f"<tr><td>{escape(one.name)}</td>{cells}</tr>"


def _parsed(value: Any) -> Residuals:
    if value["version"] != 1:
        raise ValueError(f"its version is {value['version']}")
    return Residuals(
        int(value["points"]),
        int(value["observations"]),
        float(value["rms_before"]),
        float(value["rms_after"]),
        tuple(
            ImageResiduals(
                str(one["name"]),
                int(one["observations"]),
                int(one["rejected"]),
                float(one["rms_before"]),
                float(one["rms_after"]),
            )
            for one in value["images"]
        ),
        tuple(_lens_parsed(one) for one in value["cameras"]),
        value.get("kept"),  # older files have refined cameras
    )


def _lens_parsed(value: Any) -> LensResiduals:
    shape = int(value["rows"]), int(value["columns"])
    return LensResiduals(
        int(value["camera_id"]),
        str(value["model"]),
        int(value["width"]),
        int(value["height"]),
        np.array(value["count"], np.int64).reshape(shape),
        np.array(value["mean_residual_before"], np.float64).reshape(*shape, 2),
        np.array(value["mean_residual"], np.float64).reshape(*shape, 2),
    )
