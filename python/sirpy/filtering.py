"""Filtering: which depths of an estimate are kept, why the others are not, and how sure the kept ones are.

Maps are (height, width), one pixel of a window of a native image each; depth is z in its camera. What becomes
of a pixel depends on the maps within `FilterOptions.margin` of it, and not on where the window ends.

Depths are judged in the unit of the sources: what a pixel of motion in them changes, or a pixel of the photograph on
the surface (depth / focal length), whichever is more.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from enum import IntFlag

import numpy as np
import numpy.typing as npt

from sirpy import _core
from sirpy.errors import InputError
from sirpy.rectangle import Rectangle

FloatMap = npt.NDArray[np.float32]
ByteMap = npt.NDArray[np.uint8]

_COPLANAR_REACH = 4  # pixels (kCoplanarReach in depth_filter.cc)
_PATCH = 8  # pixels from one side of a patch to the other
_AROUND = 7  # pixels: the neighbourhood whose costs and deviations tell of a pixel
_BAND_PIXELS = 1 << 17  # looked at a time, so that the memory is that of the maps

# A depth is right within two units of the sources, or so many standard deviations.
RIGHT_UNITS, RIGHT_DEVIATIONS = 2.0, 2.5

# Log-odds that a depth is right, for one unit of each `evidence`. Fitted by benchmarks/confidence.py.
CONFIDENCE = np.array([-3.798, 0.181, 0.419, -0.869, 3.924, -0.404, 0.050, -1.938, 2.548])
# The same of depths that a network found without a look at those of the sources.
JUDGED_CONFIDENCE = np.array([-3.658, 0.235, 2.411, -2.338, 2.324, -0.512, 0.0, 0.0, 0.0])


class Reason(IntFlag):
    """Why a pixel has no depth; one bit each, 0 for a pixel that has one."""

    NOT_SEEN = 1  # no source window holds its patch
    HIGH_COST = 2  # it looks different in the sources, and too few of them agree all the same
    INCONSISTENT = 4  # too few sources measured the same depth
    NO_SOURCES = 8  # the whole sub-image shares too few sparse points with other photographs
    MASKED = 16  # the photograph's mask is black there
    SPECKLE = 32  # a small island of a depth that no neighbour shares
    GRAZING = 64  # the surface is seen nearly edge-on
    UNSURE = (
        128  # what the estimator says of it and of its neighbours is too often said of wrong depths
    )


@dataclass(frozen=True)
class Estimate:
    """What the estimator says of a window."""

    depth: FloatMap  # 0 where nothing could be compared
    normal: FloatMap  # (3, height, width), camera frame, towards the camera
    cost: FloatMap  # 1 - NCC over the sources used, 0 .. 2
    num_seeing: ByteMap  # sources whose window holds the patch
    num_consistent: ByteMap  # sources whose own depth agrees within a pixel
    texture: FloatMap  # variance of the grey levels in the patch
    sigma: FloatMap  # standard deviation of the depth
    motion: FloatMap  # change of depth by a pixel of motion in the sources; 0 where it is not seen
    level: ByteMap  # of the pixels that the depth comes from

    def units(self, focal: float) -> FloatMap:
        """What the sources resolve: depth, (height, width); `focal` in pixels."""
        units: FloatMap = np.maximum(self.motion, self.depth / np.float32(focal))
        return units


@dataclass(frozen=True)
class FilterOptions:
    """Which depths are kept."""

    max_cost: float = 0.8  # 1 - NCC: pixels above need more sources that agree
    min_consistent: int = 2  # sources whose depth must agree
    # The same for pixels above max_cost: noise decides there, not texture.
    costly_consistent: int = 5
    min_confidence: float = 0.7  # of a depth to be right
    max_deviation: float = 100.0  # standard deviation, in units of the sources
    max_angle: float = 80.0  # degrees between ray and normal
    speckle_pixels: int = 6  # smaller islands are left out; at most the halo
    speckle_consistent: int = 3  # sources that must agree on a pixel of an island all the same
    # Neighbours of an island lie on one plane: pixels' worth of depth, or standard deviations.
    speckle_step: float = 1.5
    speckle_deviations: float = 3.0
    # Standard deviations from one side of a patch to the other, as an angle against its pixels: where normals are
    # less sure, no surface is called grazing.
    max_slope_deviation: float = 0.5

    def __post_init__(self) -> None:
        """Raises InputError for an option out of range."""
        bounds = {
            "max_cost": (0, 2),
            "min_consistent": (0, 32),
            "costly_consistent": (0, 33),
            "min_confidence": (0, 1),
            "max_deviation": (0, float("inf")),
            "max_angle": (1, 90),
            "speckle_pixels": (0, 100_000),
            "speckle_consistent": (0, 33),
            "speckle_step": (0, 1000),
            "speckle_deviations": (0, 1000),
            "max_slope_deviation": (0, 1000),
        }
        check_bounds(self, bounds)

    @property
    def margin(self) -> int:
        """Pixels around a pixel whose estimates have a say in what becomes of it."""
        # Islands are found among what is sure enough, which the neighbourhood decides.
        return self.speckle_pixels + max(_COPLANAR_REACH, _AROUND)


def check_bounds(options: object, bounds: Mapping[str, tuple[float, float]]) -> None:
    """Raises InputError that names the field whose value is out of its bounds."""
    for name, (low, high) in bounds.items():
        value = getattr(options, name)
        if not low <= value <= high:
            raise InputError(f"{name} = {value} is not possible: choose {low} to {high}")


def filter_depths(
    estimate: Estimate,
    intrinsics: npt.NDArray[np.float64],
    window: Rectangle,
    masked: npt.NDArray[np.bool_],
    options: FilterOptions,
    coefficients: npt.NDArray[np.float64] = CONFIDENCE,
) -> tuple[ByteMap, FloatMap]:
    """Why pixels have no depth (`Reason`, 0 where they have one), and the confidence of those that have.

    Args:
        intrinsics: (3, 3) of the whole native image.
        window: of the estimate, in native pixels.
        masked: (height, width), True where the photograph is not to be used.
        coefficients: of the confidence.

    Returns:
        reason; confidence: probability (0 .. 1) that a depth is right within RIGHT_UNITS units of the
        sources or RIGHT_DEVIATIONS standard deviations; 0 where there is none.
    """
    shape = estimate.depth.shape
    reason = np.zeros(shape, np.uint8)
    confidence = np.zeros(shape, np.float32)
    around = neighbourhood(estimate, intrinsics, window)
    for rows in _bands(shape):
        part = _rows_of(estimate, rows)
        cosine = cosines(part.normal, intrinsics, _rows_of_window(window, rows))
        sure = _slope_deviation(part, intrinsics[0, 0]) <= options.max_slope_deviation
        reason[rows] = _reasons(part, cosine, sure, masked[rows], options)
        evidences = evidence(part, intrinsics[0, 0], tuple(one[rows] for one in around))
        confidence[rows] = probability(evidences, coefficients)
    unsure = confidence < options.min_confidence
    unsure |= estimate.sigma > options.max_deviation * estimate.units(intrinsics[0, 0])
    reason |= unsure * np.uint8(Reason.UNSURE)
    kept = np.where(reason == 0, estimate.depth, np.float32(0))
    speckle = _core.find_speckles(
        kept,
        estimate.normal,
        estimate.sigma,
        intrinsics=intrinsics,
        x0=window.x0,
        y0=window.y0,
        step=options.speckle_step,
        deviations=options.speckle_deviations,
        min_pixels=options.speckle_pixels,
    )
    unsure = estimate.num_consistent < options.speckle_consistent
    reason |= (speckle & unsure) * np.uint8(Reason.SPECKLE)
    confidence[reason != 0] = 0
    return reason, confidence


def _reasons(
    estimate: Estimate,
    cosine: FloatMap,
    sure: npt.NDArray[np.bool_],
    masked: npt.NDArray[np.bool_],
    options: FilterOptions,
) -> ByteMap:
    """Everything but speckles, which are found among what is left."""
    agreeing = estimate.num_consistent
    needed = np.minimum(estimate.num_seeing, options.min_consistent)
    not_seen = (estimate.num_seeing == 0) | ~(estimate.depth > 0)
    reasons = {
        Reason.NOT_SEEN: not_seen,
        Reason.HIGH_COST: (estimate.cost > options.max_cost)
        & (agreeing < options.costly_consistent),
        Reason.INCONSISTENT: agreeing < needed,
        Reason.MASKED: masked,
        Reason.GRAZING: ~not_seen & sure & (cosine < np.cos(np.radians(options.max_angle))),
    }
    found = np.zeros(masked.shape, np.uint8)
    for reason, hit in reasons.items():
        found |= hit * np.uint8(reason)
    return found


def _slope_deviation(estimate: Estimate, focal: float) -> FloatMap:
    """Standard deviation of a patch's slope: how far its sides may differ in depth, by the pixels between them."""
    size = _PATCH * estimate.depth / np.float32(focal)
    slope: FloatMap = estimate.sigma / np.maximum(size, np.float32(1e-30))
    return slope


def first_reasons(reason: ByteMap) -> ByteMap:
    """Of each pixel the first of its reasons; 0 where there is none."""
    first: ByteMap = reason & (~reason + np.uint8(1))
    return first


def cosines(normal: FloatMap, intrinsics: npt.NDArray[np.float64], window: Rectangle) -> FloatMap:
    """Cosines of the angles between the normals (3 planes) and the rays back to the camera."""
    x = (np.arange(window.x0, window.x1) + 0.5 - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (np.arange(window.y0, window.y1) + 0.5 - intrinsics[1, 2])[:, None] / intrinsics[1, 1]
    along = -(normal[0] * x + normal[1] * y + normal[2])
    cosine: FloatMap = (along / np.sqrt(x * x + y * y + 1)).astype(np.float32)
    return cosine


def coplanar_shares(
    estimate: Estimate, intrinsics: npt.NDArray[np.float64], window: Rectangle
) -> FloatMap:
    """Share of the pixels around each that lie on its plane (cpp/src/depth_filter.h)."""
    return _core.coplanar_shares(
        estimate.depth,
        estimate.normal,
        estimate.sigma,
        intrinsics=intrinsics,
        x0=window.x0,
        y0=window.y0,
    )


Neighbourhood = tuple[
    FloatMap, ...
]  # shares of coplanar pixels, means of log deviations and of costs


def neighbourhood(
    estimate: Estimate, intrinsics: npt.NDArray[np.float64], window: Rectangle
) -> Neighbourhood:
    """What the maps around a pixel say of it."""
    return (
        coplanar_shares(estimate, intrinsics, window),
        _core.box_means(_log_deviation(estimate, intrinsics[0, 0]), _AROUND),
        _core.box_means(np.clip(estimate.cost, 0, 2), _AROUND),
    )


def _log_deviation(estimate: Estimate, focal: float) -> FloatMap:
    """Logarithm of the standard deviation in units of the sources at the level that the depth comes from, so that it
    counts as in photographs that are decimated to that level; of what is not seen that of 20 units."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = estimate.sigma / np.ldexp(estimate.units(focal), estimate.level.astype(np.int32))
    seen = (estimate.depth > 0) & (ratio > 0)
    logarithm: FloatMap = np.log(np.clip(np.where(seen, ratio, np.float32(20)), 0.05, 20))
    return logarithm.astype(np.float32, copy=False)


def evidence(estimate: Estimate, focal: float, around: Neighbourhood) -> npt.NDArray[np.float32]:
    """What the confidence is made of, (9, height, width); the first plane is 1."""
    coplanar, deviations, costs = around
    agreeing = estimate.num_consistent.astype(np.float32)
    return np.stack(
        [
            np.ones_like(agreeing),
            agreeing,
            agreeing / np.maximum(estimate.num_seeing, 1),
            np.log(np.clip(estimate.cost, 0, 2) + 0.01),
            coplanar,  # most wrong depths lie near edges of other depths
            np.log1p(estimate.texture),  # and these have contrast
            _log_deviation(estimate, focal),
            deviations,
            costs,
        ]
    ).astype(np.float32)


def probability(
    evidences: npt.NDArray[np.float32], coefficients: npt.NDArray[np.float64] = CONFIDENCE
) -> FloatMap:
    """The logistic model: (height, width), or whatever follows the first axis of `evidences`."""
    odds = np.zeros(evidences.shape[1:], np.float64)
    for coefficient, plane in zip(coefficients, evidences, strict=True):
        odds += coefficient * plane
    likely: FloatMap = (1 / (1 + np.exp(-odds))).astype(np.float32)
    return likely


def _bands(shape: tuple[int, ...]) -> Iterator[slice]:
    rows = max(1, _BAND_PIXELS // max(shape[1], 1))
    for first in range(0, shape[0], rows):
        yield slice(first, min(first + rows, shape[0]))


def _rows_of(estimate: Estimate, rows: slice) -> Estimate:
    return Estimate(
        **{one.name: getattr(estimate, one.name)[..., rows, :] for one in fields(estimate)}
    )


def _rows_of_window(window: Rectangle, rows: slice) -> Rectangle:
    return Rectangle(window.x0, window.y0 + rows.start, window.width, rows.stop - rows.start)
