"""Bundle adjustment of a sparse model whose observations each have a covariance, by Ceres.

One camera and one pose per native image; of a rig one pose per frame and one per sensor. The loss (Cauchy's) is
as wide as the residuals themselves say: it narrows as the cameras get better, so that rough cameras do not
make outliers of good observations, nor covariances that are too small.

Memory: about 1 kB per observation. One thread: Ceres sums in another order on several, and the same input
gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pycolmap
from numpy.typing import NDArray

from sirpy.adjustment_arrays import (
    Floats,
    Network,
    Unknowns,
    moved_back,
    read_network,
    with_unknowns,
)
from sirpy.errors import InputError, SirpyError

if TYPE_CHECKING:
    from sirpy import _adjustment

LOSS_SCALE = 3.0
# How far principal points are from where the given cameras have them, relative to the longest side of the
# photograph. Convergent views determine them to a hundredth of that; in a strip of nadir ones, where they trade
# against the poses, they stay.
EXPECTED_SHIFT = 1e-2
FEWEST_POSITIONS = 3

_ROUNDS = 5
_SETTLED = 1.2  # the loss is as wide as the residuals, within this factor
_EXACT = 1e-3  # sigma0 below it is that of observations without noise
_GATE = 4.0  # sigma0: observations beyond it do not count in sigma0
_MEDIAN = 2 * np.log(2)  # of the squared length of a whitened residual


@dataclass(frozen=True)
class Intrinsics:
    """Which parameters of the lenses are free.

    A free principal point is expected where it was, within EXPECTED_SHIFT of the longest side: it goes where the
    observations determine it.
    """

    focal_length: bool = True
    principal_point: bool = True
    extra_params: bool = True


@dataclass(frozen=True)
class Adjustment:
    """An adjusted model and how well the observations fit it.

    Attributes:
        model: a copy; points that are seen less than twice are not in it.
        residuals: (num_points2D, 2) by image id: observed less projected, px; NaN where no point of
            the adjusted model is seen.
        sigma0: standard deviation of the whitened residuals, from the observations within 4 of it and their
            redundancy: 1 where the covariances are right. NaN without redundancy.
        intrinsic_deviations: (params,) by camera id: standard deviations, 0 of what was not free; None
            where the observations do not determine them, and where there are more than some 480 frames.
    """

    model: pycolmap.Reconstruction
    residuals: dict[int, Floats]
    sigma0: float
    intrinsic_deviations: dict[int, Floats | None]


def bundle_adjust(
    model: pycolmap.Reconstruction,
    covariances: Mapping[int, Floats],
    *,
    refine: Intrinsics | None = None,
    expected: pycolmap.Reconstruction | None = None,
    loss_scale: float = LOSS_SCALE,
    positions: Mapping[str, tuple[Floats, Floats]] | None = None,
) -> Adjustment:
    """Adjusts poses, lenses and points to the points2D that see a point.

    The result is in the model's frame. Ceres holds one frame and the scale, for equations that are not singular;
    a similarity then takes all cameras together nearest to where they were, since the error of the one that was
    held must not turn the model. Positions give the frame themselves.

    Args:
        model: stays as it is.
        covariances: (num_points2D, 2, 2) by image id, px^2; only those of observations are read.
        refine: by default all of the lenses.
        expected: whose principal points are expected; by default the model's own.
        loss_scale: of Cauchy's loss, in standard deviations as the residuals show them.
        positions: of the cameras of images, by name: (3,) in the model's frame, and their (3,) standard
            deviations. Three or more, not on one line.

    Raises:
        InputError: the camera model is not among those known here, a covariance or position cannot
            be used, or nothing is seen twice.
        SirpyError: the adjustment failed.
    """
    if positions is not None and len(positions) < FEWEST_POSITIONS:
        raise InputError(
            f"{len(positions)} position(s) do not give the model a frame: give {FEWEST_POSITIONS} or "
            "more, or none"
        )
    network, start = read_network(model, covariances, positions or {})
    adjuster = _Adjuster(network, loss_scale, expected or model)
    refine = refine or Intrinsics()
    free = [_free(camera, refine) for camera in network.cameras]
    state = adjuster.settled(_State(start, adjuster.sigma0(start, free)), free)
    unknowns = state.unknowns if positions else moved_back(network, state.unknowns, start)
    residuals = adjuster.residuals(unknowns)
    return Adjustment(
        model=with_unknowns(model, network, unknowns),
        residuals=_by_image(model, network, residuals),
        sigma0=state.sigma0,
        intrinsic_deviations=dict(
            zip((one.camera_id for one in network.cameras), state.deviations, strict=True)
        ),
    )


Free = list[NDArray[np.bool_]]  # of each camera (params,)


@dataclass(frozen=True)
class _State:
    unknowns: Unknowns
    sigma0: float
    deviations: tuple[Floats | None, ...] = ()


class _Adjuster:
    """Rounds of adjustment of one network in the C++ core."""

    def __init__(
        self, network: Network, loss_scale: float, expected: pycolmap.Reconstruction
    ) -> None:
        # Ceres and what it needs are loaded where they are used.
        from sirpy import _adjustment

        names = _adjustment.lens_names()
        for camera in network.cameras:
            if camera.model_name not in names:
                raise InputError(
                    f"camera {camera.camera_id} is a {camera.model_name}, which cannot be adjusted: "
                    f"use one of {', '.join(names)}"
                )
        if not (np.isfinite(loss_scale) and loss_scale > 0):
            raise InputError(f"a loss scale of {loss_scale} is not possible: choose one above 0")
        self._core = _adjustment
        self._network = network
        self._loss_scale = loss_scale
        self._expected = [expected.camera(one.camera_id) for one in network.cameras]
        self._observations = _adjustment.Observations(
            image=network.image,
            point=network.point,
            xy=network.xy,
            whitening=network.whitening.reshape(-1, 4),
        )

    def settled(self, state: _State, free: Free) -> _State:
        """After rounds of adjustment, until the loss is as wide as the residuals are.

        Raises:
            SirpyError: Ceres found no solution, or an impossible lens.
        """
        for _ in range(_ROUNDS):
            before = state.sigma0
            state = self._round(state, free)
            if not before > _SETTLED * max(state.sigma0, _EXACT):
                break
        state = self._round(state, free, deviations=True)
        for camera, parameters in zip(
            self._network.cameras, state.unknowns.parameters, strict=True
        ):
            adjusted = copy(camera)
            adjusted.params = parameters.tolist()
            if adjusted.has_bogus_params(0.1, 10.0, 1.0):
                raise SirpyError(
                    f"bundle adjustment gave camera {camera.camera_id} the impossible lens "
                    f"{adjusted.params_to_string()}: hold its parameters, or choose a simpler model"
                )
        return state

    def _round(self, state: _State, free: Free, *, deviations: bool = False) -> _State:
        sigma0 = max(state.sigma0, _EXACT) if np.isfinite(state.sigma0) else 1.0
        # Observations are as good as they have shown to be, beside what is known from elsewhere.
        usable, message, cameras, frames, sensors, points = self._core.adjust(
            self._model(state.unknowns, free, sigma0),
            self._observations,
            self._positions(sigma0),
            loss_scale=self._loss_scale * sigma0,
            deviations=deviations,
        )
        if not usable:
            raise SirpyError(
                f"bundle adjustment of {len(self._network.image_ids)} images failed ({message}): "
                "adjust fewer parameters, or leave out the observations that fit worst"
            )
        parameters = tuple(np.array(one) for one, _ in cameras)
        unknowns = Unknowns(parameters, frames, sensors, points)
        sigma0 = self.sigma0(unknowns, free)
        known = (None if one is None else np.array(one) * sigma0 for _, one in cameras)
        return _State(unknowns, sigma0, tuple(known))

    def residuals(self, unknowns: Unknowns) -> Floats:
        """(o, 2), observed less projected, px."""
        held = [np.zeros(len(one), bool) for one in unknowns.parameters]
        return self._core.residuals(self._model(unknowns, held, 1.0), self._observations)

    def sigma0(self, unknowns: Unknowns, free: Free) -> float:
        """Of the observations that fit; NaN without redundancy."""
        network = self._network
        squares = np.square(network.whitened(self.residuals(unknowns))).sum(axis=1)
        poses = 6 * (len(unknowns.frames) + len(unknowns.sensors))
        gauge = 3 * len(network.positions) or 7
        others = poses + sum(int(one.sum()) for one in free) - gauge
        variance = float(np.median(squares)) / _MEDIAN
        for _ in range(20):
            fits = squares <= _GATE**2 * variance
            counts = np.bincount(network.point[fits], minlength=len(unknowns.points))
            fits &= counts[network.point] >= 2
            redundancy = 2 * fits.sum() - 3 * (counts >= 2).sum() - others
            if redundancy <= 0:
                return float("nan")
            variance, before = float(squares[fits].sum() / redundancy), variance
            if abs(variance - before) <= 1e-6 * before:
                break
        return float(np.sqrt(variance))

    def _model(self, unknowns: Unknowns, free: Free, sigma0: float) -> _adjustment.Model:
        return self._core.Model(
            cameras=[
                (
                    camera.model_name,
                    one.tolist(),
                    mask.tolist(),
                    *_expectation(camera, mask, sigma0),
                )
                for camera, one, mask in zip(self._expected, unknowns.parameters, free, strict=True)
            ],
            frames=unknowns.frames,
            sensors=unknowns.sensors,
            images=self._network.images,
            points=unknowns.points,
        )

    def _positions(self, sigma0: float) -> _adjustment.Positions:
        known = self._network.positions
        return self._core.Positions(
            image=np.array(list(known), np.int32),
            centre=np.array([xyz for xyz, _ in known.values()]).reshape(-1, 3),
            sigma=np.array([sigma / sigma0 for _, sigma in known.values()]).reshape(-1, 3),
        )


def _free(camera: pycolmap.Camera, refine: Intrinsics) -> NDArray[np.bool_]:
    free = np.zeros(len(camera.params), bool)
    free[list(camera.focal_length_idxs())] = refine.focal_length
    free[list(camera.principal_point_idxs())] = bool(refine.principal_point)
    free[list(camera.extra_params_idxs())] = refine.extra_params
    return free


def _expectation(
    camera: pycolmap.Camera, free: NDArray[np.bool_], sigma0: float
) -> tuple[list[float], list[float]]:
    """Values of the parameters and how far from them they are expected, 0 of those that may be anything.

    The distances are relative to observations whose standard deviation is sigma0 times what is said of them.
    """
    sigma = np.zeros(len(free))
    points = list(camera.principal_point_idxs())
    sigma[points] = free[points] * EXPECTED_SHIFT * max(camera.width, camera.height) / sigma0
    return [float(value) for value in camera.params], sigma.tolist()


def _by_image(
    model: pycolmap.Reconstruction, network: Network, residuals: Floats
) -> dict[int, Floats]:
    found = {i: np.full((model.image(i).num_points2D(), 2), np.nan) for i in model.reg_image_ids()}
    order = np.argsort(network.image, kind="stable")
    starts = np.searchsorted(network.image[order], np.arange(len(network.image_ids) + 1))
    for index, image_id in enumerate(network.image_ids):
        rows = order[starts[index] : starts[index + 1]]
        found[image_id][network.keypoint[rows]] = residuals[rows]
    return found
