"""The fused points of a workspace, read by place: memory does not grow with the survey.

Fusion writes the points of neighbouring pixels one after the other, so runs of points are compact; a box around
each run tells which are to be read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sirpy.frame import Floats, Frame
from sirpy.npy import open_npy

POINT = np.dtype(
    [(name, "<f8") for name in ("x", "y", "z")]
    + [(name, "<f4") for name in ("nx", "ny", "nz")]  # unit, towards the camera
    + [(name, "u1") for name in ("red", "green", "blue")]
    + [("views", "u1")]  # that agree
    + [("confidence", "<f4")]  # 0 to 1; 0 where stereo has none
    + [("gsd", "<f4")]  # of the pixel that the point is of, unit of the frame
)
Points = npt.NDArray[np.void]

_RUN = 4096  # points


class Cloud:
    """The points of some parts (.npy of POINT in the model's frame), seen in `frame`.

    Attributes:
        count: of points.
        low, high: (3,), the corners of the box around them; zeros where there are none.
        gsd: the median of the points', roughly; 0 where there are none.
    """

    def __init__(self, parts: Sequence[Path], frame: Frame) -> None:
        """Raises InputError where a part is missing or damaged."""
        self.frame = frame
        self._parts = tuple(parts)
        self._part, self._first, lows, highs, gsds = [], [], [], [], []
        self.count = 0
        for index, part in enumerate(self._parts):
            points = _open(part)
            self.count += len(points)
            for first in range(0, len(points), _RUN):
                run = np.array(points[first : first + _RUN])
                xyz = positions(_moved(run, frame))
                self._part.append(index)
                self._first.append(first)
                lows.append(xyz.min(axis=0))
                highs.append(xyz.max(axis=0))
                gsds.append(float(np.median(run["gsd"])) * frame.scale)
        self._low, self._high = np.array(lows).reshape(-1, 3), np.array(highs).reshape(-1, 3)
        nowhere = np.zeros(3)
        self.low: Floats = self._low.min(axis=0) if lows else nowhere
        self.high: Floats = self._high.max(axis=0) if highs else nowhere
        self.gsd = float(np.median(gsds)) if gsds else 0.0

    def inside(self, x0: float, y0: float, x1: float, y1: float) -> Points:
        """The points (n,) of POINT with x0 <= x < x1 and y0 <= y < y1, in the frame; their order does not
        depend on the rectangle."""
        low, high = self._low, self._high
        touched = (low[:, 0] < x1) & (high[:, 0] >= x0) & (low[:, 1] < y1) & (high[:, 1] >= y0)
        found = [np.empty(0, POINT)]
        for run in np.flatnonzero(touched):
            points = self._run(run)
            x, y = points["x"], points["y"]
            found.append(points[(x >= x0) & (x < x1) & (y >= y0) & (y < y1)])
        return np.concatenate(found)

    def runs(self) -> Iterator[Points]:
        """All points, some thousand at a time, in the frame."""
        for run in range(len(self._part)):
            yield self._run(run)

    def _run(self, run: int) -> Points:
        points = _open(self._parts[self._part[run]])
        first = self._first[run]
        return _moved(np.array(points[first : first + _RUN]), self.frame)


def positions(points: Points) -> Floats:
    """(n, 3) of points."""
    return np.column_stack([points["x"], points["y"], points["z"]])


def _moved(points: Points, frame: Frame) -> Points:
    """Points of the model, in the frame; in place."""
    world = frame.world(positions(points))
    normal = np.column_stack([points["nx"], points["ny"], points["nz"]]) @ frame.rotation.T
    for axis, (place, direction) in enumerate(zip("xyz", ("nx", "ny", "nz"), strict=True)):
        points[place], points[direction] = world[:, axis], normal[:, axis]
    points["gsd"] *= np.float32(frame.scale)
    return points


def _open(part: Path) -> Points:
    return open_npy(part, POINT, (None,), "`sirpy fuse`")
