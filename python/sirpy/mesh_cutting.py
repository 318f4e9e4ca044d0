"""Triangle meshes of one tile of the ground, and cutting them along the tile's sides.

The sides are vertical planes. Every triangle that crosses one is cut exactly there; vertices that lie on it know so,
which is what the joint with the neighbour is made of.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sirpy.frame import Floats

Indices = npt.NDArray[np.int64]

# Nearer than this to a side, in cells, a vertex is moved onto it: triangles thinner than that help nobody.
_SNAP = 0.05


@dataclass(frozen=True, eq=False)
class TileMesh:
    """A surface whose triangles go counter-clockwise when seen from outside.

    Attributes:
        positions: (n, 3), in the frame.
        normals: (n, 3) float32, unit.
        colours: (n, 3) uint8.
        sides: (n,) uint8: bit i where the vertex lies on the side from corner i to corner i + 1 of the tile.
        faces: (m, 3), indices of vertices.
    """

    positions: Floats
    normals: npt.NDArray[np.float32]
    colours: npt.NDArray[np.uint8]
    sides: npt.NDArray[np.uint8]
    faces: Indices


def cut(mesh: TileMesh, corners: Floats, cell: float) -> TileMesh:
    """The part of a mesh that lies in a convex quadrilateral.

    Args:
        corners: (4, 2), counter-clockwise, x and y.
        cell: length of the mesh's finest edges.
    """
    for side in range(4):
        mesh = _cut_at(mesh, side, corners, _SNAP * cell)
    return without_unused(mesh)


def without_unused(mesh: TileMesh) -> TileMesh:
    """The same without vertices that no triangle has."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return _chosen(mesh, used, faces.reshape(-1, 3))


def open_edges(faces: Indices) -> tuple[Indices, Indices]:
    """The edges that one triangle alone has: their vertices (e, 2), in its direction, and 3 * face + corner (e,)."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    low, high = edges.min(axis=1), edges.max(axis=1)
    _, which, count = np.unique(
        low * (edges.max(initial=0) + 1) + high, return_inverse=True, return_counts=True
    )
    alone = np.flatnonzero(count[which] == 1)
    return edges[alone], alone


def _cut_at(mesh: TileMesh, side: int, corners: Floats, snap: float) -> TileMesh:
    """Keeps what lies left of the vertical plane through two corners."""
    along = np.roll(corners, -1, axis=0) - corners
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    inward = np.array([-along[side, 1], along[side, 0]])
    height = (mesh.positions[:, :2] - corners[side]) @ inward
    near = np.abs(height) < snap
    positions, sides = mesh.positions.copy(), mesh.sides.copy()
    positions[near, :2] -= height[near, None] * inward
    for earlier in {side - 1, (side + 1) % 4} & set(range(side)):  # what lies there stays there
        both = near & ((sides >> earlier) & 1).astype(bool)
        way = along[earlier] / (along[earlier] @ inward)
        positions[both, :2] = mesh.positions[both, :2] - height[both, None] * way
    sides[near] |= 1 << side
    height[near] = 0
    mesh = TileMesh(positions, mesh.normals, mesh.colours, sides, mesh.faces)
    of_faces = height[mesh.faces]
    # A triangle within the plane belongs to neither side: the joint closes over it.
    kept = (of_faces >= 0).all(axis=1) & (of_faces > 0).any(axis=1)
    crossing = (of_faces > 0).any(axis=1) & (of_faces < 0).any(axis=1)
    mesh, pieces = _crossed(mesh, mesh.faces[crossing], height, side)
    return _chosen(mesh, None, np.concatenate([mesh.faces[kept], pieces]))


def _crossed(mesh: TileMesh, faces: Indices, height: Floats, side: int) -> tuple[TileMesh, Indices]:
    """The mesh with new vertices where the edges of `faces` cross the plane, and the inner parts of `faces`."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    edges = np.sort(edges, axis=1)  # both triangles of an edge cut it by the same sum
    cuts = height[edges[:, 0]] * height[edges[:, 1]] < 0
    unique, which = np.unique(edges[cuts], axis=0, return_inverse=True)
    first, second = unique.T
    part = height[first] / (height[first] - height[second])
    on_edge = np.full(len(edges), -1)
    on_edge[cuts] = len(mesh.positions) + which.reshape(-1)

    def between(values: Floats) -> Floats:
        mixed: Floats = values[first] + part[:, None] * (values[second] - values[first])
        return mixed

    normals = between(mesh.normals.astype(np.float64))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    colours = np.rint(between(mesh.colours.astype(np.float64))).astype(np.uint8)
    sides = (mesh.sides[first] & mesh.sides[second]) | np.uint8(1 << side)
    grown = TileMesh(
        np.concatenate([mesh.positions, between(mesh.positions)]),
        np.concatenate([mesh.normals, normals.astype(np.float32)]),
        np.concatenate([mesh.colours, colours]),
        np.concatenate([mesh.sides, sides]),
        mesh.faces,
    )
    return grown, _inner_parts(faces, on_edge.reshape(-1, 3), height)


def _inner_parts(faces: Indices, new: Indices, height: Floats) -> Indices:
    """Triangles of the left parts of crossing triangles; `new` (m, 3): the vertex on the edge from each corner."""
    parts = [np.empty((0, 3), np.int64)]
    for corner in range(3):
        a, b, c = (np.roll(faces, -corner, axis=1)[:, i] for i in range(3))
        ab, ca = (np.roll(new, -corner, axis=1)[:, i] for i in (0, 2))
        ha, hb, hc = height[a], height[b], height[c]
        alone = (ha > 0) & (hb < 0) & (hc < 0)
        parts.append(np.column_stack([a, ab, ca])[alone])
        outside = (ha < 0) & (hb > 0) & (hc > 0)
        parts.append(np.column_stack([ab, b, c])[outside])
        parts.append(np.column_stack([ab, c, ca])[outside])
        next_on = (ha > 0) & (hb == 0) & (hc < 0)
        parts.append(np.column_stack([a, b, ca])[next_on])
        last_on = (ha > 0) & (hb < 0) & (hc == 0)
        parts.append(np.column_stack([a, ab, c])[last_on])
    return np.concatenate(parts)


def _chosen(mesh: TileMesh, vertices: Indices | None, faces: Indices) -> TileMesh:
    """With these vertices only (all if None), and with these faces, which count among them."""
    if vertices is None:
        return TileMesh(mesh.positions, mesh.normals, mesh.colours, mesh.sides, faces)
    return TileMesh(
        mesh.positions[vertices],
        mesh.normals[vertices],
        mesh.colours[vertices],
        mesh.sides[vertices],
        faces.astype(np.int64),
    )
