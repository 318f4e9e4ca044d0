"""What refinement at native resolution found: refinement.json, which the report draws.

Residuals are observed less projected, in native pixels, of the tie points that were kept.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pycolmap

from sirpy.bundle_adjustment import Adjustment
from sirpy.files import read_json, write_json
from sirpy.model_arrays import Floats
from sirpy.native_images import LeftOut

_CELLS = 12  # along the longer side of the frame
# Features contradict cameras where their sum of squares rises by more than so many times what cameras that are
# exact give, since the given ones fit part of the noise, and by this part of it, since noise is not all chance.
_CHANCE, _SYSTEMATIC = 4.0, 0.02


@dataclass(frozen=True)
class ImageRecord:
    """`observations` were kept, `rejected` did not fit; `unmatched` says why others were not found there.
    `rms_before` and `rms_after`: px, with the given and with the refined cameras."""

    name: str
    camera_id: int
    observations: int
    rejected: int
    unmatched: dict[str, int]
    rms_before: float
    rms_after: float


@dataclass(frozen=True)
class CameraRecord:
    """Mean residuals (px) over the cells of the frame, row by row: what the lens model does not explain.
    `params_before` are those of the given model."""

    camera_id: int
    model: str
    width: int
    height: int
    params_before: list[float]
    params: list[float]
    deviations: list[float] | None
    columns: int
    rows: int
    count: list[int]
    mean_residual_before: list[list[float]]
    mean_residual: list[list[float]]


@dataclass(frozen=True)
class FeatureFit:
    """The given model's own observations, of which the refined cameras know nothing: rms (px) with the given and
    with the refined cameras, each with the points that fit best; whether they contradict the refined ones."""

    rms_before: float
    rms_after: float
    contradict: bool


@dataclass(frozen=True)
class RefinementRecord:
    """`sigma0`: of the residuals, in units of what matching expected; `left_out`: photographs of the given model
    that are not in the one written; `kept`: why that has the given cameras, None where it has the refined ones."""

    points: int
    observations: int
    rms_before: float
    rms_after: float
    sigma0: float
    images: list[ImageRecord]
    cameras: list[CameraRecord]
    left_out: list[LeftOut]
    features: FeatureFit
    kept: str | None
    version: int = 1


def record(
    given: pycolmap.Reconstruction,
    adjustment: Adjustment,
    observed: dict[int, int],
    unmatched: dict[int, dict[str, int]],
    left_out: list[LeftOut],
    unread: list[LeftOut],
) -> RefinementRecord:
    """The residuals of the same observations before and after.

    Args:
        given: the model before; its cameras are taken, with the points that fit them best.
        observed, unmatched: by image id, tie points that were matched there, and how the others ended.
        left_out: of the refined model.
        unread: those of them that could not be read.
    """
    after = adjustment.model
    features = feature_fit(given, after)
    kept = _why_kept(features) if features.contradict else None
    before = _residuals(_with_cameras(after, given))
    residuals = _residuals(after)
    ids = sorted(after.reg_image_ids())
    images = [
        ImageRecord(
            after.image(i).name,
            after.image(i).camera_id,
            len(residuals[i][0]),
            observed[i] - len(residuals[i][0]),
            unmatched[i],
            _rms(before[i][1]),
            _rms(residuals[i][1]),
        )
        for i in ids
    ]
    cameras = [
        _camera(given, adjustment, camera_id, before, residuals)
        for camera_id in sorted({image.camera_id for image in images})
    ]
    return RefinementRecord(
        after.num_points3D(),
        sum(image.observations for image in images),
        _rms(np.concatenate([before[i][1] for i in ids])),
        _rms(np.concatenate([residuals[i][1] for i in ids])),
        adjustment.sigma0,
        images,
        cameras,
        unread if kept else left_out,
        features,
        kept,
    )


def feature_fit(given: pycolmap.Reconstruction, refined: pycolmap.Reconstruction) -> FeatureFit:
    """Of the photographs of both models.

    Each adjustment fits its own observations best, however wrong they are together; those of the other tell.
    """
    model = pycolmap.Reconstruction(given)
    for frame_id in set(given.reg_frame_ids()) - set(refined.reg_frame_ids()):
        model.deregister_frame(frame_id)
    before, after = (
        np.concatenate([r for _, r in _residuals(_with_cameras(model, cameras)).values()])
        for cameras in (model, refined)
    )
    known = np.isfinite(before).all(axis=1)  # not behind a camera
    before, after = before[known], after[known]
    lenses = {model.image(i).camera_id for i in model.reg_image_ids()}
    unknowns = 6 * model.num_reg_frames() + sum(len(model.camera(i).params) for i in lenses)
    redundancy = max(before.size - 3 * model.num_points3D() - unknowns, 1)
    limit = np.sqrt(1 + _SYSTEMATIC + _CHANCE * unknowns / redundancy)
    rms_before, rms_after = _rms(before), _rms(after)
    # Written so that NaN, of points behind refined cameras, contradicts.
    return FeatureFit(rms_before, rms_after, not rms_after <= limit * rms_before)


def _why_kept(features: FeatureFit) -> str:
    return (
        "the features of the decimated photographs contradict the cameras refined at native resolution (rms "
        f"{features.rms_after:.2f} px instead of {features.rms_before:.2f}; strong compression?): the decimated "
        "cameras are kept"
    )


def write_record(made: RefinementRecord, path: Path) -> None:
    write_json(path, asdict(made))


def read_left_out(path: Path) -> list[LeftOut]:
    """Of the record in a file. Raises InputError where it is damaged."""
    return read_json(
        path,
        lambda made: [LeftOut(str(one["name"]), str(one["reason"])) for one in made["left_out"]],
        "delete it and run again",
    )


def _rms(residuals: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1)))) if len(residuals) else 0.0


def _residuals(model: pycolmap.Reconstruction) -> dict[int, tuple[Floats, Floats]]:
    """(n, 2) pixels and (n, 2) residuals by image id."""
    found = {}
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        seen = [point for point in image.points2D if point.has_point3D()]
        xy = np.array([point.xy for point in seen]).reshape(-1, 2)
        world = np.array([model.point3D(point.point3D_id).xyz for point in seen]).reshape(-1, 3)
        pose = image.cam_from_world().matrix()
        in_camera = world @ pose[:, :3].T + pose[:, 3]
        found[image_id] = (
            xy,
            xy - np.asarray(model.camera(image.camera_id).img_from_cam(in_camera)),
        )
    return found


def _with_cameras(
    observed: pycolmap.Reconstruction, given: pycolmap.Reconstruction
) -> pycolmap.Reconstruction:
    """The observations of `observed` with the cameras of `given`, and points adjusted to these."""
    model = pycolmap.Reconstruction(observed)
    config = pycolmap.BundleAdjustmentConfig()
    for camera_id, camera in model.cameras.items():
        camera.params = given.camera(camera_id).params
        config.set_constant_cam_intrinsics(camera_id)
    for rig_id, rig in model.rigs.items():
        for sensor_id in rig.non_ref_sensors:
            rig.set_sensor_from_rig(sensor_id, given.rig(rig_id).sensor_from_rig(sensor_id))
            config.set_constant_sensor_from_rig_pose(sensor_id)
    for frame_id in model.reg_frame_ids():
        model.frame(frame_id).rig_from_world = given.frame(frame_id).rig_from_world
        config.set_constant_rig_from_world_pose(frame_id)
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.solver_options.num_threads = 1
    pycolmap.create_default_ceres_bundle_adjuster(options, config, model).solve()
    return model


def _camera(
    given: pycolmap.Reconstruction,
    adjustment: Adjustment,
    camera_id: int,
    before: dict[int, tuple[Floats, Floats]],
    after: dict[int, tuple[Floats, Floats]],
) -> CameraRecord:
    model = adjustment.model
    camera = model.camera(camera_id)
    side = max(camera.width, camera.height) / _CELLS
    columns, rows = (max(1, round(length / side)) for length in (camera.width, camera.height))
    own = [i for i in sorted(after) if model.image(i).camera_id == camera_id]
    xy = np.concatenate([after[i][0] for i in own])
    cell = np.clip(
        xy / [camera.width, camera.height] * [columns, rows], 0, [columns - 1, rows - 1]
    ).astype(np.int64)
    index = cell[:, 1] * columns + cell[:, 0]
    count = np.bincount(index, minlength=columns * rows)

    def means(residuals: dict[int, tuple[Floats, Floats]]) -> list[list[float]]:
        sums = np.zeros((columns * rows, 2))
        np.add.at(sums, index, np.concatenate([residuals[i][1] for i in own]))
        return (sums / np.maximum(count, 1)[:, None]).tolist()  # type: ignore[no-any-return]

    deviations = adjustment.intrinsic_deviations.get(camera_id)
    return CameraRecord(
        camera_id,
        camera.model.name,
        camera.width,
        camera.height,
        [float(value) for value in given.camera(camera_id).params],
        [float(value) for value in camera.params],
        None if deviations is None else deviations.tolist(),
        columns,
        rows,
        count.tolist(),
        means(before),
        means(after),
    )
