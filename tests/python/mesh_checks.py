"""What a joined mesh must be, and surfaces of tiles to join without Poisson."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from sirpy.mesh_cutting import Indices, TileMesh, cut
from sirpy.mesh_files import read_ply, written_mesh
from sirpy.mesh_joints import Joiner
from sirpy.tiles import Tile

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Joints:
    """Of the edges that lie on the joints of a mesh.

    Attributes:
        closed, open: lengths of those with a face on each side, and on one side only.
        non_manifold: edges of the whole mesh that have more than two faces, or two in one direction.
        plan: area of the whole mesh seen from above.
        folded: area of the faces that are seen from below there.
    """

    closed: float
    open: float
    non_manifold: int
    plan: float
    folded: float


def joints_of(path: Path, tiles: Sequence[Tile]) -> Joints:
    """Looks at a PLY that was joined of `tiles`."""
    vertices, triangles = read_ply(path)
    places = np.column_stack([vertices[name] for name in "xyz"])
    faces = triangles["vertices"].astype(np.int64)
    assert np.array_equal(np.unique(faces), np.arange(len(vertices)))  # none unused
    directed = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    edges, count = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)
    twice = len(directed) - len(np.unique(directed, axis=0))
    length = np.linalg.norm(places[edges[:, 0]] - places[edges[:, 1]], axis=1)
    on_joint = np.zeros(len(edges), bool)
    for begin, end in _inner_lines(tiles):
        along = (end - begin) / np.linalg.norm(end - begin)
        away = (places[:, :2] - begin) @ [-along[1], along[0]]
        at = (places[:, :2] - begin) @ along
        on = (np.abs(away) < 1e-6) & (at > -1e-6) & (at < np.linalg.norm(end - begin) + 1e-6)
        on_joint |= on[edges].all(axis=1)
    area = plan_areas(places, faces)
    return Joints(
        closed=float(length[on_joint & (count == 2)].sum()),
        open=float(length[on_joint & (count == 1)].sum()),
        non_manifold=int((count > 2).sum()) + twice,
        plan=float(area.sum()),
        folded=float(-area[area < 0].sum()),
    )


def plan_areas(places: Floats, faces: Indices) -> Floats:
    """Of each face, seen from above; negative where it is seen from below."""
    a, b, c = (places[faces[:, corner], :2] for corner in range(3))
    u, v = b - a, c - a
    areas: Floats = (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2
    return areas


def bumpy(xy: Floats) -> Floats:
    """Heights."""
    heights: Floats = np.sin(xy[:, 0] / 3) * np.cos(xy[:, 1] / 4) + 0.2 * np.sin(xy[:, 0])
    return heights


def tile_surface(
    tile: Tile, seed: int, noise: float = 0.02, height: Callable[[Floats], Floats] = bumpy
) -> TileMesh:
    """The surface of a tile with a collar, in triangles of its own of about 0.5, cut at its sides."""
    random = np.random.default_rng(seed)
    x0, y0, x1, y1 = tile.bounds
    x, y = np.arange(x0 - 2, x1 + 2, 0.5), np.arange(y0 - 2, y1 + 2, 0.5)
    xy = np.stack(np.meshgrid(x, y), axis=2) + random.uniform(-0.12, 0.12, (len(y), len(x), 2))
    index = np.arange(len(y) * len(x)).reshape(len(y), len(x))
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(one, axis=2).reshape(-1, 3) for one in ([a, b, c], [a, c, d])])
    flat = xy.reshape(-1, 2)
    z = height(flat) + random.uniform(-noise, noise, len(flat))
    mesh = TileMesh(
        np.column_stack([flat, z]),
        np.tile(np.array([0, 0, 1], np.float32), (len(flat), 1)),
        np.full((len(flat), 3), 100, np.uint8),
        np.zeros(len(flat), np.uint8),
        faces,
    )
    return cut(mesh, tile.corners, 0.5)


def join(path: Path, tiles: Sequence[Tile], meshes: Sequence[TileMesh | None]) -> Joiner:
    with written_mesh(path) as writer:
        joiner = Joiner(writer, tiles, 0.5)
        for tile, mesh in zip(tiles, meshes, strict=True):
            if mesh is None:
                joiner.skip(tile)
            else:
                joiner.add(tile, mesh)
    return joiner


def _inner_lines(tiles: Sequence[Tile]) -> list[tuple[Floats, Floats]]:
    seen, inner = set(), []
    for tile in tiles:
        for begin, end in zip(tile.corners, np.roll(tile.corners, -1, axis=0), strict=True):
            line = frozenset((tuple(begin), tuple(end)))
            if line in seen:
                inner.append((begin, end))
            seen.add(line)
    return inner
