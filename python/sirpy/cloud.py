"""The fused points of a workspace, read by place: memory does not grow with the survey.

Fusion writes the points of neighbouring pixels one after the other, so runs of points are compact; a box around
each run tells which are to be read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sirpy.files import written_whole
from sirpy.frame import Floats, Frame, rotated
from sirpy.npy import open_npy

# As FusedPoint of cpp/src/fusion.h.
POINT = np.dtype(
    [(name, "<f8") for name in ("x", "y", "z")]
    + [(name, "<f4") for name in ("nx", "ny", "nz")]  # unit, towards the camera
    + [(name, "u1") for name in ("red", "green", "blue")]
    + [("views", "u1")]  # that agree
    + [("confidence", "<f4")]  # 0 to 1; 0 where stereo has none
    + [("gsd", "<f4")]  # of the pixel that the point is of, unit of the frame
    # Standard deviation along the ray, unit of the frame; 0 where stereo has none.
    + [("sigma", "<f4")]
    + [("level", "<i4")]  # of the pyramid whose pixels gave the depth: 2^level native pixels each
)
Points = npt.NDArray[np.void]

_RUN = 4096  # points
_AT_ONCE = 1 << 18  # points that are copied


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
                gsds.append(float(np.median(run["gsd"])))
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


def write_ply(path: Path, parts: Sequence[Path], frame: Frame) -> int:
    """Writes the points of all parts as one binary PLY file, all their fields; returns their number.

    Raises:
        InputError: a part is missing or damaged.
        OutputError: the cloud cannot be written.
    """
    # One part is open at a time: there may be more of them than a process may open files.
    count = sum(len(_open(part)) for part in parts)
    kind = {"<f8": "double", "<f4": "float", "|u1": "uchar", "<i4": "int"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    header += [f"property {kind[POINT[name].str]} {name}" for name in POINT.names or ()]
    with written_whole(path) as temporary, temporary.open("wb") as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii"))
        for part in parts:
            for first in range(0, len(_open(part)), _AT_ONCE):
                # Mapped anew: what has been read counts as memory while it is mapped.
                some = _open(part)[first : first + _AT_ONCE]
                file.write((some if frame.is_model else _moved(np.array(some), frame)).data)
    return count


def positions(points: Points) -> Floats:
    """(n, 3) of points."""
    return np.column_stack([points["x"], points["y"], points["z"]])


def _moved(points: Points, frame: Frame) -> Points:
    """Points of the model, in the frame; in place."""
    if frame.is_model:
        return points
    world = frame.world(positions(points))
    normal = rotated(np.column_stack([points["nx"], points["ny"], points["nz"]]), frame.rotation)
    for axis, (place, direction) in enumerate(zip("xyz", ("nx", "ny", "nz"), strict=True)):
        points[place], points[direction] = world[:, axis], normal[:, axis]
    for name in ("gsd", "sigma"):
        points[name] *= np.float32(frame.scale)
    return points


def _open(part: Path) -> Points:
    return open_npy(part, POINT, (None,), "`sirpy fuse`")
