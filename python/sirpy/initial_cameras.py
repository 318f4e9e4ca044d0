"""The cameras that structure from motion begins with: who shares one, and its focal length."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Literal, get_args

import pycolmap

from sirpy.errors import InputError
from sirpy.exif import Exif, exif_bytes, read_exif
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
    focal = _exif_focal_length(photograph, size) if has_exif else None
    camera = pycolmap.Camera.create_from_model_name(
        0, camera_model, focal or 1.2 * max(size), *size
    )
    camera.has_prior_focal_length = focal is not None
    return camera


def _exif_focal_length(photograph: Path, size: Size) -> float | None:
    """In pixels, as COLMAP reads it from EXIF and its table of cameras.

    COLMAP decodes the whole photograph for that, so it gets a single row of pixels with the same
    EXIF, as long as what it relates the focal length to: the diagonal where that is given as of
    35 mm film, the longest side otherwise.
    """
    from PIL import Image

    lens = read_exif(photograph).lens
    length = float(max(size)) if not lens or lens[-1] in ("", "0") else math.hypot(*size)
    row = math.ceil(length)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "row.jpg"
        try:
            Image.new("L", (row, 1)).save(path, exif=exif_bytes(photograph))
            bitmap = pycolmap.Bitmap.read(path, False)
            focal = bitmap.exif_focal_length() if bitmap else None
        except (
            OSError,
            ValueError,
            RuntimeError,
        ):  # longer than a JPEG can be, more EXIF than fits
            return None
    return focal * length / row if focal and math.isfinite(focal) else None


def _times(size: Size) -> str:
    return f"{size[0]}x{size[1]}"
