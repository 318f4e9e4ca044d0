"""Rigs: cameras that are exposed together, in the format of COLMAP's rig_config.json.

    [{"cameras": [{"image_prefix": "nadir/", "ref_sensor": true},
                  {"image_prefix": "left/", "cam_from_rig_rotation": [w, x, y, z],
                   "cam_from_rig_translation": [x, y, z]}]}]

Photographs of one exposure have the same name after their prefixes. A pose that is missing is found
from the photographs.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from sirpy.errors import InputError
from sirpy.files import read_json

_KEYS = {
    "image_prefix",
    "ref_sensor",
    "cam_from_rig_rotation",
    "cam_from_rig_translation",
}


@dataclass(frozen=True)
class RigCamera:
    """A camera of a rig; `pose` is cam_from_rig (quaternion w, x, y, z, then translation), None
    where it has to be found; the reference has none."""

    prefix: str
    reference: bool
    pose: tuple[float, ...] | None


Rig = tuple[RigCamera, ...]


@dataclass(frozen=True)
class Place:
    """Where a photograph belongs: numbers of rig, camera and exposure."""

    rig: int
    camera: int
    exposure: int

    @property
    def prefix(self) -> str:
        return _prefix(self.rig, self.camera)


def read_rigs(path: Path) -> tuple[Rig, ...]:
    """The rigs in a file.

    Raises:
        InputError: there is no such file, or it is not in COLMAP's format.
    """
    try:
        return read_json(
            path, lambda rigs: _parse(rigs, path), "write it as COLMAP's rig_config.json"
        )
    except FileNotFoundError:
        raise InputError(
            f"there is no file {path}: give COLMAP's rig_config.json to --rig"
        ) from None


def _parse(rigs: Any, path: Path) -> tuple[Rig, ...]:
    parsed = tuple(tuple(_camera(one, path) for one in rig["cameras"]) for rig in rigs)
    for rig in parsed:
        references = sum(camera.reference for camera in rig)
        if references != 1:
            raise InputError(
                f"{path} has a rig with {references} cameras that are its reference: "
                'set "ref_sensor": true for one of them'
            )
    if not parsed:
        raise InputError(f"{path} has no rig: give the cameras of one at least")
    return parsed


def _camera(entry: dict[str, Any], path: Path) -> RigCamera:
    if strange := sorted(entry.keys() - _KEYS):
        raise InputError(
            f"{path} has {strange[0]}, which is not known here: write {', '.join(sorted(_KEYS))} alone"
        )
    prefix, reference = entry["image_prefix"], entry.get("ref_sensor", False)
    rotation, translation = (
        entry.get(f"cam_from_rig_{part}") for part in ("rotation", "translation")
    )
    if not isinstance(prefix, str) or not prefix or not isinstance(reference, bool):
        raise InputError(
            f"{path} has a camera with image_prefix {prefix!r} and ref_sensor {reference!r}: "
            "these are the beginning of the names of its photographs, and true or false"
        )
    if (rotation is None) != (translation is None) or (reference and rotation is not None):
        raise InputError(
            f"{path} has half a pose of {prefix}, or one of a reference: give "
            "cam_from_rig_rotation and cam_from_rig_translation, or neither, as for the reference"
        )
    if rotation is None or translation is None:
        return RigCamera(prefix, reference, None)
    pose = tuple(float(value) for value in (*rotation, *translation))
    if (
        (len(rotation), len(translation)) != (4, 3)
        or not np.isfinite(pose).all()
        or not any(rotation)
    ):
        raise InputError(
            f"{path}: the pose of {prefix} has no rotation w, x, y, z and translation x, y, z"
        )
    return RigCamera(prefix, reference, pose)


def places(rigs: tuple[Rig, ...], names: Iterable[str]) -> dict[str, Place]:
    """Where the photographs of rigs belong; the others are not in it.

    Raises:
        InputError: a camera has no photograph, a photograph is of two cameras, or no two cameras
            of a rig were exposed together.
    """
    cameras = [(r, c, one.prefix) for r, rig in enumerate(rigs) for c, one in enumerate(rig)]
    found: dict[str, tuple[int, int, str]] = {}
    for name in names:
        fitting = [(r, c, prefix) for r, c, prefix in cameras if name.startswith(prefix)]
        if len(fitting) > 1:
            raise InputError(
                f"{name} is of two cameras of the rig, {fitting[0][2]} and {fitting[1][2]}: "
                "write longer prefixes"
            )
        for r, c, prefix in fitting:
            found[name] = (r, c, name.removeprefix(prefix))
    for r, c, prefix in cameras:
        if not any(place[:2] == (r, c) for place in found.values()):
            raise InputError(
                f"the rig has a camera {prefix}, and no photograph has a name that begins so: "
                "give prefixes of paths within the folder of photographs"
            )
    exposures = [sorted({p[2] for p in found.values() if p[0] == r}) for r in range(len(rigs))]
    for r, rig in enumerate(rigs):
        of_rig = sum(place[0] == r for place in found.values())
        if len(rig) > 1 and of_rig == len(exposures[r]):
            raise InputError(
                f"no two photographs of the rig of {rig[0].prefix} have the same name after their "
                "prefixes, which is what tells that they were taken together: rename them"
            )
    numbers = [{suffix: i for i, suffix in enumerate(suffixes)} for suffixes in exposures]
    return {name: Place(r, c, numbers[r][suffix]) for name, (r, c, suffix) in found.items()}


def are_posed(rigs: tuple[Rig, ...]) -> bool:
    """Whether every pose within the rigs is known."""
    return all(camera.reference or camera.pose for rig in rigs for camera in rig)


def write_rigs(
    database: Path, rigs: tuple[Rig, ...], model: pycolmap.Reconstruction | None = None
) -> None:
    """Writes rigs, and the exposures as their frames, to a database of photographs that are named
    by their `Place`.

    Args:
        model: of the single photographs; gives the poses within the rigs that are not known.

    Raises:
        InputError: `model` does not show a pose either.
    """
    if model is not None:
        _check_visible(rigs, model)
    configs = []
    for r, rig in enumerate(rigs):
        cameras = []
        for c, camera in enumerate(rig):
            one = pycolmap.RigConfigCamera()
            one.image_prefix, one.ref_sensor = _prefix(r, c), camera.reference
            if camera.pose is not None:
                w, x, y, z, *translation = camera.pose
                rotation = pycolmap.Rotation3d(np.array([x, y, z, w]))
                rotation.normalize()
                one.cam_from_rig = pycolmap.Rigid3d(rotation, np.array(translation))
            cameras.append(one)
        configs.append(pycolmap.RigConfig(cameras=cameras))
    with pycolmap.Database.open(database) as opened:
        if model is None:
            pycolmap.apply_rig_config(configs, opened)
        else:
            pycolmap.apply_rig_config(configs, opened, model)


def _check_visible(rigs: tuple[Rig, ...], model: pycolmap.Reconstruction) -> None:
    names = {model.image(image_id).name for image_id in model.reg_image_ids()}
    for r, rig in enumerate(rigs):
        (reference,) = (_prefix(r, c) for c, camera in enumerate(rig) if camera.reference)
        with_reference = {n.removeprefix(reference) for n in names if n.startswith(reference)}
        for c, camera in enumerate(rig):
            prefix = _prefix(r, c)
            seen = {n.removeprefix(prefix) for n in names if n.startswith(prefix)}
            if camera.pose is None and not seen & with_reference:
                raise InputError(
                    f"the pose of {camera.prefix} in its rig could not be found from the photographs, "
                    "since none of an exposure with the reference could be oriented: give it in the file"
                )


def _prefix(rig: int, camera: int) -> str:
    return f"rig{rig}-{camera}/"
