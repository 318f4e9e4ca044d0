"""Arrays in files of numpy's format .npy: written whole, opened on disk, and one sentence where that fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
import numpy.typing as npt

from sirpy.errors import InputError
from sirpy.files import written_whole


def write_npy(path: Path, array: npt.NDArray[Any]) -> None:
    """Writes an array whole or not at all.

    np.save does not tell a full disk from other troubles.

    Raises:
        OutputError: the file cannot be written.
    """
    array = np.ascontiguousarray(array)
    header = np.lib.format.header_data_from_array_1_0(array)
    with written_whole(path) as temporary, temporary.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        file.write(array.data)


@contextmanager
def written_npy(path: Path, dtype: np.dtype[Any]) -> Iterator[Callable[[npt.NDArray[Any]], None]]:
    """Yields what appends arrays (n,) to a file, which is whole or not there; nothing is held.

    Raises:
        OutputError: the file cannot be written.
    """
    count = 0

    def header() -> bytes:
        # As long for every number of rows.
        text = f"{{'descr': {dtype.descr!r}, 'fortran_order': False, 'shape': ({count:20d},), }}"
        padding = -(10 + len(text) + 1) % 64
        line = (text + " " * padding + "\n").encode("latin1")
        return b"\x93NUMPY\x01\x00" + len(line).to_bytes(2, "little") + line

    with written_whole(path) as temporary, temporary.open("wb") as file:
        file.write(header())

        def append(rows: npt.NDArray[Any]) -> None:
            nonlocal count
            file.write(np.ascontiguousarray(rows, dtype).data)
            count += len(rows)

        yield append
        file.seek(0)
        file.write(header())


def open_npy(
    path: Path, dtype: npt.DTypeLike, shape: tuple[int | None, ...], stage: str
) -> npt.NDArray[Any]:
    """The array of a file, on disk: read where it is used.

    Args:
        shape: that it must have; None for any number.
        stage: what made the file, for the sentence.

    Raises:
        InputError: there is no such file, or it is damaged, or of another type or shape.
    """
    try:
        array: npt.NDArray[Any] = np.lib.format.open_memmap(path, mode="r")
    except FileNotFoundError:
        raise InputError(f"there is no {path}: run {stage} again") from None
    # What stands in a damaged header is parsed as Python.
    except (OSError, ValueError, TypeError, OverflowError, SyntaxError, TokenError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise InputError(
            f"cannot read {path} ({reason or 'it is damaged'}): delete it and run {stage} again"
        ) from None
    fits = len(shape) == array.ndim and all(
        asked in (None, found) for asked, found in zip(shape, array.shape, strict=True)
    )
    if not fits or array.dtype != dtype:
        raise InputError(
            f"{path} is of another type or size than {stage} makes: delete it and run {stage} again"
        )
    return array
