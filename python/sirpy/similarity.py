"""The similarity that takes points of a model to where they are known to lie, some of them perhaps wrong.

Least median of squares over triples of points (Rousseeuw 1984) finds what the majority says, however wrong the
others are; Gauss-Newton on the points that agree gives their weighted least squares. The direction that is up
in the model counts as one more measurement, good to 3 degrees: beside good points that lie apart it has no say, and
it holds the turn about the line where all of them lie on one.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sirpy.frame import Floats, Frame

FEWEST = 3  # points

_TRIPLES = 1000
_TURN_OF_TRIPLES = 1e-12  # weight of the up direction beside a triple's, for those on one line
_UP_SIGMA = math.radians(3)
_MEDIAN_OF_SIGMA = 1.538  # the median length of a vector in 3D whose components have a sigma of 1
_GATE = 5.0  # sigma
_EXACT = 1e-5  # of the extent of the points: nothing is known better
_ROUNDS = 50


@dataclass(frozen=True, eq=False)
class Similarity:
    """`frame`, without a CRS, takes the model to the world.

    Attributes:
        residuals: (n, 3), where the similarity puts the points less where they are known to lie.
        used: (n,), which points agree.
        turn_sigma: degrees; how badly the points alone know the turn that they know worst.
    """

    frame: Frame
    residuals: Floats
    used: npt.NDArray[np.bool_]
    turn_sigma: float


def robust_similarity(
    model: Floats,
    world: Floats,
    *,
    up: Floats,
    covariances: Floats | None = None,
    max_residual: float | None = None,
) -> Similarity:
    """The similarity that most of the points agree on.

    Args:
        model, world: (n, 3), at least three, not all at one place.
        up: (3,), unit; of the model.
        covariances: (n, 3, 3), of the residuals, world unit squared; without, equal and unknown.
        max_residual: points further off are not used, world unit; without, those beyond five sigma of what
            the points themselves show.
    """
    origin, centre = np.median(model, axis=0), np.median(world, axis=0)
    x, y = model - origin, world - centre
    far = np.linalg.norm(y, axis=1)
    extent = float(np.median(far)) or float(far.max())  # whatever the outliers are
    exact = _EXACT * extent
    if covariances is None:
        white, least = np.broadcast_to(np.eye(3), (len(x), 3, 3)), exact
    else:
        known = covariances + exact**2 * np.eye(3)
        white, least = np.linalg.inv(np.linalg.cholesky(known)), 1.0
    frame = _best_of_triples(x, y, white, up)
    used = np.ones(len(x), bool)
    for _ in range(_ROUNDS):
        residuals = frame.world(x) - y
        lengths = _lengths(white, residuals)
        sigma = max(_robust_sigma(lengths), least)
        agree = lengths <= _GATE * sigma
        if max_residual is not None:
            agree = np.linalg.norm(residuals, axis=1) <= max_residual
        if agree.sum() < FEWEST:  # of so few the best say which
            agree = lengths <= np.sort(lengths)[FEWEST - 1]
        step, normal = _step(frame, x[agree], y[agree], white[agree] / sigma, up)
        frame = _moved(frame, step)
        settled = np.abs(step * [1, 1, 1, 1, *[1 / extent] * 3]).max() < 1e-12
        if settled and (agree == used).all():
            break
        used = agree
    shift = centre + frame.translation - frame.scale * frame.rotation @ origin
    return Similarity(
        Frame(None, frame.scale, frame.rotation, shift),
        frame.world(x) - y,
        used,
        _turn_sigma(normal),
    )


def _lengths(white: Floats, residuals: Floats) -> Floats:
    """(n,), in sigma."""
    lengths: Floats = np.linalg.norm(np.einsum("nij,nj->ni", white, residuals), axis=1)
    return lengths


def _robust_sigma(lengths: Floats) -> float:
    """Of one component, from the lengths (n,) of residuals; few points fit better than they are."""
    few = 1 + 5 / (len(lengths) - 2)
    return float(np.median(lengths)) / _MEDIAN_OF_SIGMA * few


def _best_of_triples(x: Floats, y: Floats, white: Floats, up: Floats) -> Frame:
    """The similarity of three points that has the least median of residuals."""
    triples = np.array(_triples(len(x)))
    a, b = x[triples], y[triples]
    a_mean, b_mean = a.mean(axis=1, keepdims=True), b.mean(axis=1, keepdims=True)
    a, b = a - a_mean, b - b_mean
    a_size, b_size = (np.sqrt((one**2).sum(axis=(1, 2))) for one in (a, b))
    apart = (a_size > _EXACT * np.median(a_size)) & (b_size > _EXACT * np.median(b_size))
    a, b, a_size, b_size = a[apart], b[apart], a_size[apart], b_size[apart]
    # Wahba's problem, by singular values (Markley 1988): the points, and that up is z.
    spread = np.einsum("mni,mnj->mij", b, a) / (a_size * b_size)[:, None, None]
    left, _, right = np.linalg.svd(spread + _TURN_OF_TRIPLES * np.outer([0, 0, 1], up))
    left[:, :, 2] *= np.sign(np.linalg.det(left) * np.linalg.det(right))[:, None]
    rotation = left @ right
    scale = b_size / a_size
    moved = scale[:, None, None] * (a_mean[apart] @ np.swapaxes(rotation, 1, 2))
    shift = (b_mean[apart] - moved)[:, 0]
    medians = [
        np.median(_lengths(white, s * (x @ r.T) + t - y))
        for s, r, t in zip(scale, rotation, shift, strict=True)
    ]
    best = int(np.argmin(medians))
    return Frame(None, float(scale[best]), rotation[best], shift[best])


def _triples(count: int) -> list[tuple[int, ...]]:
    """All of them where they are few, else some at random, the same at every call."""
    if math.comb(count, 3) <= _TRIPLES:
        return list(itertools.combinations(range(count), 3))
    random = np.random.default_rng(0)
    return [tuple(random.choice(count, 3, replace=False)) for _ in range(_TRIPLES)]


def _step(frame: Frame, x: Floats, y: Floats, white: Floats, up: Floats) -> tuple[Floats, Floats]:
    """A step of Gauss-Newton, (log of the scale, turn (3), shift (3)), and the normal matrix (7, 7) of the
    points alone; `white` (n, 3, 3) makes the residuals' components independent, with a sigma of 1."""
    turned = frame.scale * (x @ frame.rotation.T)
    of_point = np.empty((len(x), 3, 7))
    of_point[:, :, 0], of_point[:, :, 1:4], of_point[:, :, 4:] = turned, -_cross(turned), np.eye(3)
    jacobian = (white @ of_point).reshape(-1, 7)
    residual = np.einsum("nij,nj->ni", white, turned + frame.translation - y).reshape(-1)
    normal, gradient = jacobian.T @ jacobian, jacobian.T @ residual
    now = frame.rotation @ up
    turn = -_cross(now[None])[0] / _UP_SIGMA
    both = normal.copy()
    both[1:4, 1:4] += turn.T @ turn
    gradient[1:4] += turn.T @ ((now - [0, 0, 1]) / _UP_SIGMA)
    size = np.sqrt(np.diag(both))  # the unknowns have different units
    step = -np.linalg.lstsq(both / np.outer(size, size), gradient / size, rcond=1e-14)[0] / size
    return step, normal


def _moved(frame: Frame, step: Floats) -> Frame:
    angle = float(np.linalg.norm(step[1:4]))
    axis = _cross(step[None, 1:4] / max(angle, 1e-300))[0]
    turn = np.eye(3) + math.sin(angle) * axis + (1 - math.cos(angle)) * axis @ axis
    left, _, right = np.linalg.svd(turn @ frame.rotation)
    return Frame(None, frame.scale * math.exp(step[0]), left @ right, frame.translation + step[4:])


def _turn_sigma(normal: Floats) -> float:
    """Degrees, of the turn that the points know worst, whatever scale and shift are."""
    others = [0, 4, 5, 6]
    mixed = normal[1:4][:, others]
    turns = normal[1:4, 1:4] - mixed @ np.linalg.pinv(normal[np.ix_(others, others)]) @ mixed.T
    least = float(np.linalg.eigvalsh(turns)[0])
    return math.degrees(1 / math.sqrt(least)) if least > 0 else 180.0


def _cross(vectors: Floats) -> Floats:
    """(n, 3, 3) that take w to the vector product of each vector (n, 3) and w."""
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
