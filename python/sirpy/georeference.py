"""Where on the Earth a model lies: the similarity from it to a CRS, which products are made in.

The model itself is not changed, nor bent: what a similarity cannot mend stays, and the residuals show it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np

from sirpy.aligning import align_control_points, align_positions
from sirpy.alignment import (
    Alignment,
    Residual,
    Source,
    read_alignment,
    write_alignment,
)
from sirpy.camera_positions import Photographs, exif_positions, read_positions
from sirpy.crs import ground_crs
from sirpy.errors import InputError, first_few
from sirpy.files import fingerprint
from sirpy.frame import Frame
from sirpy.ground_control import (
    read_control_points,
    read_marks,
)
from sirpy.local_frame import is_z_up, local_frame
from sirpy.model_arrays import SparseModel, read_arrays
from sirpy.native_scene import NativeScene, read_native_scene
from sirpy.places import Places
from sirpy.progress import Progress
from sirpy.workspace import Workspace

_SAME_CENTRE = 1e-6  # of the extent of the cameras


def georeference(
    workspace: Workspace,
    *,
    images: Path | None = None,
    positions: Path | None = None,
    positions_crs: str | None = None,
    control_points: Path | None = None,
    marks: Path | None = None,
    check: Sequence[str] = (),
    model: Path | None = None,
    as_is: bool = False,
    crs: str | None = None,
    max_residual: float | None = None,
    progress: Progress | None = None,
) -> Alignment:
    """Aligns the workspace's model, and writes OUT/georeference.json, which `read_frame` reads.

    One source is needed: `images`, `positions`, `control_points` with `marks`, or `as_is`. Those of the points
    that contradict the others are found, named and not used.

    Args:
        images: folder of the photographs, for the GPS positions in their EXIF.
        positions: table of camera positions: name, and x, y, z or longitude, latitude, height.
        positions_crs: of the coordinates in `positions` or `control_points`; by default WGS84 where they
            are longitudes and latitudes, else `crs`.
        control_points: table of surveyed points; see `read_control_points`.
        marks: table of where photographs show them; see `read_marks`.
        check: ids of control points that are only compared.
        model: that the workspace was cut from, with the cameras of the photographs; by default the one that
            `sirpy reconstruct` made in the workspace.
        as_is: the model is in `crs` already, or z up in metres without it, and stays as it is.
        crs: of the products, projected; by default that of the coordinates, or their UTM zone.
        max_residual: in the unit of the CRS, instead of five sigma.

    Raises:
        InputError: something cannot be read or used, or does not fit the model; nothing is written.
    """
    progress = progress or Progress()
    _check_sources(images, positions, control_points, marks, as_is)
    if max_residual is not None and not 0 < max_residual < float("inf"):
        raise InputError(f"--max-residual {max_residual:g} is not possible: it must be positive")
    _ = workspace.natives  # is this a workspace?
    scene = read_native_scene(workspace)
    if as_is:
        frame = Frame(None if crs is None else ground_crs(crs, "--crs"))
        alignment = Alignment("declared", frame)
    elif control_points is not None and marks is not None:
        solved = _solved(workspace, model, scene)
        points = read_control_points(control_points, positions_crs, check)
        marked = read_marks(marks, solved, points, progress)
        alignment = align_control_points(
            scene, solved, points, marked, crs=crs, max_residual=max_residual, progress=progress
        )
    else:
        source: Source = "exif" if positions is None else "positions"
        places = (
            exif_positions(cast(Path, images), list(scene.cameras), progress)
            if positions is None
            else _in_the_model(read_positions(positions, positions_crs), positions, scene, progress)
        )
        alignment = align_positions(
            scene, places, source, crs=crs, max_residual=max_residual, progress=progress
        )
    if alignment.frame.crs is None:
        progress.note("no CRS is given, so the products carry none: name one with --crs")
    if alignment.outliers:
        progress.note(
            f"not used, since the others contradict: {_with_distances(alignment.residuals)}; check these"
        )
    write_alignment(workspace, alignment)
    if workspace.fingerprint_of("products"):  # what was made in another frame goes
        begin_products(workspace, alignment.frame)
    return alignment


def begin_products(workspace: Workspace, frame: Frame) -> None:
    """Removes the products of another cloud, or of another frame."""
    place = [frame.crs, frame.scale, frame.rotation.tolist(), frame.translation.tolist()]
    workspace.begin_stage("products", fingerprint(workspace.fingerprint_of("fuse"), place))


def read_frame(workspace: Workspace) -> Frame:
    """The frame of the workspace's products: as georeference.json says, else `local_frame`.

    Raises:
        InputError: that file or the workspace's model is missing or damaged.
    """
    alignment = read_alignment(workspace)
    if alignment is not None:
        return alignment.frame
    return local_frame(read_native_scene(workspace))[0]


def settle_frame(
    workspace: Workspace, images: Path, *, model_crs: str | None = None, progress: Progress
) -> Frame:
    """The frame of the products when nobody asked for a certain one, as `sirpy reconstruct` needs it.

    An earlier georeference stays; a model whose CRS is named lies in it; a model that is z up came from a survey and
    is not disturbed; any other is aligned to the GPS positions of its photographs, where these agree, else
    in a local frame. What was chosen is noted.
    """
    if model_crs is not None and read_alignment(workspace) is None:
        return georeference(workspace, as_is=True, crs=model_crs, progress=progress).frame
    if read_alignment(workspace) is None and not is_z_up(read_native_scene(workspace)):
        try:
            georeference(workspace, images=images, progress=progress)
        except InputError as error:
            progress.note(f"no georeference: {error}")
    alignment = read_alignment(workspace)
    if alignment is not None:
        progress.note(
            f"the products are in {alignment.frame.crs or 'the frame'} of {workspace.georeference}"
        )
        return alignment.frame
    frame, what = local_frame(read_native_scene(workspace))
    progress.note(what)
    return frame


def _check_sources(
    images: Path | None,
    positions: Path | None,
    control_points: Path | None,
    marks: Path | None,
    as_is: bool,
) -> None:
    if (control_points is None) != (marks is None):
        raise InputError("--gcp and --marks belong together: give both or neither")
    named = {"--images": images, "--positions": positions, "--gcp": control_points}
    given = [option for option, value in named.items() if value is not None]
    given += ["--as-is"] if as_is else []
    if len(given) != 1:
        what = "there is none" if not given else f"{' and '.join(given)} are too many"
        raise InputError(
            f"a georeference needs one source, and {what}: give --images (GPS in EXIF), --positions, --gcp with "
            "--marks, or --as-is"
        )


def _in_the_model(places: Places, path: Path, scene: NativeScene, progress: Progress) -> Places:
    """The places of the photographs that the model has, under their names there."""
    photographs = Photographs(scene.cameras)
    found: dict[str, int] = {}
    strange = []
    for row, called in enumerate(places.names):
        name = photographs.find(called, f"{path}:")
        if name is None:
            strange.append(called)
        elif name in found:
            raise InputError(
                f"{path} has two positions for {name} ({places.names[found[name]]}, {called}): keep one"
            )
        else:
            found[name] = row
    if not found:
        raise InputError(
            f"{path} names none of the photographs of the model ({first_few(strange)}): write their names as "
            f"{next(iter(scene.cameras))}"
        )
    if strange:
        progress.note(
            f"{len(strange)} positions are of photographs that the model does not have: {first_few(strange)}"
        )
    return Places(tuple(found), places.xyz[list(found.values())], places.crs)


def _solved(workspace: Workspace, model: Path | None, scene: NativeScene) -> SparseModel:
    """The cameras of the photographs, in the frame of the workspace's model."""
    if model is None:
        if not workspace.solved_model.is_dir():
            raise InputError(
                "marks are in pixels of the photographs, and this workspace has only undistorted cameras: give "
                "the model that it was cut from with --model"
            )
        model = workspace.solved_model
    solved = read_arrays(model)
    centres = np.array([camera.centre for camera in scene.cameras.values()])
    extent = float(np.ptp(centres, axis=0).max())
    poses = {image.name: image.cam_from_world for image in solved.images}
    for name, camera in scene.cameras.items():
        pose = poses.get(name)
        if pose is None or (
            np.linalg.norm(-pose[:, :3].T @ pose[:, 3] - camera.centre) > _SAME_CENTRE * extent
        ):
            raise InputError(
                f"{model} is not the model that this workspace was cut from, since {name} is elsewhere in it: "
                "give that one with --model"
            )
    return solved


def _with_distances(residuals: Sequence[Residual]) -> str:
    """ "a.jpg (5,012 off), b.jpg (204 off)", the furthest first."""
    outliers = [
        ((one.dx**2 + one.dy**2 + one.dz**2) ** 0.5, one.name)
        for one in residuals
        if one.role == "outlier"
    ]
    return ", ".join(
        f"{name} ({away:{',.0f' if away >= 100 else '.3g'}} off)"
        for away, name in sorted(outliers, reverse=True)
    )
