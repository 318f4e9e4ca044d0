"""Meshes of tiles become one: along their joints they get the same vertices, each once.

Tiles come one after the other. What comes later is laid onto what is there (mesh_matching.py): vertices of the
newcomer's border move onto the border of its neighbour, a small part of a cell, and both sides' border triangles are
split at the vertices of the other. Only the triangles along open joints are kept in memory, and at most those of a
row of tiles are open at a time.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from sirpy.frame import Floats
from sirpy.mesh_cutting import Indices, TileMesh, open_edges
from sirpy.mesh_files import VERTEX, MeshWriter
from sirpy.mesh_matching import TOLERANCE, match
from sirpy.tiles import Tile

_Corner = tuple[float, float]
_Line = frozenset[_Corner]  # between two corners of the tiling


@dataclass(eq=False)
class _BorderFaces:
    """The triangles of a tile along its border, until all its joints are made.

    Attributes:
        faces: (m, 3) of the whole mesh's vertices.
        inserts: what else lies on an edge, by 3 * face + corner that the edge begins at, in its direction.
        joints: how many are still to be made.
    """

    tile: str
    faces: Indices
    joints: int = 0
    inserts: dict[int, list[int]] = field(default_factory=dict)

    def split(self) -> Indices:
        """As triangles (k, 3) of which none has a vertex within an edge."""
        touched = sorted({place // 3 for place in self.inserts})
        pieces = [np.delete(self.faces, touched, axis=0)]
        for face in touched:
            inserts = [self.inserts.get(3 * face + corner, []) for corner in range(3)]
            pieces.append(np.array(_split(self.faces[face].tolist(), inserts), np.int64))
        return np.concatenate(pieces)


@dataclass(frozen=True, eq=False)
class _Border:
    """One side of a tile, open.

    Attributes:
        vertices: (n,) of VERTEX; `numbers` (n,) are theirs in the whole mesh.
        edges: (e, 2) indices of `vertices`, as the triangles go.
        places: (e,), 3 * face + corner in `faces`.
    """

    vertices: npt.NDArray[Any]
    numbers: Indices
    edges: Indices
    places: Indices
    faces: _BorderFaces


class Joiner:
    """Joins the meshes of tiles into one that is written while they come.

    Attributes:
        ranges: of each tile, where its triangles are in the file: first and count of each run.
    """

    def __init__(self, writer: MeshWriter, tiles: Iterable[Tile], cell: float) -> None:
        """Takes all tiles that will come; `cell`: length of the meshes' finest edges."""
        self._writer, self._cell = writer, cell
        self._to_come = Counter(line for tile in tiles for line, _ in _sides(tile))
        self._borders: dict[_Line, _Border] = {}
        self._corners: dict[_Corner, list[tuple[float, int]]] = defaultdict(list)
        self.ranges: dict[str, list[tuple[int, int]]] = defaultdict(list)

    def skip(self, tile: Tile) -> None:
        """A tile that has no mesh."""
        for line, _ in _sides(tile):
            self._to_come[line] -= 1
            if border := self._borders.pop(line, None):
                self._made(border.faces)

    def add(self, tile: Tile, mesh: TileMesh) -> None:
        """Writes the mesh of a tile, as `cut` made it, joined to those that came before."""
        newcomer = _Newcomer(mesh)
        self._find_corners(tile, newcomer)
        edges, places = open_edges(mesh.faces)
        at_border, which = np.unique(places // 3, return_inverse=True)
        places = 3 * which + places % 3
        held = _BorderFaces(tile.name, mesh.faces[at_border])
        open_sides, joined = [], []
        for line, side in _sides(tile):
            on_side = ((mesh.sides[edges] >> side) & 1).all(axis=1)
            self._to_come[line] -= 1
            if border := self._borders.pop(line, None):
                newcomer.join(line, border, edges[on_side], places[on_side], held, self._cell)
                joined.append(border.faces)
            elif self._to_come[line]:
                open_sides.append((line, edges[on_side], places[on_side]))
        numbers = newcomer.number(self._writer)
        self._remember_corners(tile, newcomer)
        held.faces = numbers[held.faces]
        self._write(tile.name, numbers[np.delete(mesh.faces, at_border, axis=0)])
        held.joints = 1 + len(open_sides)
        for line, of_side, at in open_sides:
            used, of_used = np.unique(of_side, return_inverse=True)
            self._borders[line] = _Border(
                newcomer.vertices[used], numbers[used], of_used.reshape(-1, 2), at, held
            )
        for faces in [*joined, held]:
            self._made(faces)

    def _find_corners(self, tile: Tile, newcomer: _Newcomer) -> None:
        """Vertices above a corner that another tile has already."""
        for corner, vertex in _corner_vertices(tile, newcomer.mesh):
            height = newcomer.vertices["z"][vertex]
            known = [(abs(z - height), number) for z, number in self._corners[corner]]
            if known and min(known)[0] <= TOLERANCE * self._cell:
                newcomer.numbers[vertex] = min(known)[1]

    def _remember_corners(self, tile: Tile, newcomer: _Newcomer) -> None:
        for corner, vertex in _corner_vertices(tile, newcomer.mesh):
            known = self._corners[corner]
            number = int(newcomer.numbers[vertex])
            if all(number != other for _, other in known):
                known.append((float(newcomer.vertices["z"][vertex]), number))

    def _made(self, faces: _BorderFaces) -> None:
        """One more joint of these triangles is made; after the last they are written."""
        faces.joints -= 1
        if faces.joints == 0:
            self._write(faces.tile, faces.split())

    def _write(self, tile: str, faces: Indices) -> None:
        a, b, c = faces.T
        faces = faces[(a != b) & (b != c) & (c != a)]
        if len(faces):
            self.ranges[tile].append((self._writer.add_faces(faces), len(faces)))


class _Newcomer:
    """The mesh of a tile that is being joined.

    Attributes:
        vertices: (n,) of VERTEX.
        numbers: (n,) in the whole mesh; -1 where not known yet.
    """

    def __init__(self, mesh: TileMesh) -> None:
        self.mesh = mesh
        self.vertices = _records(mesh)
        self.numbers = np.full(len(self.vertices), -1)
        self._same = np.arange(len(self.vertices))  # the vertex that each has become
        self._into: list[tuple[_BorderFaces, int, list[int]]] = []  # edges that vertices lie on

    def join(
        self,
        line: _Line,
        border: _Border,
        edges: Indices,
        places: Indices,
        held: _BorderFaces,
        cell: float,
    ) -> None:
        """Lays the edges (e, 2) of one side, at `places` of `held`, onto the border of the neighbour."""
        used, edges = np.unique(edges, return_inverse=True)
        index = {int(number): i for i, number in enumerate(border.numbers)}
        in_corner = np.array([int(sides).bit_count() > 1 for sides in self.mesh.sides[used]], bool)
        known = np.flatnonzero(in_corner | (self.numbers[used] >= 0))
        same = {int(i): index.get(int(self.numbers[used[i]]), -1) for i in known}
        found = match(
            _plane(border.vertices, line) / cell,
            border.edges,
            _plane(self.vertices[used], line) / cell,
            edges.reshape(-1, 2)[:, ::-1],
            same,
        )
        on_edges: dict[int, dict[float, int]] = defaultdict(dict)
        for i, place in found.places.items():
            vertex = int(used[i])
            ends = border.edges[place.edge]
            if place.part in (0, 1):
                self.numbers[vertex] = border.numbers[ends[int(place.part)]]
            else:
                self._same[vertex] = on_edges[place.edge].setdefault(place.part, vertex)
                self.vertices[vertex] = _between(border.vertices[ends], place.part)
        for edge, parts in on_edges.items():
            inside = [parts[part] for part in sorted(parts)]
            self._into.append((border.faces, int(border.places[edge]), inside))
        for edge, inserted in found.inserts.items():
            if inserted:
                held.inserts[int(places[edge])] = border.numbers[inserted[::-1]].tolist()

    def number(self, writer: MeshWriter) -> Indices:
        """Writes the vertices that are new; the numbers (n,) of all."""
        new = np.flatnonzero((self.numbers < 0) & (self._same == np.arange(len(self._same))))
        self.numbers[new] = writer.add_vertices(self.vertices[new]) + np.arange(len(new))
        self.numbers = self.numbers[self._same]
        for faces, place, inside in self._into:
            faces.inserts[place] = self.numbers[inside].tolist()
        return self.numbers


def _split(face: Sequence[int], inserts: Sequence[Sequence[int]]) -> list[Sequence[int]]:
    """A triangle with further vertices on its edges (the first from corner 0 to 1), as triangles."""
    for corner in range(3):
        if inserts[corner]:
            a, b, c = (face[(corner + i) % 3] for i in range(3))
            after, last = inserts[(corner + 1) % 3], inserts[(corner + 2) % 3]
            chain = [a, *inserts[corner], b]
            parts: list[Sequence[int]] = []
            for i, (begin, end) in enumerate(pairwise(chain)):
                rest = [(), after if i == len(chain) - 2 else (), last if i == 0 else ()]
                parts += _split((begin, end, c), rest)
            return parts
    return [face]


def _sides(tile: Tile) -> list[tuple[_Line, int]]:
    corners = [(float(x), float(y)) for x, y in tile.corners]
    return [(frozenset((corners[i], corners[(i + 1) % 4])), i) for i in range(4)]


def _corner_vertices(tile: Tile, mesh: TileMesh) -> Iterator[tuple[_Corner, int]]:
    for corner in range(4):
        both = 1 << corner | 1 << (corner + 3) % 4
        x, y = tile.corners[corner]
        for vertex in np.flatnonzero((mesh.sides & both) == both):
            yield (float(x), float(y)), int(vertex)


def _plane(vertices: npt.NDArray[Any], line: _Line) -> Floats:
    """(n, 2) coordinates in the vertical plane through a line: along it, and z."""
    begin, end = (np.array(corner) for corner in sorted(line))
    along = (end - begin) / np.linalg.norm(end - begin)
    xy = np.column_stack([vertices["x"], vertices["y"]])
    return np.column_stack([(xy - begin) @ along, vertices["z"]])


def _between(ends: npt.NDArray[Any], part: float) -> npt.NDArray[Any]:
    """A vertex of VERTEX at a part of the way between two."""
    begin, end = ends
    middle: npt.NDArray[Any] = ends[0].copy()
    for name in VERTEX.names or ():
        value = (1 - part) * float(begin[name]) + part * float(end[name])
        middle[name] = round(value) if VERTEX[name].kind == "u" else value
    return middle


def _records(mesh: TileMesh) -> npt.NDArray[Any]:
    records = np.empty(len(mesh.positions), VERTEX)
    for axis in range(3):
        records["xyz"[axis]] = mesh.positions[:, axis]
        records[("nx", "ny", "nz")[axis]] = mesh.normals[:, axis]
        records[("red", "green", "blue")[axis]] = mesh.colours[:, axis]
    return records
