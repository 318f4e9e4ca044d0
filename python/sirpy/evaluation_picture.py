"""Photograph, cloud and their likeness side by side, so that holes and where they lie show at a glance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sirpy.pictures import Text, with_texts
from sirpy.rephotograph import Rephotograph
from sirpy.rephotograph_score import THRESHOLDS, Score
from sirpy.rephotography import Grey, shrunk

Picture = NDArray[np.uint8]

_PANEL = 1600  # longest side, pixels
_LEAST_PANEL = 800  # small photographs are shown at whole multiples
_GAP, _TITLE, _TEXT = 12, 30, 18
_PAPER, _INK = (250, 250, 248), (28, 31, 36)
_HOLE = (255, 0, 200)  # as no photograph is
_LIKENESS = {0.0: (178, 24, 43), 0.6: (253, 219, 119), 1.0: (26, 152, 80)}  # by NCC
_DIMMED = np.float32(0.35)  # brightness of what is not judged


def side_by_side(name: str, seen: Rephotograph) -> Picture:
    """RGB (height, width, 3): the part of the photograph that is judged, the cloud, and their NCC."""
    factor = -(-max(seen.photograph.shape) // _PANEL)

    def mean(image: NDArray[np.generic]) -> Grey:
        return shrunk(image.astype(np.float32), factor)[..., None]

    photograph, judged = mean(seen.photograph), mean(seen.judged)
    # Holes first: of a pixel of the picture, each part shows in its share.
    hole = mean(~seen.covered) * _HOLE
    cloud = mean(np.where(seen.covered, seen.cloud, 0)) + hole
    compared = seen.compared & seen.covered
    share = mean(compared)
    likeness = _colours(mean(np.where(compared, seen.ncc, 0)) / np.maximum(share, 1e-6))
    flat = np.maximum(mean(seen.covered) - share, 0)
    alike = share * likeness + flat * photograph + hole
    dimmed = (1 - judged) * _DIMMED * photograph
    panels = [
        np.broadcast_to(photograph, cloud.shape),
        judged * cloud + dimmed,
        judged * alike + dimmed,
    ]
    larger = max(1, _LEAST_PANEL // max(photograph.shape))
    panels = [one.repeat(larger, axis=0).repeat(larger, axis=1) for one in panels]
    return _arranged(_titles(name, seen.score), panels)


def _colours(ncc: Grey) -> Grey:
    """(height, width, 3) of (height, width, 1)."""
    steps, colours = list(_LIKENESS), np.array([*_LIKENESS.values()], np.float32)
    channels = [np.interp(ncc[..., 0], steps, colours[:, i]) for i in range(3)]
    return np.stack(channels, axis=-1).astype(np.float32)


def _titles(name: str, score: Score) -> list[str]:
    shares = {
        key: "-" if share is None else f"{share:.1%}" for key, share in score.shares().items()
    }
    right = ", ".join(f"{shares[f'right_{least}']} at {least:g}" for least in THRESHOLDS)
    return [
        name,
        f"cloud: covered {shares['covered']}, holes pink",
        f"right {right} (NCC, red 0 to green 1)",
    ]


def _arranged(titles: list[str], panels: list[Grey]) -> Picture:
    height, width = panels[0].shape[:2]
    page = np.full((_TITLE + height, len(panels) * (width + _GAP) - _GAP, 3), _PAPER, np.uint8)
    texts = []
    for index, (title, panel) in enumerate(zip(titles, panels, strict=True)):
        left = index * (width + _GAP)
        page[_TITLE:, left : left + width] = np.clip(panel + 0.5, 0, 255).astype(np.uint8)
        texts.append(Text(left + 4, 5, title, _TEXT, width - 8))
    return with_texts(page, texts, _INK)
