"""The cameras that structure from motion begins with: who shares one, and its focal length."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Literal, get_args

import pycolmap

from sirpy.errors import InputError
from sirpy.exif import Exif
from sirpy.photographs import check_choice

CameraPer = Literal["auto", "image", "folder", "single"]
Size = tuple[int, int]  # width, height in pixels


def check_camera_options(camera_model: str, camera_per: str) -> None:
    """Raises InputError unless both are possible."""
    check_choice("camera_per", camera_per, get_args(CameraPer))
    known = tuple(sorted(pycolmap.CameraModelId.__members__.keys() - {"INVALID"}))
    check_choice("camera_model", camera_model, known)


def lens_groups(
    sizes: Mapping[str, Size], exifs: Mapping[str, Exif], camera_per: CameraPer
) -> list[list[str]]:
    """Names of photographs in groups that share one camera, all of the same size.

    Args:
        sizes: (width, height) of each photograph, native pixels.
        exifs: of each of them.
        camera_per: auto (a lens by EXIF, without EXIF a folder, and in any case a size), image,
            folder or single.

    Raises:
        InputError: photographs of different sizes are asked to share a camera.
    """
    groups: dict[Any, list[str]] = {}
    for name, size in sizes.items():
        folder = str(PurePosixPath(name).parent)
        # Without EXIF a folder stands for a camera, as the photographs of one flight usually do.
        keys = {
            "auto": (exifs[name].lens or (folder,), size),
            "image": name,
            "folder": folder,
            "single": None,
        }
        group = groups.setdefault(keys[camera_per], [])
        if group and sizes[group[0]] != size:
            raise InputError(
                f"camera_per = {camera_per} is not possible: {group[0]} has "
                f"{_times(sizes[group[0]])} pixels and {name} {_times(size)}, and a camera has one "
                "size: choose auto or image"
            )
        group.append(name)
    return list(groups.values())


def initial_camera(
    photograph: Path, size: Size, camera_model: str, *, has_exif: bool
) -> pycolmap.Camera:
    """A camera of native photographs, with the focal length of EXIF where that is known.

    Args:
        photograph: one that the camera took.
        size: its (width, height) in pixels.
        camera_model: COLMAP's name.
        has_exif: its EXIF says something about the lens.
    """
    if has_exif:
        try:
            camera = pycolmap.infer_camera_from_image(
                photograph, pycolmap.ImageReaderOptions(camera_model=camera_model)
            )
            if (camera.width, camera.height) == size:
                return camera
        except (ValueError, RuntimeError):
            pass  # a format that COLMAP does not read: no focal length is known
    return pycolmap.Camera.create_from_model_name(0, camera_model, 1.2 * max(size), *size)


def _times(size: Size) -> str:
    return f"{size[0]}x{size[1]}"
