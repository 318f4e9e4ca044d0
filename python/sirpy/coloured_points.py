"""The points of a cloud and their colours from PLY, LAS or LAZ, some at a time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sirpy.errors import InputError
from sirpy.ply import read_chunks, read_vertices

Floats = npt.NDArray[np.float64]
Colours = npt.NDArray[np.uint8]

AT_ONCE = 1 << 18  # points
_COLOURS = ("red", "green", "blue")
_LAS = (".las", ".laz")


def read_coloured(path: Path, size: int = AT_ONCE) -> Iterator[tuple[Floats, Colours]]:
    """Finite points (n, 3) and their RGB (n, 3), in the order of the file, `size` at most at a time.

    Raises:
        InputError: the file cannot be read, or its points have no colours.
    """
    chunks = _read_las if path.suffix.lower() in _LAS else _read_ply
    for points, colours in chunks(path, size):
        finite = np.isfinite(points).all(axis=1)
        yield points[finite], colours[finite]


def _read_ply(path: Path, size: int) -> Iterator[tuple[Floats, Colours]]:
    kind = read_vertices(path).dtype
    if any(name not in (kind.names or ()) for name in _COLOURS):
        raise _colourless(path)
    if any(kind[name] != np.uint8 for name in _COLOURS):
        raise InputError(
            f"the colours of {path} are not of 8 bits: write red, green and blue as uchar"
        )
    for part in read_chunks(path, size):
        yield _columns(part, ("x", "y", "z"), np.float64), _columns(part, _COLOURS, np.uint8)


def _read_las(path: Path, size: int) -> Iterator[tuple[Floats, Colours]]:
    import laspy
    import lazrs

    try:
        with laspy.open(path) as reader:
            if "red" not in reader.header.point_format.dimension_names:
                raise _colourless(path)
            shift = None
            for part in reader.chunk_iterator(size):
                colours = _columns(part, _COLOURS, np.uint16)
                if shift is None:  # 16 bits by the format, of which some writers fill 8
                    shift = 8 if colours.size and colours.max() > 255 else 0
                places = np.column_stack([np.asarray(part[name]) for name in "xyz"])
                yield places.astype(np.float64), (colours >> shift).astype(np.uint8)
    except OSError as error:
        raise InputError(
            f"the point cloud {path} cannot be read: {error.strerror or error}"
        ) from None
    except (laspy.LaspyException, lazrs.LazrsError, ValueError, RuntimeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"the point cloud {path} is damaged ({error}): write it again") from None


def _columns(part: Any, names: tuple[str, ...], kind: Any) -> npt.NDArray[Any]:
    return np.column_stack([np.asarray(part[name]) for name in names]).astype(kind)


def _colourless(path: Path) -> InputError:
    return InputError(
        f"the points of {path} have no colours, by which they are compared with photographs: give "
        "a cloud with red, green and blue"
    )
