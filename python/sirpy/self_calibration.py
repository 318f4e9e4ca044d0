"""The last bundle adjustment of a sparse model, in native pixels: frees the principal point where
it can be seen.

Convergent views determine the principal point; a strip of nadir photographs does not, where it
trades against the poses. The covariance of the adjustment tells (mean-square successive unit weight
from the reprojection error), so it is freed only when its standard deviation is a small part of the
photograph.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pycolmap
from numpy.typing import NDArray

# Standard deviation of an accepted principal point, relative to the longest side of the photograph.
# Eleven convergent views of a facade have 3e-4, five nadir views of flat land 3e-3.
_ACCEPTED_DEVIATION = 1e-3
# The covariance is dense in the poses: 300 photographs are 26 MB and some seconds.
_MOST_PHOTOGRAPHS = 300


def adjust(
    model: pycolmap.Reconstruction, priors: Sequence[pycolmap.PosePrior] = ()
) -> pycolmap.Reconstruction:
    """The model after bundle adjustment of poses, points and lenses, principal points where
    determined; cameras keep to the positions of `priors` where there are some.

    Principal points of rigs stay. Runs on one thread, for the same bytes every time. Falls back to
    the model as given when the adjustment fails.
    """
    plain = _adjusted(model, priors, principal_points=False)[0]
    if plain is None:
        return model
    # COLMAP has no covariance of several cameras that share a pose.
    of_several = any(rig.num_sensors() > 1 for rig in model.rigs.values())
    if of_several or model.num_reg_images() > _MOST_PHOTOGRAPHS:
        return plain
    free, deviations = _adjusted(plain, priors, principal_points=True)
    if free is None or not deviations or max(deviations) > _ACCEPTED_DEVIATION:
        return plain
    return free


def _adjusted(
    model: pycolmap.Reconstruction, priors: Sequence[pycolmap.PosePrior], principal_points: bool
) -> tuple[pycolmap.Reconstruction | None, list[float]]:
    """(adjusted copy, relative deviation of each principal point); None where the adjustment
    failed."""
    adjusted = pycolmap.Reconstruction(model)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = principal_points
    options.print_summary = False
    options.ceres.solver_options.num_threads = 1
    configuration = pycolmap.BundleAdjustmentConfig()
    for image_id in adjusted.reg_image_ids():
        configuration.add_image(image_id)
    if priors:
        of_priors = pycolmap.PosePriorBundleAdjustmentOptions()
        of_priors.alignment_ransac.random_seed = 1
        # Single positions are off by far more than GPS promises.
        of_priors.ceres.prior_position_loss_function_type = pycolmap.LossFunctionType.CAUCHY
        adjuster = pycolmap.create_pose_prior_ceres_bundle_adjuster(
            options, of_priors, configuration, list(priors), adjusted
        )
    else:
        configuration.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
        adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, configuration, adjusted)
    if not adjuster.solve().is_solution_usable():
        return None, []
    adjusted.update_point_3d_errors()
    if any(camera.has_bogus_params(0.1, 10.0, 1.0) for camera in adjusted.cameras.values()):
        return None, []
    return adjusted, _deviations(adjusted, adjuster) if principal_points else []


def _deviations(
    model: pycolmap.Reconstruction, adjuster: pycolmap.CeresBundleAdjuster
) -> list[float]:
    """Standard deviation of each principal point over the longest side; empty when not
    determined."""
    options = pycolmap.BACovarianceOptions()
    options.params = pycolmap.BACovarianceOptionsParams.ALL
    covariance = pycolmap.estimate_ba_covariance(options, model, adjuster)
    if covariance is None:
        return []
    deviations = []
    for camera in model.cameras.values():
        of_camera: NDArray[np.float64] | None = covariance.get_other_params_cov(camera.params)
        if of_camera is None or len(of_camera) != len(camera.params):
            return []
        variances = np.diag(of_camera)[list(camera.principal_point_idxs())]
        # COLMAP's covariance is for observations of one pixel standard deviation.
        deviation = math.sqrt(max(variances)) * model.compute_mean_reprojection_error()
        deviations.append(deviation / max(camera.width, camera.height))
    return deviations
