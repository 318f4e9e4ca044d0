"""Types of the C++ core; arrays are C-contiguous unless said otherwise."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

# ---- sub_image: reading photographs, undistorting and cutting them, reading windows

def jpeg_shape(path: Path) -> tuple[int, int, int]:
    """(width, height, channels) from the header. InputError when it is no grey or RGB JPEG."""

def png_shape(path: Path) -> tuple[int, int, int, bool]:
    """(width, height, channels, has an alpha channel, which is not read)."""

class LensMap:
    """Positions in the photograph of the pixels of the undistorted image of `size` (width,
    height)."""

    def __init__(self, nodes: NDArray[np.float64], size: tuple[int, int]) -> None:
        """nodes: rows x columns x (x, y), evenly spaced from the first to the last pixel centre."""

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """n x 2 positions in the photograph of n x 2 positions in the undistorted image."""

class Recapture:
    """Photograph rows go in, sub-image files (path, x0, y0, width, height) come out."""

    def __init__(
        self,
        photograph: tuple[int, int, int],
        lens: LensMap | None,
        size: tuple[int, int],
        files: Sequence[tuple[Path, int, int, int, int]],
        jpeg_quality: int,
    ) -> None:
        """photograph: (width, height, channels); size: (width, height) of the image that is cut."""

    def push(self, rows: NDArray[np.uint8]) -> None:
        """The next rows, n x width x channels. Raises InputError, OutputError."""

    def finish(self) -> None:
        """After the last row."""

def recapture_jpeg(
    path: Path,
    photograph: tuple[int, int, int],
    lens: LensMap | None,
    size: tuple[int, int],
    files: Sequence[tuple[Path, int, int, int, int]],
    jpeg_quality: int,
) -> None:
    """All of a JPEG. Raises InputError (damaged), OutputError."""

def recapture_png(
    path: Path,
    photograph: tuple[int, int, int],
    lens: LensMap | None,
    size: tuple[int, int],
    files: Sequence[tuple[Path, int, int, int, int]],
    jpeg_quality: int,
) -> None:
    """All of a PNG. Raises InputError (damaged), OutputError."""

def read_window(
    path: Path, x0: int, y0: int, width: int, height: int, color: bool
) -> NDArray[np.uint8]:
    """A rectangle of a JPEG or PNG file: height x width grey, or height x width x 3 RGB."""
