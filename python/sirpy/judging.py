"""What the sources say of depths that were found without them, by a network for example.

The surface around every pixel gives its normal; then PatchMatch judges the planes as they are, without a sweep: how
alike the sources look there, how many see it, and how many have found the same depth.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sirpy import _core
from sirpy.filtering import JUDGED_CONFIDENCE
from sirpy.patch_match import PatchMatch
from sirpy.rectangle import Rectangle
from sirpy.stereo_backend import (
    DepthMap,
    DepthRange,
    FloatMap,
    Plane,
    Prior,
    StereoBackend,
    StereoOptions,
    View,
)
from sirpy.workspace import Pass

_RADIUS = 2  # pixels: planes are fitted to windows of 5 x 5
_BAND_PIXELS = 1 << 16  # whose normals are found at a time


class Judge(StereoBackend):
    """The last pass after backends that do not look at the depths of the sources."""

    kind: Pass = "geometric"
    planes: tuple[Plane, ...] = ()
    title: str = "stereo, judged"
    cpu_us: tuple[float, float] = (1.5, 0.3)
    confidence: npt.NDArray[np.float64] = JUDGED_CONFIDENCE

    def __init__(self, options: StereoOptions) -> None:
        self._patch_match = PatchMatch(0, "geometric", 0, options=options)

    @property
    def margin(self) -> int:
        return self._patch_match.margin + 2 * _RADIUS

    def memory(self, reference_pixels: int, source_pixels: int) -> int:
        return self._patch_match.memory(reference_pixels, source_pixels)

    def estimate(
        self, reference: View, sources: Sequence[View], depth_range: DepthRange, prior: Prior
    ) -> DepthMap:
        assert prior.maps is not None  # it follows another pass
        window = reference.window
        depth = prior.maps.read(reference.name, window, "depth")
        start = _core.StartMaps(
            level=0,
            x0=window.x0,
            y0=window.y0,
            depth=depth,
            normal=normals(depth, reference.camera.intrinsics, window),
            views=np.zeros(depth.shape, np.uint32),  # those that it looks best in
        )
        return self._patch_match.run(reference, sources, depth_range.field, prior.points, start)


def normals(depth: FloatMap, intrinsics: npt.NDArray[np.float64], window: Rectangle) -> FloatMap:
    """Normals (3, height, width), camera frame, towards the camera, of a depth map; 0 where it has none.

    The plane that fits the inverse depths of a window of 5 x 5 pixels best, of the nine such windows that
    hold the pixel two pixels off or less: at an edge it is one on the pixel's own side.

    Args:
        depth: (height, width), 0 where there is none.
        intrinsics: (3, 3) of the whole image.
        window: of the map, in pixels of the image.
    """
    height, width = depth.shape
    found = np.zeros((3, height, width), np.float32)
    reach, rows = 2 * _RADIUS, max(1, _BAND_PIXELS // width)
    padded = np.pad(depth, reach)  # what lies outside is missing
    for y in range(0, height, rows):
        end = min(y + rows, height)
        slopes = _slopes(padded[y : end + 2 * reach].astype(np.float64))
        x_of = np.arange(window.x0, window.x1) + 0.5 - intrinsics[0, 2]
        y_of = (np.arange(window.y0 + y, window.y0 + end) + 0.5 - intrinsics[1, 2])[:, None]
        here = depth[y:end]
        inverse = np.divide(1.0, here, out=np.zeros(here.shape), where=here > 0)
        inward = np.stack(
            [
                intrinsics[0, 0] * slopes[0],
                intrinsics[1, 1] * slopes[1],
                inverse - slopes[0] * x_of - slopes[1] * y_of,
            ]
        )
        length = np.linalg.norm(inward, axis=0)
        np.divide(
            -inward,
            length,
            out=found[:, y:end],
            where=(here > 0) & (length > 0),
            casting="same_kind",
        )
    return found


def _slopes(depth: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Of inverse depth in x and y, (2, height, width) without a border of 2 radii."""
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
    inverse -= np.median(inverse)  # squares keep their digits
    missing = _window_sums((depth <= 0).astype(np.float64), None, None)
    side = 2 * _RADIUS + 1
    steps = np.arange(-_RADIUS, _RADIUS + 1, dtype=np.float64)
    moment = side * (steps**2).sum()
    slope_x = _window_sums(inverse, None, steps) / moment
    slope_y = _window_sums(inverse, steps, None) / moment
    mean = _window_sums(inverse, None, None) / side**2
    residual = _window_sums(inverse**2, None, None) - side**2 * mean**2
    residual -= moment * (slope_x**2 + slope_y**2)
    residual[missing > 0] = np.inf
    height, width = (one - 4 * _RADIUS for one in depth.shape)
    best = np.full((height, width), np.inf)
    found = np.zeros((2, height, width))
    # The middle first: it stays where nothing fits better.
    for dy, dx in sorted(np.ndindex(3, 3), key=lambda at: abs(at[0] - 1) + abs(at[1] - 1)):
        at = (
            slice(dy * _RADIUS, dy * _RADIUS + height),
            slice(dx * _RADIUS, dx * _RADIUS + width),
        )
        better = residual[at] < best
        np.copyto(best, residual[at], where=better)
        for slope, into in zip((slope_x, slope_y), found, strict=True):
            np.copyto(into, slope[at], where=better)
    return found


def _window_sums(
    values: npt.NDArray[np.float64],
    weights_y: npt.NDArray[np.float64] | None,
    weights_x: npt.NDArray[np.float64] | None,
) -> npt.NDArray[np.float64]:
    """Weighted sums over windows around each pixel, without the border that has none."""
    for axis, weights in ((0, weights_y), (1, weights_x)):
        length = values.shape[axis] - 2 * _RADIUS
        total = np.zeros_like(values.take(range(length), axis))
        for step in range(2 * _RADIUS + 1):
            part = values[step : step + length] if axis == 0 else values[:, step : step + length]
            total += part if weights is None else weights[step] * part
        values = total
    return values
