"""Aligns a model to where its cameras were, or to ground control."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sirpy.alignment import Alignment, LeftOutMark, Residual, Role, Source
from sirpy.errors import InputError, first_few
from sirpy.frame import Floats, Frame
from sirpy.ground_control import ControlPoints, Mark, ModelPoint, distances, intersect
from sirpy.local_frame import mean_upward, up_direction
from sirpy.model_arrays import SparseModel
from sirpy.native_scene import NativeScene
from sirpy.places import Places
from sirpy.progress import Progress
from sirpy.similarity import FEWEST, Similarity, robust_similarity

_LARGEST_SHARE = 0.5  # of the positions' variance that may stay unexplained
_LOOSE_TURN = 3.0  # degrees: what the up direction is good for
_LOOSE_CONTROL = 1.0  # degrees


def align_positions(
    scene: NativeScene,
    places: Places,
    source: Source,
    *,
    crs: str | None,
    max_residual: float | None,
    progress: Progress,
) -> Alignment:
    """By the places of cameras of the scene; arguments and errors as of `georeference`."""
    everywhere = places.on_the_ground(crs)
    ground = everywhere.which_exist()
    if lost := sorted(set(everywhere.names) - set(ground.names)):
        progress.note(
            f"not used, since {ground.crs} has no such places: {first_few(lost)}; check these"
        )
    what = "position" if source == "positions" else "GPS position with an altitude"
    if len(ground.names) < FEWEST:
        raise InputError(
            f"{len(ground.names)} of the {len(scene.cameras)} photographs have a {what}, and an alignment needs "
            f"{FEWEST}: give a table with --positions, or control points with --gcp and --marks"
        )
    _check_apart(ground.xyz, "positions")
    centres = np.array([scene.cameras[name].centre for name in ground.names])
    _check_apart(centres, "cameras of the model")
    up = up_direction(scene)
    found = robust_similarity(centres, ground.xyz, up=up, max_residual=max_residual)
    _check_fit(found, ground.xyz, scene)
    if found.turn_sigma > _LOOSE_TURN:
        progress.note(
            "the positions lie nearly on one line, or are too coarse for their extent: the turn that they leave "
            "open comes from the plane of the sparse points and the way that the cameras look"
        )
    roles: list[Role] = ["used" if used else "outlier" for used in found.used]
    return Alignment(source, _frame(found, ground.crs), _residuals(ground, roles, found.residuals))


def align_control_points(
    scene: NativeScene,
    model: SparseModel,
    points: ControlPoints,
    marks: Sequence[Mark],
    *,
    crs: str | None,
    max_residual: float | None,
    progress: Progress,
) -> Alignment:
    """By control points and their marks in photographs of `model`, which lies as the scene does; arguments and
    errors as of `georeference`."""
    met = intersect(model, marks)
    points = _where_rays_meet(points, met, progress)
    ground = points.places.on_the_ground(crs)
    if lost := sorted(set(ground.names) - set(ground.which_exist().names)):
        raise InputError(
            f"{ground.crs} has no place such as that of {first_few(lost)}: check its coordinates"
        )
    control = ~points.check
    _check_apart(ground.xyz[control], "control points")
    found = _fit_control(
        [met[name] for name in np.array(ground.names)[control]],
        ground.xyz[control],
        points.sigmas[control],
        up_direction(scene),
        max_residual,
    )
    _check_fit(found, ground.xyz[control], scene)
    if found.turn_sigma > _LOOSE_CONTROL:
        raise InputError(
            "the control points lie on one line, or nearly, so that the model could turn about it: add one that "
            "lies apart"
        )
    roles = np.full(len(control), "check", object)
    roles[control] = np.where(found.used, "used", "outlier")
    residuals = found.frame.world(np.array([met[name].xyz for name in ground.names])) - ground.xyz
    surveyed = zip(ground.names, found.frame.model(ground.xyz), strict=True)
    pixels = [_rms(distances(model, xyz, met[name].marks)) for name, xyz in surveyed]
    return Alignment(
        "control_points",
        _frame(found, ground.crs),
        _residuals(ground, roles.tolist(), residuals, pixels),
        _marks_left_out(model, [met[name] for name in ground.names], progress),
    )


def _where_rays_meet(
    points: ControlPoints, met: dict[str, ModelPoint], progress: Progress
) -> ControlPoints:
    """Those that the model has; raises InputError where they are too few."""
    names = points.places.names
    unmet = [name for name in names if name not in met]
    kept = points.taking([row for row, name in enumerate(names) if name in met])
    count = int((~kept.check).sum())
    if count < FEWEST:
        mend = (
            f"mark {first_few(unmet)} in more" if unmet else "give more, or fewer as check points"
        )
        raise InputError(
            f"{count} control points are marked in photographs from different places, two at least, and an "
            f"alignment needs {FEWEST}: {mend}"
        )
    if unmet:
        progress.note(
            "not used, since they are not marked in two photographs from different places: "
            f"{first_few(unmet)}"
        )
    return kept


def _fit_control(
    met: Sequence[ModelPoint], world: Floats, sigmas: Floats, up: Floats, max_residual: float | None
) -> Similarity:
    """Once as if all were equally good, to know how large and how turned the covariances are, then with these."""
    model = np.array([point.xyz for point in met])
    rough = robust_similarity(model, world, up=up).frame
    turn = rough.scale * rough.rotation
    covariances = turn @ np.array([point.covariance for point in met]) @ turn.T
    covariances += np.einsum("ni,ij->nij", sigmas**2, np.eye(3))
    return robust_similarity(
        model, world, up=up, covariances=covariances, max_residual=max_residual
    )


def _marks_left_out(
    model: SparseModel, met: Sequence[ModelPoint], progress: Progress
) -> tuple[LeftOutMark, ...]:
    left_out = tuple(
        LeftOutMark(model.images[mark.image].name, mark.point, away)
        for point in met
        for mark, away in point.left_out
    )
    if left_out:
        named = ", ".join(
            f"{one.point} in {one.image} ({one.pixels:.0f} pixels)" for one in left_out
        )
        progress.note(f"marks that do not fit the others of their point are not used: {named}")
    return left_out


def _check_apart(xyz: Floats, what: str) -> None:
    if np.ptp(xyz, axis=0).max() <= 0:
        raise InputError(f"all {what} are at one place, which says nothing about size or direction")


def _check_fit(found: Similarity, world: Floats, scene: NativeScene) -> None:
    """Raises InputError where the places and the model have nothing in common."""
    some = found.used
    spread = world[some] - world[some].mean(axis=0)
    count = 3 * int(some.sum())
    unexplained = float((found.residuals[some] ** 2).sum()) / max(count - 7, 1)
    if unexplained > _LARGEST_SHARE * float((spread**2).sum()) / (count - 3):
        raise InputError(
            f"the coordinates do not fit the model: they are {unexplained**0.5:.3g} off where they spread over "
            f"{float(np.ptp(spread, axis=0).max()):.3g}; check names, columns and units"
        )
    if (found.frame.rotation @ mean_upward(scene))[2] < 0:
        raise InputError(
            "the coordinates would turn the model upside down: check that the columns of x and y are not "
            "exchanged"
        )


def _frame(found: Similarity, crs: str | None) -> Frame:
    return Frame(crs, found.frame.scale, found.frame.rotation, found.frame.translation)


def _residuals(
    ground: Places, roles: Sequence[Role], residuals: Floats, pixels: Sequence[float] | None = None
) -> tuple[Residual, ...]:
    return tuple(
        Residual(name, role, float(x), float(y), float(z), None if pixels is None else pixels[row])
        for row, (name, role, (x, y, z)) in enumerate(
            zip(ground.names, roles, residuals, strict=True)
        )
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt((values**2).mean()))
