"""Point clouds in binary little-endian PLY, as sirpy, COLMAP and OpenMVS write it, read and written by parts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sirpy.errors import InputError
from sirpy.files import written_whole

_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "<i2",
    "int16": "<i2",
    "ushort": "<u2",
    "uint16": "<u2",
    "int": "<i4",
    "int32": "<i4",
    "uint": "<u4",
    "uint32": "<u4",
    "float": "<f4",
    "float32": "<f4",
    "double": "<f8",
    "float64": "<f8",
}
_LONGEST_HEADER = 65536
_DIGITS = 20  # room for the number of vertices; readers pass over blanks at the end of a line


def read_vertices(path: Path | str) -> NDArray[Any]:
    """The vertices of a PLY file as a structured array that is mapped, not loaded: (points,).

    Its fields are the file's properties: x, y, z and, where the file has them, nx, ny, nz, red,
    green, blue.

    Raises:
        InputError: there is no such file, or it is not a whole binary little-endian PLY whose first
            element is `vertex` with x, y and z.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            head = file.read(_LONGEST_HEADER)
    except OSError as error:
        raise InputError(f"the point cloud {path} cannot be read: {error.strerror}") from None
    header, end, _ = head.partition(b"end_header\n")
    lines = header.decode("ascii", errors="replace").splitlines()
    if not end or lines[:1] != ["ply"] or "format binary_little_endian 1.0" not in lines:
        raise InputError(f"{path} is not a binary little-endian PLY file: convert it to one")
    count, fields = _vertex_layout(path, lines)
    data_type = np.dtype(fields)
    offset = len(header) + len(end)
    if path.stat().st_size < offset + count * data_type.itemsize:
        raise InputError(f"the point cloud {path} is cut short: write it again")
    if count == 0:  # an empty file cannot be mapped
        return np.empty(0, data_type)
    return np.memmap(path, data_type, mode="r", offset=offset, shape=(count,))


def read_chunks(path: Path | str, size: int) -> Iterator[NDArray[Any]]:
    """The vertices of a PLY file, `size` at most at a time.

    Mapped anew for each chunk: what has been read would count as memory while the file is mapped.

    Raises:
        InputError: as `read_vertices`.
    """
    for begin in range(0, len(read_vertices(path)), size):
        yield np.array(read_vertices(path)[begin : begin + size])


def _vertex_layout(path: Path, lines: list[str]) -> tuple[int, list[tuple[str, str]]]:
    count, fields = -1, []
    for words in (line.split() for line in lines):
        if words[:1] == ["element"]:
            if count >= 0:
                break
            if words[1] != "vertex":
                raise InputError(f"the first element of {path} is not `vertex`: cannot read it")
            count = int(words[2])
        elif words[:1] == ["property"]:
            if words[1] not in _TYPES:
                raise InputError(f"the vertices of {path} have a property that is no number")
            fields.append((words[2], _TYPES[words[1]]))
    if count < 0 or not {"x", "y", "z"} <= {name for name, _ in fields}:
        raise InputError(f"{path} holds no vertices with x, y and z")
    return count, fields


def write_vertices(path: Path, dtype: np.dtype[Any], chunks: Iterable[NDArray[Any]]) -> int:
    """Writes points as binary little-endian PLY, chunk by chunk; returns their number.

    Args:
        dtype: of the chunks, a structured array's; its fields become the properties.

    Raises:
        OutputError: the file cannot be written.
    """
    names = {np.dtype(code): name for name, code in _TYPES.items() if not name[-1].isdecimal()}
    properties = [f"property {names[dtype[field]]} {field}" for field in dtype.names or ()]

    def header(count: int) -> bytes:
        lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count:<{_DIGITS}}"]
        return ("\n".join([*lines, *properties, "end_header"]) + "\n").encode("ascii")

    count = 0
    with written_whole(path) as temporary, temporary.open("wb") as file:
        file.write(header(0))
        for chunk in chunks:
            file.write(chunk.tobytes())
            count += len(chunk)
        file.seek(0)  # how many there are is known at the end
        file.write(header(count))
    return count
