"""Photographs: finding them, reading their rows, decimating them.

JPEG and PNG go through libjpeg-turbo and libpng, everything else through GDAL by bands of rows;
never whole when it can be avoided. Pixels are 8-bit grey or RGB as stored: an EXIF orientation is not
applied, since COLMAP solves cameras without it.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sirpy import _core
from sirpy.errors import InputError

_EXTENSIONS = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff", ".jp2", ".bmp"})
_CACHE = 64  # of GDAL's blocks, MB; its default is a share of the machine's memory
_BAND_ROWS = 64
_DECIMATED_JPEG_QUALITY = 97


@dataclass(frozen=True)
class Photograph:
    """What the header of a photograph says. `channels` are those that are read: 1 grey or 3 RGB."""

    path: Path
    width: int
    height: int
    channels: int
    format: str
    """GDAL's name of it: JPEG, PNG, GTiff ..."""
    note: str = ""
    """What the user should know about how it is read; mostly empty."""


def find_photographs(folder: Path) -> list[str]:
    """Names of the photographs in `folder` and below, relative to it with `/`, sorted.

    Raises:
        InputError: there is no such folder, or no photograph in it.
    """
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}: give the folder that holds the photographs")
    names = []
    visited = set()
    for directory, folders, files in os.walk(folder, followlinks=True):
        # A link to a folder above would lead round and round.
        visited.add(os.path.realpath(directory))
        # Nor are the sub-images of a workspace photographs.
        folders[:] = [
            name
            for name in folders
            if os.path.realpath(Path(directory) / name) not in visited
            and not (Path(directory) / name / "stages.json").exists()
        ]
        names += [
            (Path(directory) / name).relative_to(folder).as_posix()
            for name in files
            if Path(name).suffix.lower() in _EXTENSIONS and not name.startswith(".")
        ]
    if not names:
        known = ", ".join(sorted(extension[1:] for extension in _EXTENSIONS))
        raise InputError(f"{folder} holds no photographs: put some there ({known})")
    return sorted(names)


def check_folders(images: Path, output: Path) -> None:
    """Raises InputError where the workspace would lie among the photographs' own files."""
    if images.resolve() == output.resolve():
        raise InputError(
            f"the photographs and the output are in one folder, {images}: choose another folder with "
            "--output"
        )


def check_names(names: Iterable[str]) -> None:
    """Raises InputError unless every name of a model stays inside the folder it is relative to."""
    for name in names:
        path = PurePosixPath(name)
        windows = PureWindowsPath(name)
        if path.is_absolute() or windows.drive or ".." in path.parts or ".." in windows.parts:
            raise InputError(
                f"the model names an image {name!r} that lies outside the folder of the "
                "photographs: give images names relative to it, without '..'"
            )
        if not path.name or "\0" in name or "\n" in name:
            raise InputError(f"the model has an image with the unusable name {name!r}: rename it")


def open_photograph(path: Path) -> Photograph:
    """Reads the header.

    Raises:
        InputError: missing, no image, or of a kind that is not supported (16-bit, CMYK, palette).
    """
    if not path.is_file():
        raise InputError(
            f"there is no photograph {path}: put it there, or take it out of the model"
        )
    start = _first_bytes(path)
    if start.startswith(b"\xff\xd8\xff"):
        width, height, channels = _core.jpeg_shape(path)
        return Photograph(path, width, height, channels, "JPEG")
    if start.startswith(b"\x89PNG"):
        width, height, channels, alpha = _core.png_shape(path)
        note = f"{path.name}: its alpha channel is not used" if alpha else ""
        return Photograph(path, width, height, channels, "PNG", note)
    with _raster(path) as raster:
        if any(kind != "uint8" for kind in raster.dtypes):
            bits = np.dtype(raster.dtypes[0]).itemsize * 8
            raise InputError(
                f"photograph {path} has {bits}-bit samples, which are not supported yet: "
                "convert it to 8 bit"
            )
        if raster.colorinterp[0].name == "palette" and not _is_grey(raster.colormap(1)):
            raise InputError(f"photograph {path} has a palette: convert it to RGB or grey")
        channels = 3 if raster.count >= 3 else 1
        note = ""
        if raster.count != channels:
            bands = "first three bands" if channels == 3 else "first band"
            note = f"{path.name}: only the {bands} of {raster.count} are used"
        return Photograph(path, raster.width, raster.height, channels, raster.driver, note)


def photograph_size(path: Path) -> tuple[int, int]:
    """(width, height) in pixels, from the header. Raises InputError as `open_photograph`."""
    photograph = open_photograph(path)
    return photograph.width, photograph.height


def recapture_photograph(
    photograph: Photograph,
    lens: _core.LensMap | None,
    size: tuple[int, int],
    files: list[tuple[Path, int, int, int, int]],
    jpeg_quality: int,
) -> None:
    """Undistorts a photograph and cuts it into `files`, (path, x0, y0, width, height), in one pass.

    Args:
        lens: positions in the photograph of undistorted pixels; None copies the pixels.
        size: (width, height) of the image that is cut; the undistorted image is shrunk to it.

    Raises:
        InputError: the photograph is damaged; files that were finished before are whole, and stay.
        OutputError: a file cannot be written.
    """
    shape = (photograph.width, photograph.height, photograph.channels)
    if photograph.format == "JPEG":
        _core.recapture_jpeg(photograph.path, shape, lens, size, files, jpeg_quality)
        return
    if photograph.format == "PNG":
        _core.recapture_png(photograph.path, shape, lens, size, files, jpeg_quality)
        return
    recapture = _core.Recapture(shape, lens, size, files, jpeg_quality)
    for rows in _bands(photograph):
        recapture.push(rows)
    recapture.finish()


def decimate(path: Path, output: Path, max_size: int) -> float:
    """Writes a photograph with a longest side of at most `max_size` pixels as JPEG (4:4:4).

    Every output pixel is the mean of the input pixels under it, weighted by area. A photograph that
    is small enough is written at its own size; it is read whole in any case, so damage shows.

    Returns:
        Native pixels per decimated pixel along the longest side, at least 1.

    Raises:
        InputError: the photograph cannot be read, or is damaged.
        OutputError: `output` cannot be written.
    """
    if max_size < 1:
        raise InputError(f"max_size = {max_size}: it must be at least 1 pixel")
    photograph = open_photograph(path)
    longest = max(photograph.width, photograph.height)
    size = photograph.width, photograph.height
    if longest > max_size:
        size = (
            max(1, (2 * photograph.width * max_size + longest) // (2 * longest)),
            max(1, (2 * photograph.height * max_size + longest) // (2 * longest)),
        )
    files = [(output, 0, 0, *size)]
    recapture_photograph(photograph, None, size, files, _DECIMATED_JPEG_QUALITY)
    return longest / max(size)


def _is_grey(colormap: dict[int, tuple[int, ...]]) -> bool:
    return all(color[:3] == (index,) * 3 for index, color in colormap.items())


def _first_bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(4)
    except OSError as error:
        raise InputError(f"cannot open photograph {path}: {error.strerror}") from error


@contextmanager
def _raster(path: Path) -> Iterator[Any]:
    """An open rasterio dataset; its errors are InputErrors."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.Env(GDAL_CACHEMAX=_CACHE), rasterio.open(path) as raster:
                yield raster
    except RasterioError as error:
        reason = str(error.__cause__ or error).replace(f"{path}: ", "")
        raise InputError(
            f"photograph {path} is damaged or no image ({reason}): replace it by a good copy, or "
            "take it out of the folder"
        ) from error


def _bands(photograph: Photograph) -> Iterator[NDArray[np.uint8]]:
    """The rows, top to bottom, n x width x channels; whole rows of blocks, so that none is read
    twice."""
    from rasterio.windows import Window

    with _raster(photograph.path) as raster:
        block_rows = raster.block_shapes[0][0]
        step = max(block_rows, _BAND_ROWS // block_rows * block_rows)
        for y in range(0, photograph.height, step):
            rows = min(step, photograph.height - y)
            window = Window(0, y, photograph.width, rows)
            indexes = list(range(1, photograph.channels + 1))
            band = raster.read(indexes, window=window)
            yield np.ascontiguousarray(np.moveaxis(band, 0, 2))
