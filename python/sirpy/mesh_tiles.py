"""The surface of one tile, in a process of its own: Poisson, trimmed, simplified, cut at the tile's sides.

    python -m sirpy.mesh_tiles TASK.json PARENT

COLMAP's Poisson (Kazhdan and Hoppe, "Screened Poisson Surface Reconstruction", 2013) ends its process at what it
cannot solve and keeps what it has allocated; and its threads add in any order. Alone, with one thread, it does
neither harm, and its result is the same each time.

Two points far out in opposite corners hold the octree's cube open, so that the cells of all tiles have the same size
whatever part of them has points.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sirpy.child_process import how_it_ended, serve
from sirpy.cloud import Points, positions
from sirpy.errors import InputError, SirpyError
from sirpy.files import written_whole
from sirpy.frame import Floats
from sirpy.mesh_cutting import Indices, TileMesh, cut
from sirpy.mesh_files import VERTEX, read_ply, write_ply
from sirpy.npy import open_npy, write_npy
from sirpy.ply import read_vertices
from sirpy.point_groups import PointGroups

_PIECE = np.dtype([*VERTEX.descr, ("sides", "u1")])
_POINT = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    + [(name, "u1") for name in ("red", "green", "blue")]
)

CUBE = 1.1  # the octree's, in widths of the box around the points: PoissonRecon's own
_DEEPEST = 16
# Bytes at the peak; measured with pycolmap 4.0.4 at depths 8 to 10: 80 MB of a process that has imported it, and
# of 0.5 kB (Poisson) to 0.7 kB (simplification) per triangle, of which a square of the ground as wide as a cell
# has 3.2 where there are buildings and trees.
_PROCESS, _CELL, _PER_POINT = 0.1e9, 2300, 200


@dataclass(frozen=True)
class TileTask:
    """What the process is asked; lengths in the frame's unit.

    `points` are float32, relative to `origin`; their folder is the process's own to work in.
    """

    points: Path
    origin: tuple[float, float, float]
    corners: tuple[tuple[float, float], ...]
    cell: float
    reach: float  # surface further than this from every point is left out
    keep: float  # share of the triangles that simplification leaves
    vertices: Path
    faces: Path

    def write(self, path: Path) -> None:
        with written_whole(path) as temporary:
            temporary.write_text(json.dumps(asdict(self), default=str), encoding="utf-8")

    @staticmethod
    def read(path: Path) -> TileTask:
        task = json.loads(path.read_text(encoding="utf-8"))
        for name in ("points", "vertices", "faces"):
            task[name] = Path(task[name])
        return TileTask(**task)


def predicted_peak(cells: float, points: float) -> int:
    """Bytes for a tile of `cells` by `cells` cells with its collar, with so many points."""
    return int(_PROCESS + _CELL * cells**2 + _PER_POINT * points)


def write_points(path: Path, points: Points, origin: Floats) -> None:
    """The points as Poisson reads them, around `origin`: float32 has no room for coordinates on the Earth."""
    written = np.empty(len(points), _POINT)
    around = positions(points) - origin
    for axis, name in enumerate("xyz"):
        written[name] = around[:, axis]
    for name in ("nx", "ny", "nz", "red", "green", "blue"):
        written[name] = points[name]
    write_ply(path, written, _NO_FACES)


def run_alone(task: TileTask, task_file: Path) -> str | None:
    """Solves a task in a process of its own; the sentence about what went wrong, if anything did."""
    task.write(task_file)
    process = subprocess.Popen(
        [sys.executable, "-m", "sirpy.mesh_tiles", str(task_file), str(os.getpid())],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        # PoissonRecon asks for as many threads as the machine has, whatever its options say.
        env={**os.environ, "OMP_THREAD_LIMIT": "1"},
    )
    try:
        _, said = process.communicate()
    finally:
        process.kill()  # only SIGKILL is sure to end a process with COLMAP in it
        process.wait()
    lines = said.decode(errors="replace").strip().splitlines()
    how = how_it_ended(process.returncode)
    if how is None:
        return None
    return lines[-1] if process.returncode > 0 and lines else f"its process {how}"


def solve(task: TileTask) -> None:
    """Points to the piece of the mesh within the tile."""
    points = read_vertices(task.points)
    surface = _supported(_poisson(task, points), _xyz(points), task)
    mesh = no_mesh()
    if len(surface[1]):
        mesh = _finished(_simplified(surface, task), points, task)
    write_piece(task.vertices, task.faces, mesh)


def write_piece(vertices: Path, faces: Path, mesh: TileMesh) -> None:
    """The faces last: who finds them finds all."""
    written = np.empty(len(mesh.positions), _PIECE)
    for axis in range(3):
        written["xyz"[axis]] = mesh.positions[:, axis]
        written[("nx", "ny", "nz")[axis]] = mesh.normals[:, axis]
        written[("red", "green", "blue")[axis]] = mesh.colours[:, axis]
    written["sides"] = mesh.sides
    write_npy(vertices, written)
    write_npy(faces, mesh.faces.astype("<i4"))


def no_mesh() -> TileMesh:
    """What a tile without a surface has."""
    nothing = np.empty((0, 3))
    return TileMesh(
        nothing,
        nothing.astype(np.float32),
        nothing.astype(np.uint8),
        np.empty(0, np.uint8),
        nothing.astype(np.int64),
    )


def read_piece(vertices: Path, faces: Path) -> TileMesh:
    """Raises InputError where a file is damaged."""
    read = np.array(open_npy(vertices, _PIECE, (None,), "`sirpy mesh`"))
    triangles = np.array(open_npy(faces, "<i4", (None, 3), "`sirpy mesh`"), np.int64)
    if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(read):
        raise InputError(f"{faces} is damaged: delete it and run `sirpy mesh` again")
    return TileMesh(
        positions(read),
        np.column_stack([read["nx"], read["ny"], read["nz"]]),
        np.column_stack([read["red"], read["green"], read["blue"]]),
        read["sides"].copy(),
        triangles,
    )


_NO_FACES = np.empty((0, 3), np.int64)
_PLACE = np.dtype([(name, "<f4") for name in "xyz"])

Surface = tuple[
    npt.NDArray[np.float32], Indices
]  # positions around the origin (n, 3), faces (m, 3)


def _poisson(task: TileTask, points: Points) -> Surface:
    import pycolmap

    low, high = _xyz(points).min(axis=0), _xyz(points).max(axis=0)
    depth = int(np.ceil(np.log2(CUBE * (high - low).max() / task.cell)))
    if depth > _DEEPEST:
        raise InputError(
            f"its points lie {(high - low).max():g} apart, too far for cells of {task.cell:g}: "
            "remove what lies far off, or choose a larger --resolution"
        )
    depth = max(depth, 5)
    half = task.cell * 2**depth / CUBE / 2
    ends = np.zeros(2, _POINT)
    for axis, middle in zip("xyz", (low + high) / 2, strict=True):
        ends[axis] = middle - half, middle + half
    ends["nz"] = 1
    cloud, result = task.points.with_name("held.ply"), task.points.with_name("poisson.ply")
    write_ply(cloud, np.concatenate([points, ends]), _NO_FACES)
    options = pycolmap.PoissonMeshingOptions(depth=depth, color=False, trim=0.0, num_threads=1)
    pycolmap.poisson_meshing(cloud, result, options)
    return _read_surface(result)


def _supported(surface: Surface, points: npt.NDArray[np.float32], task: TileTask) -> Surface:
    """Without what Poisson made up far from any point, and without what lies far outside of the tile."""
    vertices, faces = surface
    groups = PointGroups(points, np.empty((len(points), 0)), task.reach)
    _, distance = groups.nearest(vertices)
    corners = np.array(task.corners) - task.origin[:2]
    margin = 8 * task.cell  # simplification changes what lies near an open border
    low, high = corners.min(axis=0) - margin, corners.max(axis=0) + margin
    inside = ((vertices[:, :2] >= low) & (vertices[:, :2] <= high)).all(axis=1)
    kept = inside & (distance <= task.reach)
    return _compact(vertices, faces[kept[faces].all(axis=1)])


def _simplified(surface: Surface, task: TileTask) -> Surface:
    """By quadric errors (Garland and Heckbert, 1997), of at most one cell."""
    if task.keep == 1:
        return surface
    import pycolmap

    vertices, faces = surface
    fine, coarse = task.points.with_name("fine.ply"), task.points.with_name("coarse.ply")
    write_ply(fine, np.ascontiguousarray(vertices).view(_PLACE)[:, 0], faces)
    options = pycolmap.MeshSimplificationOptions(
        target_face_ratio=task.keep, max_error=task.cell**2, num_threads=1
    )
    pycolmap.simplify_mesh(fine, coarse, options)
    vertices, faces = _read_surface(coarse)
    # Where it has folded a part of the surface onto itself, two triangles have the same corners.
    _, which, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return _compact(vertices, faces[count[which.reshape(-1)] == 1])


def _finished(surface: Surface, points: Points, task: TileTask) -> TileMesh:
    """In the frame, with normals and the colours of the nearest points, cut."""
    vertices, faces = surface
    mesh = TileMesh(
        vertices + np.array(task.origin),
        _normals(vertices, faces),
        _colours(vertices, points, task),
        np.zeros(len(vertices), np.uint8),
        faces,
    )
    return cut(mesh, np.array(task.corners), task.cell)


def _normals(vertices: npt.NDArray[np.float32], faces: Indices) -> npt.NDArray[np.float32]:
    """Of the vertices: the mean of their triangles', by area."""
    a, b, c = (vertices[faces[:, corner]].astype(np.float64) for corner in range(3))
    across = np.cross(b - a, c - a)
    normals = np.zeros((len(vertices), 3))
    for corner in range(3):
        for axis in range(3):
            normals[:, axis] += np.bincount(faces[:, corner], across[:, axis], len(vertices))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return normals.astype(np.float32)


def _colours(
    vertices: npt.NDArray[np.float32], points: Points, task: TileTask
) -> npt.NDArray[np.uint8]:
    """Of the nearest points, as many as a cell holds: simplification keeps no colours."""
    colours = np.zeros((len(vertices), 3), np.uint8)
    of_points = np.column_stack([points["red"], points["green"], points["blue"]])
    todo, size = np.arange(len(vertices)), task.cell
    while len(todo):
        groups = PointGroups(_xyz(points), of_points, size)
        group, _ = groups.nearest(vertices[todo])
        colours[todo[group >= 0]] = np.rint(groups.values[group[group >= 0]])
        todo, size = todo[group < 0], 4 * size
    return colours


def _compact(vertices: npt.NDArray[np.float32], faces: Indices) -> Surface:
    used, renumbered = np.unique(faces, return_inverse=True)
    return vertices[used], renumbered.reshape(-1, 3)


def _xyz(points: Points) -> npt.NDArray[np.float32]:
    return np.column_stack([points["x"], points["y"], points["z"]])


def _read_surface(path: Path) -> Surface:
    vertices, triangles = read_ply(path)
    return _xyz(vertices), triangles["vertices"].astype(np.int64)


def main() -> None:
    """TASK.json and the caller's process id."""
    serve(int(sys.argv[2]))
    try:
        solve(TileTask.read(Path(sys.argv[1])))
    except SirpyError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
