"""Photographs: finding them, reading their rows, recapturing and decimating them.

JPEG and PNG go through libjpeg-turbo and libpng, everything else through GDAL by bands of rows;
never whole when it can be avoided. Rows are decoded by one thread while those before are worked on.
Pixels are as stored, 8 or 16 bit: an EXIF orientation is not applied, since COLMAP solves cameras
without it.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from sirpy import _core
from sirpy.errors import InputError
from sirpy.rectangle import Rectangle

_EXTENSIONS = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff", ".jp2", ".bmp"})
_JPEG = b"\xff\xd8\xff"
_PNG = b"\x89PNG"
_CACHE = 64  # of GDAL's blocks, MB; its default is a share of the machine's memory
_BAND_ROWS = 64
_BAND_COLUMNS = 4096
_LARGEST_BLOCK = 64_000_000  # bytes, decoded, whatever the file's size
_LARGEST_RATIO = 2000  # of decoded bytes to stored ones; Deflate reaches 1032
_BRIGHTER_THAN_WHITE = 0.001  # share of the samples of a 16-bit photograph

Bands = Literal["color", "all"]
Interpolation = Literal["nearest", "bilinear", "bicubic", "lanczos"]
Chroma = Literal["444", "422", "420"]


def check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Raises InputError unless `value` is one of `choices`."""
    if value not in choices:
        raise InputError(
            f"{name} = {value!r} is not possible: it must be one of {', '.join(choices)}"
        )


@dataclass(frozen=True)
class Photograph:
    """What the header of a photograph says."""

    path: Path
    width: int
    height: int
    channels: int
    """Those that are read: 1 grey or 3 RGB, or every band."""
    bits: int
    """Of a sample: 8 or 16."""
    format: str
    """GDAL's name of it: JPEG, PNG, GTiff ..."""
    bands: Bands = "color"
    alpha: bool = False
    """The last of `channels` is alpha."""
    held_bytes: int = 0
    """What reading it takes beside a band of rows: coefficients of a progressive JPEG, rows of tall
    blocks of a TIFF."""
    note: str = ""
    """What the user should know about how it is read; mostly empty."""

    @property
    def shape(self) -> tuple[int, int, int, int]:
        return self.width, self.height, self.channels, self.bits // 8


@dataclass(frozen=True)
class Encoding:
    """How JPEGs are written: quality 1 to 100, chroma at full resolution or subsampled."""

    jpeg_quality: int = 95
    jpeg_chroma: Chroma = "444"

    def __post_init__(self) -> None:
        if not 1 <= self.jpeg_quality <= 100:
            raise InputError(
                f"jpeg_quality = {self.jpeg_quality} is not possible: it must be 1 to 100"
            )
        check_choice("jpeg_chroma", self.jpeg_chroma, get_args(Chroma))


_DECIMATED = Encoding(97)


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


def check_masks(masks: Path | str | None) -> None:
    """Raises InputError where masks are asked for and there is no such folder."""
    if masks is not None and not Path(masks).is_dir():
        raise InputError(f"there is no folder {masks}: give the folder that holds the masks")


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
        if not path.name or str(path) != name or "\0" in name or "\n" in name:
            raise InputError(f"the model has an image with the unusable name {name!r}: rename it")


def open_photograph(path: Path, bands: Bands = "color") -> Photograph:
    """Reads the header.

    Args:
        bands: "color" for grey or RGB; "all" for alpha and infrared too.

    Raises:
        InputError: missing, no image, or of a kind that is not supported (CMYK, palette, float).
    """
    if not path.is_file():
        raise InputError(
            f"there is no photograph {path}: put it there, or take it out of the model"
        )
    start = _first_bytes(path)
    if start.startswith((_JPEG, _PNG)):
        (width, height, channels, sample_bytes), alpha, held = _core.image_header(path, bands)
        note = f"{path.name}: its alpha channel is not used" if alpha and bands == "color" else ""
        kind = "JPEG" if start.startswith(_JPEG) else "PNG"
        return Photograph(
            path,
            width,
            height,
            channels,
            8 * sample_bytes,
            kind,
            bands,
            alpha and bands == "all",
            int(held * width * height),
            note,
        )
    with _raster(path) as raster:
        kinds = set(raster.dtypes)
        if kinds not in ({"uint8"}, {"uint16"}):
            raise InputError(
                f"photograph {path} has samples of type {', '.join(sorted(kinds))}: convert them to "
                "8 or 16 bit without sign"
            )
        if raster.colorinterp[0].name == "palette" and not _is_grey(raster.colormap(1)):
            raise InputError(f"photograph {path} has a palette: convert it to RGB or grey")
        channels = 3 if raster.count >= 3 else 1
        alpha = raster.colorinterp[-1].name == "alpha"
        note = ""
        if raster.count != channels:
            named = "first three bands" if channels == 3 else "first band"
            note = f"{path.name}: only the {named} of {raster.count} are used"
        if bands == "all":
            channels, note = raster.count, ""
        bits = 8 * np.dtype(raster.dtypes[0]).itemsize
        return Photograph(
            path,
            raster.width,
            raster.height,
            channels,
            bits,
            raster.driver,
            bands,
            alpha and bands == "all",
            _held_bytes(raster, channels * bits // 8),
            note,
        )


def _held_bytes(raster: Any, pixel_bytes: int) -> int:
    """Of rows of blocks: those that are worked on, those that come, and GDAL's own.

    Raises:
        InputError: a block is larger than a file of that size can hold; buffers would follow it.
    """
    rows, columns = (int(side) for side in raster.block_shapes[0])
    file_size = os.stat(raster.name).st_size
    if rows * columns * pixel_bytes > max(_LARGEST_BLOCK, _LARGEST_RATIO * file_size):
        raise InputError(
            f"photograph {raster.name} is damaged (it is too short for its size in pixels): replace it "
            "by a good copy, or take it out of the folder"
        )
    # A block is read before it is decoded; where there is only one, that is the whole file.
    stored = int(raster.get_tag_item("BLOCK_SIZE_0_0", "TIFF", bidx=1) or 0)
    row_bytes = int(raster.width) * pixel_bytes
    cached = min(1_000_000 * _CACHE, row_bytes * int(raster.height))
    return 3 * _block_rows(rows) * row_bytes + stored + cached


def _block_rows(rows: int) -> int:
    """Rows that are read at once: whole blocks, so that none is decoded twice."""
    return max(rows, _BAND_ROWS // rows * rows)


def photograph_size(path: Path) -> tuple[int, int]:
    """(width, height) in pixels, from the header. Raises InputError as `open_photograph`."""
    photograph = open_photograph(path)
    return photograph.width, photograph.height


def recapture_to_files(
    photograph: Photograph,
    lens: _core.LensMap | None,
    size: tuple[int, int],
    files: list[tuple[Path, Rectangle]],
    *,
    interpolation: Interpolation = "bilinear",
    encoding: Encoding = Encoding(),
    white: int = 0,
) -> None:
    """Undistorts a photograph and cuts it into `files` in one pass over its rows.

    Args:
        lens: positions in the photograph of undistorted pixels; None copies the pixels.
        size: (width, height) of the image that is cut; the undistorted image is shrunk to it.
        files: paths (.jpg, .png, .tif) and what they hold of that image, in its pixels.
        white: 16 bit is written as 8 bit so that this sample is 255; 0 for as it is.

    Raises:
        InputError: the photograph is damaged; files that were finished before are whole, and stay.
        OutputError: a file cannot be written.
    """
    _recapture(photograph, lens, size, files, interpolation, encoding, white=white)


def recapture_to_array(
    photograph: Photograph,
    lens: _core.LensMap | None,
    size: tuple[int, int],
    rectangle: Rectangle,
    *,
    interpolation: Interpolation = "bilinear",
) -> NDArray[Any]:
    """The same for one rectangle: its pixels, height x width x channels, uint8 or uint16."""
    only = [(Path(), rectangle)]
    made = _recapture(photograph, lens, size, only, interpolation, Encoding(), in_memory=True)
    return made.take_pixels()


def push_rows(photograph: Photograph, cutter: _core.PatchCutter) -> None:
    """Decodes what `cutter` needs of a photograph, once.

    Raises:
        InputError: the photograph is damaged.
    """
    if photograph.format in ("JPEG", "PNG"):
        cutter.read(photograph.path)
        return
    for rows in _read_ahead(_rows(photograph, cutter.first_row)):
        cutter.push(rows)
        if cutter.done:
            break


def white_level(photograph: Photograph) -> int:
    """The sample value that shows as white: of 16 bits, what one sample in a thousand exceeds.

    Raises:
        InputError: the photograph is damaged.
    """
    if photograph.bits == 8:
        return 255
    if photograph.format == "PNG":
        return _white(_core.count_samples(photograph.path))
    count = np.zeros(1 << 16, np.int64)
    for rows in _rows(photograph, 0):
        seen = rows[..., : 3 if photograph.channels >= 3 else 1]
        count += np.bincount(seen.ravel(), minlength=count.size)
    return _white(count)


def decimate(path: Path, output: Path, max_size: int) -> float:
    """Writes a photograph with a longest side of at most `max_size` pixels as 8-bit JPEG (4:4:4).

    Every output pixel is the mean of the input pixels under it, weighted by area. A photograph that
    is small enough is written at its own size; it is read whole in any case, so damage shows. Of 16
    bits, what one pixel in a thousand exceeds becomes white.

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
    files = [(output, Rectangle(0, 0, *size))]
    white = white_level(photograph) if photograph.bits == 16 else 0
    recapture_to_files(photograph, None, size, files, encoding=_DECIMATED, white=white)
    return longest / max(size)


def _recapture(
    photograph: Photograph,
    lens: _core.LensMap | None,
    size: tuple[int, int],
    files: list[tuple[Path, Rectangle]],
    interpolation: Interpolation,
    encoding: Encoding,
    *,
    in_memory: bool = False,
    white: int = 0,
) -> _core.Recapture:
    recapture = _core.Recapture(
        photograph=photograph.shape,
        lens=lens,
        interpolation=interpolation,
        size=size,
        files=[(path, *stored.as_tuple()) for path, stored in files],
        jpeg_quality=encoding.jpeg_quality,
        jpeg_chroma=encoding.jpeg_chroma,
        last_is_alpha=photograph.alpha,
        in_memory=in_memory,
        white=white,
    )
    if photograph.format in ("JPEG", "PNG"):
        recapture.read(photograph.path, photograph.bands)
        return recapture
    for rows in _read_ahead(_rows(photograph, recapture.first_row)):
        recapture.push(rows)
        if recapture.done:
            break
    recapture.finish()
    return recapture


def _white(count: NDArray[np.int64]) -> int:
    """The least value above 0 that at most one sample in a thousand exceeds; `count` is by value."""
    exceeding = count.sum() - np.cumsum(count)
    return max(1, int(np.argmax(exceeding <= _BRIGHTER_THAN_WHITE * count.sum())))


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


def _rows(photograph: Photograph, first: int) -> Iterator[NDArray[Any]]:
    """Its rows from `first` on, n x width x channels; no block of the file is decoded twice."""
    from rasterio.windows import Window

    indexes = list(range(1, photograph.channels + 1))
    with _raster(photograph.path) as raster:
        block_rows, block_columns = raster.block_shapes[0]
        step = _block_rows(block_rows)
        across = max(block_columns, _BAND_COLUMNS // block_columns * block_columns)
        for y in range(first // step * step, photograph.height, step):
            count = min(step, photograph.height - y)
            rows = np.empty(
                (count, photograph.width, photograph.channels), f"uint{photograph.bits}"
            )
            # Some blocks at a time, so that GDAL's cache never has to hold a row of them.
            for x in range(0, photograph.width, across):
                columns = min(across, photograph.width - x)
                part = raster.read(indexes, window=Window(x, y, columns, count))
                rows[:, x : x + columns] = np.moveaxis(part, 0, 2)
            yield rows[max(0, first - y) :]


def _read_ahead(blocks: Iterator[NDArray[Any]]) -> Iterator[NDArray[Any]]:
    """The same blocks; the next one is made by another thread meanwhile."""
    # All of it happens in that one thread, since GDAL's environment is one of the thread.
    with ThreadPoolExecutor(1) as thread:
        try:
            coming = thread.submit(next, blocks, None)
            while (block := coming.result()) is not None:
                coming = thread.submit(next, blocks, None)
                yield block
        finally:
            thread.submit(blocks.close).result()  # type: ignore[attr-defined]
