"""Small squares recaptured from one photograph, kept in a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sirpy import _core
from sirpy.errors import InputError, OutputError
from sirpy.photographs import open_photograph, push_rows


@dataclass(frozen=True)
class PatchStore:
    """n squares of `side` pixels.

    Attributes:
        origins: (n, 2) their top-left pixels (x, y) in the photograph.
        white: luma of the brightest pixels.
        grey_level: luma of what pixels are rounded to.
    """

    path: Path
    side: int
    origins: NDArray[np.int64]
    white: int
    grey_level: int

    def read(self, rows: NDArray[np.int64]) -> NDArray[np.uint16]:
        """The luma of some squares, (m, side, side), 16 bit."""
        patches = np.empty((len(rows), self.side, self.side), np.uint16)
        size = patches[:1].nbytes
        with self.path.open("rb") as file:
            for patch, row in zip(patches, rows.tolist(), strict=True):
                file.seek(row * size)
                file.readinto(patch.data.cast("B"))
        return patches

    def indices(self, rows: NDArray[np.int64], xy: NDArray[np.float64]) -> NDArray[np.int32]:
        """The pixels (x, y) within their squares that hold positions (m, 2) of the photograph."""
        return (np.floor(xy).astype(np.int64) - self.origins[rows]).astype(np.int32)


def cut_patches(
    photograph: Path, size: tuple[int, int], xy: NDArray[np.float64], side: int, path: Path
) -> PatchStore:
    """Cuts squares around positions (n, 2) in native pixels and writes them to `path`; near the edges of the
    photograph they are moved inside. The photograph is decoded once, by rows.

    Raises:
        InputError: the photograph is damaged, has another size than `size` or is smaller than a square.
        OutputError: `path` cannot be written.
    """
    opened = open_photograph(photograph)
    if (opened.width, opened.height) != size:
        raise InputError(
            f"photograph {photograph} has {opened.width}x{opened.height} pixels, but its camera in the model "
            f"{size[0]}x{size[1]}: give the photographs that the model was made of"
        )
    if min(size) < side:
        raise InputError(
            f"photograph {photograph} has {opened.width}x{opened.height} pixels: it is too small for tie points "
            f"of {side} pixels"
        )
    origins = np.clip(np.floor(xy).astype(np.int64) - side // 2, 0, np.array(size) - side)
    origins = np.ascontiguousarray(origins, np.int64)
    cutter = _core.PatchCutter(opened.shape, origins, side)
    push_rows(opened, cutter)
    patches = cutter.take(side)
    grey_level = 256 if opened.bits == 8 else 1
    white = 255 * grey_level if opened.bits == 8 else int(patches.max(initial=1))
    try:
        with path.open("wb") as file:
            patches.tofile(file)
    except OSError as error:
        raise OutputError(
            f"cannot write {path} ({error.strerror or error}): free some space there"
        ) from error
    return PatchStore(path, side, origins, white, grey_level)
