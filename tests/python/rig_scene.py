"""Photographs of a rig of two cameras over bumpy ground, with exact poses.

The reference looks down; the other, in `oblique/`, is tilted by 20 degrees and 0.4 units away.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from bumpy_ground import photograph, write_jpeg
from numpy.typing import NDArray

_ANGLE = np.radians(20.0)
_DOWN = np.diag([1.0, -1.0, -1.0])  # cam_from_world: x east, y south
OBLIQUE_FROM_RIG = np.array(
    [
        [1, 0, 0],
        [0, np.cos(_ANGLE), np.sin(_ANGLE)],
        [0, -np.sin(_ANGLE), np.cos(_ANGLE)],
    ]
)
TRANSLATION = np.array([-0.4, 0.0, 0.0])  # of oblique_from_rig
QUATERNION = [np.cos(_ANGLE / 2), -np.sin(_ANGLE / 2), 0.0, 0.0]  # w, x, y, z


def write_rig_photographs(folder: Path, exposures: int) -> dict[str, NDArray[np.float64]]:
    """Writes nadir/I.jpg and oblique/I.jpg; returns their centres by name."""
    random = np.random.default_rng(4)
    centres = {}
    for index, s in enumerate(np.linspace(-1, 1, exposures)):
        turn = random.normal(0, 0.05, 3)
        rotation = _turned(turn) @ _DOWN
        centre = np.array([2.0 * s, 0.5 * s**2, 10 + 0.4 * s])
        centres[f"nadir/{index}.jpg"] = centre
        write_jpeg(folder / f"nadir/{index}.jpg", photograph(centre, rotation))
        oblique = OBLIQUE_FROM_RIG @ rotation
        # x_cam = oblique (x - centre) + TRANSLATION
        of_oblique = centre - oblique.T @ TRANSLATION
        centres[f"oblique/{index}.jpg"] = of_oblique
        write_jpeg(folder / f"oblique/{index}.jpg", photograph(of_oblique, oblique))
    return centres


def write_rig_file(path: Path, *, posed: bool) -> Path:
    oblique: dict[str, object] = {"image_prefix": "oblique/"}
    if posed:
        oblique["cam_from_rig_rotation"] = QUATERNION
        oblique["cam_from_rig_translation"] = TRANSLATION.tolist()
    reference = {"image_prefix": "nadir/", "ref_sensor": True}
    path.write_text(json.dumps([{"cameras": [reference, oblique]}]), encoding="utf-8")
    return path


def _turned(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """3 x 3 rotation by small angles about x, y and z."""
    x, y, z = angles
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    u, _, vt = np.linalg.svd(np.eye(3) + skew)
    return np.asarray(u @ vt)
