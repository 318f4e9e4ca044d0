"""One photograph, and the cloud as it would see it: drawn by bands, compared by strips, so that memory is bounded
whatever the cloud."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sirpy.common_ground import CommonGround
from sirpy.cut_tasks import CutInputs
from sirpy.errors import BudgetError
from sirpy.judged_cloud import JudgedCloud
from sirpy.memory import gigabytes
from sirpy.photographs import Photograph, recapture_to_array, white_level
from sirpy.posed_camera import PosedCamera
from sirpy.rectangle import Rectangle
from sirpy.rephotograph_score import THRESHOLDS, RephotographOptions, Score
from sirpy.rephotography import (
    MARGIN,
    Grey,
    Mask,
    comparable,
    draw,
    luma,
    ncc,
    shrunk,
    shrunk_buffer,
)

_STRIP = 64  # rows that are compared at once
_PROCESS = 0.4e9  # bytes of an interpreter with pycolmap, and of the points that are drawn at once
_HELD = 16  # bytes of a shrunk pixel, while the photograph is judged
_COMPARED = 80  # bytes of a shrunk pixel of a strip
_DRAWN = 13  # bytes of a native pixel of a band
_SHRUNK = 24  # bytes of a shrunk pixel of a band
_LEAST_BAND = 32  # shrunk rows


@dataclass(frozen=True)
class Rephotograph:
    """The judged part of a shrunk photograph, all (height, width): luma of photograph and cloud, which pixels show
    points, which are judged, which of these have texture, and the NCC of all (-1 to 1)."""

    photograph: Grey
    cloud: Grey
    covered: Mask
    judged: Mask
    compared: Mask
    ncc: Grey
    score: Score


def rephotograph(
    view: PosedCamera,
    inputs: CutInputs,
    cloud: JudgedCloud,
    ground: CommonGround,
    options: RephotographOptions,
    memory: int,
) -> Rephotograph | None:
    """Draws the cloud into a photograph and compares them; None where no pixel is to be judged.

    Raises:
        InputError: photograph, mask or cloud cannot be read.
        BudgetError: it does not fit into `memory` (bytes).
    """
    photograph = inputs.photograph(view.name, view.camera)
    mask = inputs.mask(view.name, view.camera)
    window = ground.window(options.shrink, MARGIN)
    if window.area == 0:
        return None
    taken, drawn = (np.zeros((window.height, window.width), np.float32) for _ in range(2))
    covered, judged = np.zeros(taken.shape, bool), ground.at(window, options.shrink)
    for band in _bands(window, _band_rows(photograph, window, options.shrink, memory)):
        rows, native = band.slices_in(window)[0], _native(band, options.shrink)
        buffer = draw(view, cloud.points, native, options.radius)
        drawn[rows], covered[rows] = shrunk_buffer(buffer, options.shrink)
        del buffer  # before the photograph is read
        taken[rows] = shrunk(luma(_read(photograph, native)), options.shrink)
        if mask is not None:
            usable = np.asarray(_read(mask, native).any(axis=2), np.float32)
            judged[rows] &= shrunk(usable, options.shrink) == 1
    taken *= np.float32(255 / white_level(photograph))
    return _compared(taken, drawn, covered, judged)


def _read(photograph: Photograph, rectangle: Rectangle) -> NDArray[Any]:
    """(height, width, channels), as stored."""
    size = photograph.width, photograph.height
    return recapture_to_array(photograph, None, size, rectangle)


def _native(shrunk: Rectangle, factor: int) -> Rectangle:
    return Rectangle(*(factor * side for side in shrunk.as_tuple()))


def _bands(window: Rectangle, rows: int) -> Iterator[Rectangle]:
    for y0 in range(window.y0, window.y1, rows):
        yield Rectangle.from_corners(window.x0, y0, window.x1, min(y0 + rows, window.y1))


def _band_rows(photograph: Photograph, window: Rectangle, shrink: int, memory: int) -> int:
    """Shrunk rows that are drawn at once: each band costs two passages through the cloud."""
    held = (
        _PROCESS + photograph.held_bytes + _HELD * window.area + _COMPARED * _STRIP * window.width
    )
    row = (_DRAWN * shrink**2 + _SHRUNK) * window.width
    rows = int((memory - held) // row)
    least = min(_LEAST_BAND, window.height)
    if rows < least:
        raise BudgetError(
            f"judging {photograph.path.name} needs {gigabytes(held + least * row)}, more than --memory "
            f"allows ({gigabytes(memory)}): allow more, or choose a larger --shrink"
        )
    return min(rows, window.height)


def _compared(taken: Grey, drawn: Grey, covered: Mask, judged: Mask) -> Rephotograph:
    """By strips of rows, so that what is needed for it does not grow with the photograph."""
    alike, compared = np.empty_like(taken), np.empty_like(judged)
    height = len(taken)
    for begin in range(0, height, _STRIP):
        rows = slice(begin, min(begin + _STRIP, height))
        around = slice(max(0, begin - MARGIN), min(height, rows.stop + MARGIN))
        inner = slice(begin - around.start, rows.stop - around.start)
        alike[rows] = ncc(drawn[around], taken[around], covered[around])[inner]
        compared[rows] = judged[rows] & comparable(taken[around])[inner]
    score = Score(
        int(judged.sum()),
        int((judged & covered).sum()),
        int(compared.sum()),
        tuple(int((compared & (alike >= least)).sum()) for least in THRESHOLDS),
    )
    return Rephotograph(taken, drawn, covered, judged, compared, alike, score)
