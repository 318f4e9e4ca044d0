"""Between which depths stereo searches: everywhere at first, then around what the coarse passes have found.

Sparse points lie on the ground and on facades, and hardly ever on canopies, roofs and towers. So the passes over
whole photographs search all that the scene can hold, which is cheap there; the finer ones, of sub-images, what
these have found in and around each block, and what the sparse points expect.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sirpy.errors import InputError
from sirpy.native_scene import Observations
from sirpy.view_fields import ViewField

FloatMap = npt.NDArray[np.float32]

_NEAREST = (
    0.25  # of the depths of the sparse points: what stands three quarters of the flying height tall
)
_FARTHEST = 2.0
_PERCENTILES = (2.0, 98.0)  # of the depths of the sparse points
_FOUND_PERCENTILES = (0.3, 99.7)  # of the inverse depths that are found in a block
_MARGIN = 0.15  # of the range of inverse depths that are found
_LEAST_MARGIN = 0.01  # of the inverse depth
_FEWEST_FOUND = 8  # pixels of the coarse pass that tell a range


def whole_range(seen: Observations) -> tuple[float, float]:
    """Nearest and farthest depth that a photograph can see at all."""
    low, high = np.percentile(seen.depth, _PERCENTILES)
    return float(_NEAREST * low), float(_FARTHEST * high)


def searched_everywhere(
    field: ViewField, seen: Observations, limits: tuple[float | None, float | None] = (None, None)
) -> ViewField:
    """A field with the range of the whole scene in every block that has a source.

    Args:
        seen: of the native image.
        limits: nearest and farthest depth that a user knows; None where it is not known.

    Raises:
        InputError: the limits leave nothing.
    """
    if not field.sources:
        return field
    near, far = whole_range(seen)
    near, far = limits[0] or near, limits[1] or far
    if near >= far:
        raise InputError(
            f"depths from {near:g} to {far:g} are nothing that {field.name} can see: check --min-depth and "
            "--max-depth, in the unit of the model"
        )
    known = field.allowed != 0
    return replace(
        field,
        min_depth=np.where(known, np.float32(near), field.min_depth),
        max_depth=np.where(known, np.float32(far), field.max_depth),
    )


def searched_around(
    field: ViewField, depth: FloatMap, sure: npt.NDArray[np.bool_], level: int
) -> ViewField:
    """A field with the depths that a pass over the whole photograph has found in and around each block.

    Args:
        field: with the depths that sparse points expect, which stay within the range.
        depth: (height, width) of the level, from the corner of the native image.
        sure: where sources agree with it.
    """
    rows, columns = field.allowed.shape
    side = field.side >> level
    found = np.full((rows + 2, columns + 2, 2), (np.inf, -np.inf))
    for row, column in np.ndindex(rows, columns):
        part = np.s_[row * side : (row + 1) * side, column * side : (column + 1) * side]
        inverse = 1 / depth[part][sure[part] & (depth[part] > 0)]
        if inverse.size >= _FEWEST_FOUND:
            found[row + 1, column + 1] = np.percentile(inverse, _FOUND_PERCENTILES)
    nearest, farthest = field.min_depth.copy(), field.max_depth.copy()
    for row, column in np.argwhere(field.allowed != 0):
        around = found[row : row + 3, column : column + 3]
        low, high = around[..., 0].min(), around[..., 1].max()
        if low <= high:
            margin = max(_MARGIN * (high - low), _LEAST_MARGIN * (low + high) / 2)
            nearest[row, column] = min(nearest[row, column], 1 / (high + margin))
            farthest[row, column] = max(farthest[row, column], 1 / max(low - margin, low / 2))
    return replace(field, min_depth=nearest, max_depth=farthest)
