"""A picture of what stereo found in a sub-image or a native image: photograph, depth, normals, confidence,
and why pixels have no depth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sirpy import overview
from sirpy.errors import InputError, first_few
from sirpy.files import written_whole
from sirpy.filtering import Reason, first_reasons
from sirpy.native_images import SubImage
from sirpy.overview import Frame
from sirpy.pictures import (
    MISSING_COLOUR,
    REASON_COLOURS,
    Text,
    depth_colours,
    encoded_png,
    rgb,
    turbo,
    with_texts,
)
from sirpy.windows import open_map
from sirpy.workspace import Workspace

Picture = NDArray[np.uint8]

_PANEL = 780  # longest side of a panel, pixels
_COLUMNS = 3
_GAP, _TITLE, _LINE, _BAR = 15, 26, 30, 10
_TEXT = 18
_PAPER, _INK, _KEPT = (250, 250, 248), (28, 31, 36), (228, 232, 236)
NOT_CUT_COLOUR = (84, 104, 150)
_LIGHT = np.array([-0.5, -0.6, -0.62])  # towards the light, camera frame: from the upper left
_SUREST = 3.0  # nines: 99.9 %
_ROWS = 512  # of a reason map, counted at a time


def explain(workspace: Workspace, name: str, output: Path | None = None) -> Path:
    """Draws what stereo found as a PNG of at most 2400 pixels' width, and returns its path.

    Args:
        name: of a sub-image (all that it stores is shown), or of a native image.
        output: the picture; in the workspace if None.

    Raises:
        InputError: there is no such image, or stereo has not estimated all of it.
        OutputError: the picture cannot be written.
    """
    frame = _frame(workspace, name)
    output = output or workspace.explanation(name)
    if output.suffix.lower() != ".png":
        raise InputError(f"--output {output}: the picture is a PNG, give a name that ends in .png")
    _check_estimated(workspace, name, frame)
    panels = _panels(workspace, frame)
    picture = _arranged(name, frame, panels, _legend(workspace, frame))
    with written_whole(output) as temporary:
        temporary.write_bytes(encoded_png(picture))
    return output


def _frame(workspace: Workspace, name: str) -> Frame:
    for native in workspace.natives:
        if native.name == name:
            return Frame.of_native(native, _PANEL)
        for sub_image in native.sub_images:
            if sub_image.name == name:
                return Frame.of_sub_image(sub_image, _PANEL)
    names = [sub_image.name for _, sub_image in workspace.sub_images()]
    raise InputError(
        f"{workspace.folder} has no image {name or 'without a name'}: give one of {first_few(names)}, or one of its "
        f"photographs, {first_few([native.name for native in workspace.natives])}"
    )


def _check_estimated(workspace: Workspace, name: str, frame: Frame) -> None:
    for sub_image, _ in frame.parts:
        missing = [path for path in workspace.stereo_maps(sub_image) if not path.exists()]
        if missing:
            raise InputError(
                f"{name} is not estimated yet (there is no {missing[0]}): run `sirpy stereo "
                f"{workspace.folder}` first"
            )


# ---- panels


@dataclass(frozen=True)
class _Panel:
    title: str
    image: Picture
    bar: Picture | None = None  # (1, any, 3): its colours from left to right
    marks: tuple[str, ...] = ()  # what they mean, evenly spread


def _panels(workspace: Workspace, frame: Frame) -> list[_Panel]:
    depth = overview.depth_map(workspace, frame)

    def sampled(path_of: Callable[[SubImage], Path], channels: int = 1) -> NDArray[np.float32]:
        return overview.sampled_map(frame, path_of, channels)

    normal = sampled(lambda sub: workspace.normal_map(sub, "geometric"), 3)
    confidence = sampled(workspace.confidence_map)[0]
    reason = sampled(workspace.reason_map)[0].astype(np.uint8)
    return [
        _Panel("photograph", overview.photograph(workspace, frame)),
        _depth_panel(depth, normal),
        _Panel("normals (right red, up green, towards the camera blue)", _normal_colours(normal)),
        _Panel(
            "confidence (probability to be right)",
            np.where((depth > 0)[..., None], _sureness(confidence), MISSING_COLOUR).astype(
                np.uint8
            ),
            _sureness(1 - 10.0 ** np.linspace(0, -_SUREST, _PANEL)[None]),
            ("0 %", "90 %", "99 %", "99.9 %"),
        ),
        _Panel("why there is no depth", _reason_colours(reason, frame)),
    ]


def _depth_panel(depth: NDArray[np.float32], normal: NDArray[np.float32]) -> _Panel:
    """Coloured by depth, shaded by the normals."""
    known = depth[depth > 0]
    if len(known) == 0:
        return _Panel("depth: none", depth_colours(depth, 0, 1))
    near, far = (float(one) for one in np.percentile(known, [1, 99]))
    light = np.clip(np.tensordot(_LIGHT / np.linalg.norm(_LIGHT), normal, 1), 0, 1)
    shade = np.where(depth > 0, 0.45 + 0.65 * light, 1)
    colours = np.clip(depth_colours(depth, near, far) * shade[..., None], 0, 255)
    bar = depth_colours(np.linspace(near, far, _PANEL, dtype=np.float32)[None], near, far)
    marks = tuple(f"{one:.4g}" for one in np.linspace(near, far, 3))
    return _Panel("depth (unit of the model)", colours.astype(np.uint8), bar, marks)


def _normal_colours(normal: NDArray[np.float32]) -> Picture:
    towards = normal * np.array([1, -1, -1], np.float32)[:, None, None]
    colours = np.moveaxis((towards + 1) * 127.5, 0, -1)
    colours[~normal.any(axis=0)] = MISSING_COLOUR
    return colours.astype(np.uint8)


def _sureness(confidence: NDArray[np.floating]) -> Picture:
    """Red is unsure, blue is sure; a step for each nine, since most depths are surer than 90 %."""
    nines = -np.log10(np.clip(1.0 - confidence, 10.0**-_SUREST, 1))
    return turbo(0.9 - 0.8 * nines / _SUREST)


def _reason_colours(reason: NDArray[np.uint8], frame: Frame) -> Picture:
    palette = np.full((256, 3), _KEPT, np.uint8)  # by the first reason
    for one, colour in zip(Reason, REASON_COLOURS, strict=True):
        palette[one] = rgb(colour)
    colours = palette[first_reasons(reason)]
    colours[~frame.held()] = NOT_CUT_COLOUR
    return colours


def _legend(workspace: Workspace, frame: Frame) -> list[tuple[tuple[int, int, int], str]]:
    """Colour and words of what becomes of pixels, counted in all of those shown that were cut: their
    shares add up to 1."""
    counts = np.zeros(256, np.int64)
    for sub_image, shown in frame.parts:
        stored = open_map(workspace.reason_map(sub_image), sub_image.stored)[0]
        reasons = stored[shown.slices_in(sub_image.stored)]
        for row in range(0, len(reasons), _ROWS):
            first = first_reasons(np.asarray(reasons[row : row + _ROWS]).astype(np.uint8))
            counts += np.bincount(first.ravel(), minlength=256)
    shares = counts / max(counts.sum(), 1)
    lines = [(_KEPT, f"with depth {shares[0]:.1%}")]
    for reason, colour in zip(Reason, REASON_COLOURS, strict=True):
        lines.append((rgb(colour), f"{reason.name} {shares[reason]:.1%}".lower().replace("_", " ")))
    if left_out := 1 - counts.sum() / frame.rectangle.area:
        lines.append((NOT_CUT_COLOUR, f"not cut ({left_out:.1%} of the photograph)"))
    return lines


# ---- the page


def _arranged(
    name: str, frame: Frame, panels: list[_Panel], legend: list[tuple[tuple[int, int, int], str]]
) -> Picture:
    """The panels in rows of three; the legend takes the last place."""
    larger = max(1, _PANEL // max(frame.shape))  # small sub-images: whole pixels, several times
    height, width = (side * larger for side in frame.shape)
    cell_width = max(width, 360)
    cell_height = max(_TITLE + height, _TITLE + _LINE * (len(legend) + 3)) + _BAR + _LINE + _GAP
    rows = -(-(len(panels) + 1) // _COLUMNS)
    page = np.full(
        (_GAP + rows * cell_height, _GAP + _COLUMNS * (cell_width + _GAP), 3), _PAPER, np.uint8
    )
    texts = []
    for index, panel in enumerate(panels):
        x, y = _corner(index, cell_width, cell_height)
        texts.append(Text(x, y, panel.title, _TEXT, cell_width))
        image = panel.image.repeat(larger, axis=0).repeat(larger, axis=1)
        page[y + _TITLE : y + _TITLE + height, x : x + width] = image
        if panel.bar is not None:
            y += _TITLE + height + 4
            chosen = np.linspace(0, panel.bar.shape[1] - 1, width).round().astype(int)
            page[y : y + _BAR, x : x + width] = panel.bar[0, chosen]
            for mark, words in enumerate(panel.marks):
                share = mark / (len(panel.marks) - 1)
                place = x + round(share * width), y + _BAR + 2
                texts.append(Text(*place, words, _TEXT, cell_width, anchor=share))
    x, y = _corner(len(panels), cell_width, cell_height)
    shown = frame.rectangle
    scale = f", 1 of {frame.factor} pixels" if frame.factor > 1 else ""
    texts.append(Text(x, y, name, _TEXT, cell_width))
    size = f"{shown.width} x {shown.height} pixels from ({shown.x0}, {shown.y0}){scale}"
    texts.append(Text(x, y + _LINE, size, _TEXT, cell_width))
    for line, (colour, words) in enumerate(legend, start=2):
        top = y + line * _LINE + _LINE // 2
        page[top : top + _TEXT, x : x + 2 * _TEXT] = colour
        texts.append(Text(x + 2 * _TEXT + 10, top - 2, words, _TEXT, cell_width - 3 * _TEXT))
    return with_texts(page, texts, _INK)


def _corner(index: int, cell_width: int, cell_height: int) -> tuple[int, int]:
    row, column = divmod(index, _COLUMNS)
    return _GAP + column * (cell_width + _GAP), _GAP + row * cell_height
