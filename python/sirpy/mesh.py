"""The mesh: the surface of each tile (mesh_tiles.py), joined (mesh_joints.py), in files (mesh_files.py)."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from sirpy.cloud import Cloud, positions
from sirpy.errors import BudgetError, InputError, OutputError
from sirpy.files import fingerprint, written_whole
from sirpy.memory import gigabytes
from sirpy.mesh_files import fits_glb, read_ply, write_glb, write_ply, written_mesh
from sirpy.mesh_joints import Joiner
from sirpy.mesh_tiles import (
    CUBE,
    TileTask,
    no_mesh,
    predicted_peak,
    read_piece,
    run_alone,
    write_piece,
    write_points,
)
from sirpy.products import open_cloud
from sirpy.progress import Progress
from sirpy.tiles import GridTiling, Tile, Tiling, tiling
from sirpy.workspace import Workspace

_MEMORY = 8_000_000_000
_FEWEST = 50  # points that make a surface
_MOST_TILES = 100_000
_DEPTHS = (10, 9, 8, 7)  # of the octrees that a tile is chosen for
_CELL = 1.5  # GSD
_CROWD = 2.0  # points on a square of one GSD, at most: stereo gives one, walls stand on few


@dataclass(frozen=True)
class MeshOptions:
    """Options of `mesh`; the lengths of reach and collar are in cells."""

    resolution: float | None = None  # size of Poisson's cells, unit of the frame; None: 1.5 GSD
    keep: float = 0.5  # share of the triangles that simplification leaves
    reach: float = (
        6.0  # surface further from every point is left out: gaps twice as wide are closed
    )
    collar: float = 24.0  # of points around a tile: what the surface within can feel
    per_tile: bool = False  # also each tile's mesh in a file of its own

    def __post_init__(self) -> None:
        if self.resolution is not None and not 0 < self.resolution < float("inf"):
            raise InputError(f"--resolution {self.resolution:g} is not possible: choose a length")
        if not 0 < self.keep <= 1:
            raise InputError(f"--keep {self.keep:g} is not possible: choose above 0, at most 1")
        if not 1 <= self.reach <= 100:
            raise InputError(f"--reach {self.reach:g} is not possible: choose 1 to 100 cells")
        if not 4 <= self.collar <= 1000:
            raise InputError(f"--collar {self.collar:g} is not possible: choose 4 to 1000 cells")
        if self.reach > self.collar:
            raise InputError(
                f"--reach {self.reach:g} is not possible: choose at most --collar ({self.collar:g}), "
                "so that neighbours leave out the same"
            )


@dataclass(frozen=True)
class FailedTile:
    """A tile whose surface could not be made, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class MeshResult:
    """`path`: the PLY; `glb`: one file, or one of each tile where one cannot hold so much."""

    path: Path
    glb: tuple[Path, ...]
    vertices: int
    triangles: int
    failed: tuple[FailedTile, ...]


def mesh(
    workspace: Workspace,
    *,
    tiles: str | None = None,
    options: MeshOptions | None = None,
    memory: int = _MEMORY,
    threads: int = 0,
    progress: Progress | None = None,
) -> MeshResult:
    """Makes mesh.ply and mesh.glb of the fused points.

    Args:
        tiles: "50" (a length), "quadkey:19"; squares that fit the memory if None.
        memory: bytes that all processes together may take. It also decides on the size of the tiles, and
            with it on the last digits of the result; the number of threads does not.
        threads: tiles at a time; 0: one for each core.

    Raises:
        InputError: there is no cloud or it has no points, an option is out of range, no tile has a surface.
        BudgetError: a tile needs more than the memory.
        OutputError: a file cannot be written.
    """
    options, progress = options or MeshOptions(), progress or Progress()
    if threads < 0:
        raise InputError(f"--threads {threads} is not possible: choose 0 or more")
    cloud = open_cloud(workspace)
    if not cloud.count:
        raise InputError(f"the cloud of {workspace.folder} has no points: there is nothing to mesh")
    cell = options.resolution or _CELL * cloud.gsd
    if not cell > 0:
        raise InputError("the cloud does not tell its GSD: choose a --resolution")
    chosen = _tiles(cloud, tiles, cell, options, memory)
    workers = _workers(chosen, cloud, cell, options, memory, threads)
    pieces = _Pieces(workspace, chosen, cell, options)
    failed = _make_pieces(pieces, cloud, workers, progress)
    with (
        progress.stage("joining the mesh", len(chosen), "tile") as steps,
        written_mesh(workspace.mesh) as writer,
    ):
        joiner = Joiner(writer, chosen, cell)
        for tile in chosen:
            pieces.join(tile, joiner)
            steps.advance()
        if not writer.faces:
            raise InputError(_nothing(failed))
    glb = _write_glb(workspace, joiner.ranges, cloud.frame.crs, options.per_tile, progress)
    return MeshResult(workspace.mesh, glb, writer.vertices, writer.faces, failed)


def _tiles(
    cloud: Cloud, text: str | None, cell: float, options: MeshOptions, memory: int
) -> list[Tile]:
    """Those that the cloud touches."""
    if text is None:
        chosen: Tiling = GridTiling(_side(cloud, cell, options, memory))
    else:
        chosen = tiling(text, cloud.frame)
    around = (*cloud.low[:2].tolist(), *cloud.high[:2].tolist())
    found = list(islice(chosen.tiles(*around), _MOST_TILES + 1))
    if len(found) > _MOST_TILES:
        raise InputError(f"--tiles {text} makes more than {_MOST_TILES} tiles: choose larger ones")
    return found


def _side(cloud: Cloud, cell: float, options: MeshOptions, memory: int) -> float:
    """Of square tiles, each of which takes a quarter of the memory at most."""
    for depth in _DEPTHS:
        cells = int(2**depth / CUBE)
        inner = cells - 2 * options.collar
        if inner > cells / 2 and _peak(cloud, cells, cell) <= memory / 4:
            digits = int(np.floor(np.log10(inner * cell))) - 1
            return float(np.floor(inner * cell / 10.0**digits) * 10.0**digits)
    raise BudgetError(
        f"the mesh needs more than --memory allows ({gigabytes(memory)}): allow more, "
        "or choose a smaller --collar"
    )


def _workers(
    tiles: list[Tile], cloud: Cloud, cell: float, options: MeshOptions, memory: int, threads: int
) -> int:
    """Tiles at a time."""
    extent = cloud.high[:2] - cloud.low[:2]
    widest = max(float(np.minimum(np.ptp(tile.corners, axis=0), extent).max()) for tile in tiles)
    peak = _peak(cloud, widest / cell + 2 * options.collar, cell)
    if peak > memory:
        raise BudgetError(
            f"a tile of {widest:.4g} in cells of {cell:.4g} needs {gigabytes(peak)}, more than "
            f"--memory allows ({gigabytes(memory)}): choose smaller --tiles or a larger --resolution"
        )
    return min(threads or os.cpu_count() or 1, memory // peak, len(tiles))


def _peak(cloud: Cloud, cells: float, cell: float) -> int:
    """Bytes for a tile with its collar."""
    box = float(np.prod(np.maximum(cloud.high[:2] - cloud.low[:2], cell)))
    density = _CROWD * max(cloud.gsd**-2 if cloud.gsd else 0.0, cloud.count / box)
    return predicted_peak(cells, min(density * (cells * cell) ** 2, cloud.count))


class _Pieces:
    """The surfaces of the tiles, kept until other options are asked for: what a killed run goes on from."""

    def __init__(
        self, workspace: Workspace, tiles: list[Tile], cell: float, options: MeshOptions
    ) -> None:
        self.tiles, self._cell, self._options = tiles, cell, options
        self.too_few = 0  # tiles that have points, but no surface
        what = [float(x) for x in (cell, options.keep, options.reach, options.collar)]
        self._folder = workspace.mesh_pieces(
            fingerprint(what, [tile.corners.tolist() for tile in tiles])
        )
        if self._folder.parent.is_dir():
            for other in set(self._folder.parent.iterdir()) - {self._folder}:
                shutil.rmtree(other)

    def _files(self, tile: Tile) -> tuple[Path, Path]:
        return self._folder / f"{tile.name}.vertices.npy", self._folder / f"{tile.name}.faces.npy"

    def made(self, tile: Tile) -> bool:
        return self._files(tile)[1].exists()

    def make(self, tile: Tile, cloud: Cloud) -> str | None:
        """Makes the surface of a tile; the sentence about what went wrong, if anything did."""
        x0, y0, x1, y1 = tile.bounds
        collar, reach = self._options.collar * self._cell, self._options.reach * self._cell
        points = cloud.inside(x0 - collar, y0 - collar, x1 + collar, y1 + collar)
        vertices, faces = self._files(tile)
        if len(points) < _FEWEST:
            write_piece(vertices, faces, no_mesh())
            self.too_few += len(points) > 0
            return None
        at = positions(points)
        # On a lattice that all tiles share, so that neighbours leave out the same.
        origin = np.round((at.min(axis=0) + at.max(axis=0)) / 2 / reach) * reach
        with _scratch(self._folder / f".{tile.name}.{os.getpid()}.tmp") as folder:
            task = TileTask(
                points=folder / "points.ply",
                origin=tuple(origin.tolist()),
                corners=tuple((x, y) for x, y in tile.corners.tolist()),
                cell=self._cell,
                reach=reach,
                keep=self._options.keep,
                vertices=vertices,
                faces=faces,
            )
            write_points(task.points, points, origin)
            del points, at  # while the other process works
            reason = run_alone(task, folder / "task.json")
            if reason and shutil.disk_usage(folder).free < task.points.stat().st_size:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))  # COLMAP does not say it
            return reason

    def join(self, tile: Tile, joiner: Joiner) -> None:
        mesh = read_piece(*self._files(tile)) if self.made(tile) else no_mesh()
        if len(mesh.faces):
            joiner.add(tile, mesh)
        else:
            joiner.skip(tile)


def _make_pieces(
    pieces: _Pieces, cloud: Cloud, workers: int, progress: Progress
) -> tuple[FailedTile, ...]:
    todo = [tile for tile in pieces.tiles if not pieces.made(tile)]
    if len(todo) < len(pieces.tiles):
        progress.note(f"{len(pieces.tiles) - len(todo)} tiles of the mesh are there already")
    failed: list[FailedTile] = []
    with (
        progress.stage("surfaces of the mesh", len(todo), "tile") as steps,
        ThreadPoolExecutor(workers) as pool,
    ):
        made = [pool.submit(pieces.make, tile, cloud) for tile in todo]
        try:
            for tile, future in zip(todo, made, strict=True):
                if reason := future.result():
                    failed.append(FailedTile(tile.name, reason))
                    progress.note(f"tile {tile.name} of the mesh is left out: {reason}")
                steps.advance()
        finally:
            pool.shutdown(cancel_futures=True)
    if pieces.too_few:
        progress.note(
            f"{pieces.too_few} tiles of the mesh have too few points for a surface (below {_FEWEST})"
        )
    return tuple(failed)


def _write_glb(
    workspace: Workspace,
    ranges: dict[str, list[tuple[int, int]]],
    crs: str | None,
    per_tile: bool,
    progress: Progress,
) -> tuple[Path, ...]:
    """mesh.glb if a GLB can hold the mesh, and the files of the tiles if they are wanted or it cannot."""
    vertices, triangles = read_ply(workspace.mesh)
    tiles = [*workspace.tiles_made("mesh.ply"), *workspace.tiles_made("mesh.glb")]
    for old in (workspace.mesh_glb, *tiles):  # of other options
        old.unlink(missing_ok=True)
    one = fits_glb(len(vertices), len(triangles))
    if one:
        write_glb(workspace.mesh_glb, vertices, triangles, crs)
    else:
        progress.note(
            f"the mesh has {len(triangles)} triangles, more than one GLB can hold: "
            "there is one of each tile instead"
        )
    if one and not per_tile:
        return (workspace.mesh_glb,)
    made = []
    with progress.stage("meshes of the tiles", len(ranges), "tile") as steps:
        for name, runs in ranges.items():
            own = np.concatenate([triangles["vertices"][at : at + n] for at, n in runs])
            used, faces = np.unique(own, return_inverse=True)
            ply, glb = workspace.tile(name, "mesh.ply"), workspace.tile(name, "mesh.glb")
            with written_whole(ply) as temporary:
                write_ply(temporary, vertices[used], faces.reshape(-1, 3))
            write_glb(glb, *read_ply(ply), crs)
            made.append(glb)
            steps.advance()
    return (workspace.mesh_glb,) if one else tuple(made)


def _nothing(failed: tuple[FailedTile, ...]) -> str:
    if failed:
        return f"no tile of the mesh could be made ({failed[0].name}: {failed[0].reason})"
    return "no tile has enough points for a mesh: choose a larger --resolution"


@contextmanager
def _scratch(folder: Path) -> Iterator[Path]:
    """A folder that is removed at the end.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        folder.mkdir(parents=True)
        yield folder
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(
            f"cannot write {folder.parent}: {error.strerror or error}; mend that, "
            "then run the same command again"
        ) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)
