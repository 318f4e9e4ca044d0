"""Finding COLMAP models, and reading them by pycolmap.

A damaged model makes COLMAP abort, loop or allocate without end, so binary files are read by the
C++ core first, which ends in one sentence.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import pycolmap

from sirpy import _core
from sirpy.errors import InputError

_FILES = ("cameras", "images", "points3D")  # what every COLMAP reads
_EXTRA_FILES = ("rigs", "frames")  # COLMAP 4 only
MODEL_FILES = tuple(f"{name}.bin" for name in (*_FILES, *_EXTRA_FILES))
_SUBFOLDERS = (".", "sparse", "0", "sparse/0")  # where COLMAP's own tools put a model


def read_model(path: Path | str) -> pycolmap.Reconstruction:
    """Reads a COLMAP model: binary or text, three files (3.8) or five (4.x).

    `path` holds the model, or is the folder above it (with `sparse/`, `0/` or `sparse/0/`).

    Raises:
        InputError: there is no model, it is damaged, or has no images or no 3D points.
    """
    folder = find_model(Path(path))
    if is_binary(folder):
        _core.read_model(folder)
    # pycolmap repeats its exceptions on stderr, and some warnings: our sentence says it all.
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    try:
        model = pycolmap.Reconstruction(folder)
    except (ValueError, RuntimeError, IndexError, KeyError, MemoryError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"the sparse model in {folder} is damaged ({reason}): export it again"
        ) from None
    finally:
        pycolmap.logging.minloglevel = level
    check_not_empty(folder, model.num_reg_images(), model.num_points3D())
    return model


def check_not_empty(folder: Path, images: int, points: int) -> None:
    """Raises InputError unless the model in `folder` has images and 3D points."""
    if images == 0:
        raise InputError(
            f"the sparse model in {folder} has no images: give a model with registered photographs"
        )
    if points == 0:
        raise InputError(
            f"the sparse model in {folder} has no 3D points, which depth ranges and source views "
            "come from: triangulate it first (`colmap point_triangulator`)"
        )


def model_identity(path: Path) -> str:
    """A hash of the content of the model's files: equal models have equal identities.

    Raises:
        InputError: there is no model.
    """
    folder = find_model(path)
    suffix = _suffix(folder)
    digest = hashlib.sha256()
    for name in (*_FILES, *_EXTRA_FILES):
        file = folder / f"{name}{suffix}"
        if file.is_file():
            digest.update(f"{file.name} {file.stat().st_size}\n".encode())
            with file.open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
    return digest.hexdigest()[:32]


def find_model(path: Path) -> Path:
    """The folder that holds the model's files: `path`, or the one below it where COLMAP puts them.

    Raises:
        InputError: there is none, it lacks a file, or there are several models to choose from.
    """
    if not path.is_dir():
        raise InputError(f"there is no folder {path}: give the folder of a COLMAP sparse model")
    for subfolder in _SUBFOLDERS:
        folder = path / subfolder
        if not any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            continue
        if folder.name == "0" and (folder.parent / "1").is_dir():
            raise InputError(
                f"{folder.parent} holds several models (0, 1, ...): give one of these folders"
            )
        suffix = _suffix(folder)
        for name in _FILES:
            if not (folder / f"{name}{suffix}").is_file():
                raise InputError(
                    f"the sparse model in {folder} has no {name}{suffix}: export it again"
                )
        return folder
    raise InputError(
        f"{path} holds no COLMAP sparse model (cameras.bin, images.bin, points3D.bin, or .txt): "
        "give the folder that has these files"
    )


def is_binary(folder: Path) -> bool:
    """Whether the model in `folder` (see `find_model`) is binary, not text."""
    return (folder / "cameras.bin").is_file()


def _suffix(folder: Path) -> str:
    return ".bin" if is_binary(folder) else ".txt"
