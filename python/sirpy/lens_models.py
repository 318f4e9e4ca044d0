"""Camera models of structure from motion: mapping with few parameters, turned into the asked model.

A mapper that adjusts after every photograph is more stable with one focal length and one radial
term than with eight parameters. The simpler models are contained in the others, so turning changes
no projection.
"""

from __future__ import annotations

import numpy as np
import pycolmap

# Asked model: (model of the mapper, places in its parameters that the asked model's begin with).
_CONTAINED: dict[str, tuple[str, tuple[int, ...]]] = {
    "PINHOLE": ("SIMPLE_PINHOLE", (0, 0, 1, 2)),  # f, cx, cy -> f, f, cx, cy
    "RADIAL": ("SIMPLE_RADIAL", (0, 1, 2, 3)),  # f, cx, cy, k -> f, cx, cy, k, 0
    "OPENCV": ("SIMPLE_RADIAL", (0, 0, 1, 2, 3)),  # -> f, f, cx, cy, k, 0, 0, 0
    "FULL_OPENCV": ("SIMPLE_RADIAL", (0, 0, 1, 2, 3)),
}


def mapping_model(asked: str) -> str:
    """The camera model to map with where the model `asked` is to come out."""
    return _CONTAINED[asked][0] if asked in _CONTAINED else asked


def turn_cameras(model: pycolmap.Reconstruction, asked: str) -> None:
    """Turns cameras that were mapped with `mapping_model(asked)` into `asked`; others stay."""
    if asked not in _CONTAINED:
        return
    simple, places = _CONTAINED[asked]
    for camera in model.cameras.values():
        if camera.model_name != simple:
            continue
        parameters = camera.params[list(places)]
        size = (camera.width, camera.height)
        turned = pycolmap.Camera.create_from_model_name(camera.camera_id, asked, 1.0, *size)
        rest = np.zeros(len(turned.params) - len(places))
        camera.model = turned.model
        camera.params = np.concatenate([parameters, rest])
