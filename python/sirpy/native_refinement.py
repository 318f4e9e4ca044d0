"""Cameras for native resolution: the tie points of a decimated model are measured anew in the native photographs
(tie_points.py), and poses, lenses and points are adjusted to them, each observation with its own covariance.

Sub-images of a photograph share its pose and lens: their model is made of the one that is refined here.
"""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap

from sirpy.bundle_adjustment import Adjustment, Intrinsics, bundle_adjust
from sirpy.errors import InputError, OutputError
from sirpy.files import folder_written_whole
from sirpy.model_arrays import Floats, SparseModel, read_arrays, write_model
from sirpy.model_files import MODEL_FILES, read_model
from sirpy.native_images import LeftOut
from sirpy.progress import Progress
from sirpy.refinement_record import RefinementRecord, record, write_record
from sirpy.tie_points import STATUS, TiePoints, measure_tie_points
from sirpy.workspace import check_writable

_GATE = 4.0  # sigma0: an observation beyond it is taken for a wrong match
_ROUNDS = 5
_FEWEST = 12  # tie points of a photograph, of which its pose has six unknowns
# Two views cannot tell a point that moved along the ray: where a photograph has so many others, they go.
_ENOUGH = 50


@dataclass(frozen=True)
class Refinement:
    """`model`: folder of the COLMAP model that was written; `record.kept` says whether it is not the refined one."""

    model: Path
    record: RefinementRecord


def predicted_peak(model: SparseModel) -> int:
    """Peak memory in bytes of `refine`: 0.18 GB, and the larger of 13 kB for each tie point of the photograph that
    has most and 1.5 kB for each observation of all."""
    observations = np.diff(model.starts)
    return int(180e6 + max(13e3 * observations.max(initial=0), 1.5e3 * observations.sum()))


def refine(
    images: Path | str,
    model: Path | str,
    output: Path | str,
    *,
    intrinsics: Intrinsics | None = None,
    threads: int = 1,
    progress: Progress | None = None,
) -> Refinement:
    """Refines a COLMAP model in native pixels; writes the model `output`, and refinement.json beside it.

    Where the observations of the given model contradict the refined cameras, `output` is the given model, less
    photographs that cannot be read.

    Every photograph is decoded once, by rows. Memory (`predicted_peak`) does not grow with its size. The same bytes
    for any number of threads.

    Args:
        images: folder of the photographs that the model names.
        intrinsics: what of the lenses is refined; by default all that the tie points determine.

    Raises:
        InputError: the model is not usable, or no two photographs share tie points.
        OutputError: `output` cannot be written, or holds something else than a model.
    """
    images, output = Path(images), Path(output)
    _check_output(output, images, Path(model))
    progress = progress or Progress()
    given, arrays = read_model(model), read_arrays(model)
    scratch = output.with_name(f".{output.name}.patches")
    tie = measure_tie_points(images, arrays, scratch, threads=threads, progress=progress)
    with progress.stage("adjusting cameras", 1, "model") as steps:
        measured = _with_tie_points(given, arrays, tie)
        covariances = _by_image(arrays, tie)
        observed = {i: len(values) for i, values in covariances.items()}
        weak = _remove_weak(measured)
        adjustment = _adjusted(measured, covariances, intrinsics or Intrinsics(), weak)
        steps.advance()
    unread = {out.name for out in tie.left_out}
    weak = [out for out in weak if out.name not in unread]
    made = record(
        *(given, adjustment, observed, _rejections(arrays, tie)),
        left_out=[*tie.left_out, *weak],
        unread=list(tie.left_out),
    )
    if made.kept:
        progress.note(made.kept)
        _take_away(given, unread)
    else:
        for out in weak:
            progress.note(f"{out.name} is left out: {out.reason}")
    with folder_written_whole(output) as folder:
        (given if made.kept else adjustment.model).write_binary(folder)
    write_record(made, output.with_name("refinement.json"))
    return Refinement(output, made)


def _check_output(output: Path, images: Path, model: Path) -> None:
    """Nothing but a model is replaced, and not the one that is read."""
    check_writable(output.parent)
    for given in (images, model):
        if given.resolve().is_relative_to(output.resolve()):
            raise OutputError(f"{output} would replace {given}: choose another output")
    if output.is_symlink() or (output.exists() and not output.is_dir()):
        raise OutputError(f"{output} is no folder: choose another output")
    if output.is_dir():
        others = sorted(path.name for path in output.iterdir() if path.name not in MODEL_FILES)
        if others:
            raise OutputError(f"{output} holds {others[0]}: choose another output, or move it away")


def _with_tie_points(
    given: pycolmap.Reconstruction, arrays: SparseModel, tie: TiePoints
) -> pycolmap.Reconstruction:
    """The given cameras, rigs and frames, with the tie points as the only observations."""
    starts = np.searchsorted(tie.image, np.arange(len(arrays.images) + 1)).astype(np.int64)
    model = replace(
        arrays,
        starts=starts,
        xy=np.ascontiguousarray(tie.xy),
        point=tie.point.astype(np.int32),
        errors=np.full(len(arrays.points), -1.0),
    ).with_seen_points()
    if not len(model.points):
        raise InputError(
            "no tie point of the model could be measured in the native photographs: are these the photographs "
            "that it was made of? Otherwise keep the cameras as they are with --no-native"
        )
    # By way of files, since pycolmap does not exchange the observations of an image.
    with tempfile.TemporaryDirectory(prefix="sirpy-") as folder:
        measured, rigs = Path(folder) / "measured", Path(folder) / "rigs"
        write_model(model, measured)
        rigs.mkdir()
        given.write_binary(rigs)
        for name in ("rigs.bin", "frames.bin"):
            shutil.copyfile(rigs / name, measured / name)
        return pycolmap.Reconstruction(measured)


def _by_image(arrays: SparseModel, tie: TiePoints) -> dict[int, Floats]:
    ends = np.searchsorted(tie.image, np.arange(len(arrays.images) + 1))
    return {
        image.image_id: tie.covariance[ends[i] : ends[i + 1]]
        for i, image in enumerate(arrays.images)
    }


def _rejections(arrays: SparseModel, tie: TiePoints) -> dict[int, dict[str, int]]:
    return {
        image.image_id: dict(zip(STATUS[1:], tie.status[i, 1:].tolist(), strict=True))
        for i, image in enumerate(arrays.images)
    }


def _adjusted(
    measured: pycolmap.Reconstruction,
    covariances: dict[int, Floats],
    intrinsics: Intrinsics,
    left_out: list[LeftOut],
) -> Adjustment:
    """Adjusts, and again without the observations that do not fit, until all do; photographs that then have too
    few join `left_out`."""
    adjustment = bundle_adjust(measured, covariances, refine=intrinsics)
    for _ in range(_ROUNDS):
        model = adjustment.model
        wrong = _wrong(adjustment, covariances)
        for image_id, index in wrong:
            # A point that is seen once is taken away with its last but one observation.
            if model.image(image_id).points2D[index].has_point3D():
                model.delete_observation(image_id, index)
        pairs = _remove_pairs(model)
        weak = _remove_weak(model)
        left_out += weak
        if not wrong and not pairs and not weak:
            break
        adjustment = bundle_adjust(model, covariances, refine=intrinsics, expected=measured)
    adjustment.model.update_point_3d_errors()
    return adjustment


def _wrong(adjustment: Adjustment, covariances: dict[int, Floats]) -> list[tuple[int, int]]:
    """(image id, index) of observations beyond the gate."""
    gate = (_GATE * adjustment.sigma0) ** 2
    wrong = []
    for image_id, residuals in adjustment.residuals.items():
        squares = np.einsum(
            "ni,nij,nj->n", residuals, np.linalg.inv(covariances[image_id]), residuals
        )
        wrong += [(image_id, index) for index in np.flatnonzero(squares > gate).tolist()]
    return wrong


def _remove_pairs(model: pycolmap.Reconstruction) -> int:
    """Takes away points that two photographs see, where both have enough others; how many."""
    others = dict.fromkeys(model.reg_image_ids(), 0)
    pairs = []
    for point_id, point in model.points3D.items():
        elements = point.track.elements
        if len(elements) == 2:
            pairs.append((point_id, [element.image_id for element in elements]))
            continue
        for element in elements:
            others[element.image_id] += 1
    removed = [point for point, seen in pairs if all(others[i] >= _ENOUGH for i in seen)]
    for point in removed:
        model.delete_point3D(point)
    return len(removed)


def _take_away(model: pycolmap.Reconstruction, names: set[str]) -> None:
    images = [model.image(i) for i in model.reg_image_ids()]
    for frame_id in sorted({image.frame_id for image in images if image.name in names}):
        model.deregister_frame(frame_id)


def _remove_weak(model: pycolmap.Reconstruction) -> list[LeftOut]:
    """Takes away photographs that tie points do not hold, until all that stay are held."""
    left_out: list[LeftOut] = []
    while weak := [
        image
        for image in map(model.image, sorted(model.reg_image_ids()))
        if image.num_points3D < _FEWEST
    ]:
        for image in weak:
            reason = (
                f"only {image.num_points3D} of its tie points could be measured at native resolution, {_FEWEST} "
                "are needed"
            )
            left_out.append(LeftOut(image.name, reason))
        for frame_id in sorted({image.frame_id for image in weak}):
            model.deregister_frame(frame_id)
        if model.num_reg_images() < 2:
            raise InputError(
                "too few tie points of the model could be measured in the native photographs: are these the "
                "photographs that it was made of? Otherwise keep the cameras as they are with --no-native"
            )
    return left_out
