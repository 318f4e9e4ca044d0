"""Meshes in files: PLY, written piece by piece, and GLB (glTF 2.0) made of it; neither is ever held whole."""

from __future__ import annotations

import json
import shutil
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from sirpy.errors import InputError
from sirpy.files import written_whole
from sirpy.frame import Floats
from sirpy.mesh_cutting import Indices
from sirpy.ply import read_vertices

VERTEX = np.dtype(
    [(name, "<f8") for name in ("x", "y", "z")]
    + [(name, "<f4") for name in ("nx", "ny", "nz")]
    + [(name, "u1") for name in ("red", "green", "blue")]
)
TRIANGLE = np.dtype([("count", "u1"), ("vertices", "<i4", 3)])
MOST_VERTICES = 2**31 - 1  # that the indices of a PLY count

_PLY_TYPES = {"f8": "double", "f4": "float", "u1": "uchar"}
_HEADER = 1024  # bytes that are kept free for it: it counts what is written after it
_CHUNK = 1 << 18  # vertices or triangles at a time
_MOST_GLB = 2**32 - 1  # bytes: its header counts in 32 bits
_MAGIC, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
_FLOAT, _UNSIGNED_INT = 5126, 5125


def ply_header(vertex: np.dtype[Any], vertices: int, faces: int, length: int = 0) -> bytes:
    """The header of a binary PLY of triangles, filled up to `length` bytes with a comment."""
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {vertices}"]
    for name in vertex.names or ():
        lines.append(f"property {_PLY_TYPES[vertex[name].str[1:]]} {name}")
    lines += [f"element face {faces}", "property list uchar int vertex_indices", "end_header\n"]
    missing = length - len("\n".join(lines)) - len("comment \n")
    if length:
        lines.insert(2, "comment " + "." * missing)
    return "\n".join(lines).encode()


def write_ply(path: Path, vertices: npt.NDArray[Any], faces: Indices) -> None:
    """A mesh that is in memory: structured vertices (n,), faces (m, 3)."""
    with path.open("wb") as file:
        file.write(ply_header(vertices.dtype, len(vertices), len(faces)))
        file.write(np.ascontiguousarray(vertices).data)
        file.write(_triangles(faces).data)


def read_ply(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Vertices (n,) and triangles (m,), mapped, of a PLY whose faces are triangles with int indices and come right
    after the vertices, as sirpy and COLMAP write it: fields "count" and "vertices".

    Raises:
        InputError: it is none, or cut short.
    """
    vertices = read_vertices(path)
    with path.open("rb") as file:
        header = file.read(1 << 16).partition(b"end_header\n")
    lines = header[0].decode("ascii", errors="replace").splitlines()
    words = {tuple(line.split()[:2]): line.split() for line in lines}
    count = int(words.get(("element", "face"), ["0"])[-1])
    size = {"uchar": "u1", "int": "<i4"}.get(words.get(("property", "list"), [""] * 3)[2])
    dtype = np.dtype([("count", size or "u1"), ("vertices", "<i4", 3)])
    offset = len(header[0]) + len(header[1]) + vertices.nbytes
    if path.stat().st_size != offset + count * dtype.itemsize:
        raise InputError(f"{path} is no whole mesh of triangles: make it again")
    if not count:
        return vertices, np.empty(0, dtype)
    return vertices, np.memmap(path, dtype, mode="r", offset=offset, shape=(count,))


class MeshWriter:
    """Writes a PLY whose vertices and triangles come in pieces. See `written_mesh`."""

    def __init__(self, vertices: IO[bytes], faces: IO[bytes]) -> None:
        self._vertices, self._faces = vertices, faces
        self.vertices = self.faces = 0  # written so far

    def add_vertices(self, vertices: npt.NDArray[Any]) -> int:
        """Writes vertices (n,) of VERTEX; the index of the first."""
        first = self.vertices
        self.vertices += len(vertices)
        if self.vertices > MOST_VERTICES:
            raise InputError(
                "the mesh has more vertices than a PLY can count (2147483647): "
                "choose a larger --resolution or a smaller --keep"
            )
        self._vertices.write(vertices.astype(VERTEX).data)
        return first

    def add_faces(self, faces: Indices) -> int:
        """Writes triangles (m, 3); the index of the first."""
        first = self.faces
        self.faces += len(faces)
        self._faces.write(_triangles(faces).data)
        return first


@contextmanager
def written_mesh(path: Path) -> Iterator[MeshWriter]:
    """A writer of the PLY `path`, which is there when the block has ended well.

    The triangles wait in a file without a name until all vertices are written.

    Raises:
        OutputError: the file cannot be written.
    """
    with (
        written_whole(path) as temporary,
        temporary.open("wb") as file,
        TemporaryFile(dir=temporary.parent) as faces,
    ):
        file.write(bytes(_HEADER))
        writer = MeshWriter(file, faces)
        yield writer
        faces.seek(0)
        shutil.copyfileobj(faces, file, _CHUNK)
        file.seek(0)
        file.write(ply_header(VERTEX, writer.vertices, writer.faces, _HEADER))


def glb_size(vertices: int, faces: int) -> int:
    """Bytes of the binary chunk: positions, normals and colours, 12 each, and indices."""
    return 36 * vertices + 12 * faces


def fits_glb(vertices: int, faces: int) -> bool:
    """Whether a GLB can hold that much: its header counts bytes in 32 bits."""
    return glb_size(vertices, faces) + _HEADER * 4 <= _MOST_GLB


def write_glb(
    path: Path, vertices: npt.NDArray[Any], faces: npt.NDArray[Any], crs: str | None
) -> None:
    """A GLB of a mesh as `read_ply` gives it: y up, around a place that its `extras` tell.

    world = origin + (x, -z, y) of the GLB. Colours are linear, as glTF wants them.

    Raises:
        OutputError: the file cannot be written.
    """
    low, high = _bounds(vertices)
    origin = np.round((low + high) / 2)
    ends = [(bound - origin).astype("<f4").astype(float).tolist() for bound in (low, high)]
    place = {"origin": origin.tolist(), "crs": crs}
    document = json.dumps(_document(len(vertices), len(faces), ends, place)).encode()
    document += b" " * (-len(document) % 4)
    binary = glb_size(len(vertices), len(faces))
    whole = 12 + 8 + len(document) + 8 + binary
    linear = _linear_of_srgb()
    with written_whole(path) as temporary, temporary.open("wb") as file:
        file.write(struct.pack("<III", _MAGIC, 2, whole))
        file.write(struct.pack("<II", len(document), _JSON) + document)
        file.write(struct.pack("<II", binary, _BINARY))
        for names, dtype in (("xyz", "<f8"), (("nx", "ny", "nz"), "<f4")):
            shift = origin if names == "xyz" else np.zeros(3)
            for chunk in _chunks(vertices):
                values = np.column_stack([chunk[name].astype(dtype) for name in names]) - shift
                file.write(values.astype("<f4").data)
        for chunk in _chunks(vertices):
            colours = np.column_stack([chunk[name] for name in ("red", "green", "blue")])
            file.write(linear[colours].data)
        for chunk in _chunks(faces):
            file.write(np.ascontiguousarray(chunk["vertices"], "<u4").data)


def _document(
    vertices: int, faces: int, ends: list[list[float]], place: dict[str, Any]
) -> dict[str, Any]:
    """The JSON of the GLB: one mesh of triangles."""
    size = 12 * vertices
    views = [{"buffer": 0, "byteOffset": i * size, "byteLength": size} for i in range(3)]
    views.append({"buffer": 0, "byteOffset": 3 * size, "byteLength": 12 * faces})
    of_vertices = {"componentType": _FLOAT, "count": vertices, "type": "VEC3"}
    accessors: list[dict[str, Any]] = [{"bufferView": i, **of_vertices} for i in range(3)]
    accessors[0] |= {"min": ends[0], "max": ends[1]}
    accessors.append(
        {"bufferView": 3, "componentType": _UNSIGNED_INT, "count": 3 * faces, "type": "SCALAR"}
    )
    attributes = {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}
    y_up = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]  # by columns: (x, y, z) -> (x, z, -y)
    return {
        "asset": {"version": "2.0", "generator": "sirpy", "extras": place},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "mesh", "mesh": 0, "matrix": y_up, "extras": place}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0}, "doubleSided": True}],
        "buffers": [{"byteLength": glb_size(vertices, faces)}],
        "bufferViews": views,
        "accessors": accessors,
    }


def _bounds(vertices: npt.NDArray[Any]) -> tuple[Floats, Floats]:
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for chunk in _chunks(vertices):
        xyz = np.column_stack([chunk["x"], chunk["y"], chunk["z"]])
        low, high = np.minimum(low, xyz.min(axis=0)), np.maximum(high, xyz.max(axis=0))
    return low, high


def _linear_of_srgb() -> npt.NDArray[np.float32]:
    """(256,) the linear value of each sample value (IEC 61966-2-1)."""
    value = np.arange(256) / 255
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return linear.astype("<f4")


def _chunks(array: npt.NDArray[Any]) -> Iterator[npt.NDArray[Any]]:
    for first in range(0, len(array), _CHUNK):
        yield np.array(array[first : first + _CHUNK])


def _triangles(faces: Indices) -> npt.NDArray[Any]:
    triangles = np.empty(len(faces), TRIANGLE)
    triangles["count"], triangles["vertices"] = 3, faces
    return triangles
