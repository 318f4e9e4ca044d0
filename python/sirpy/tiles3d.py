"""3D Tiles of the cloud, which a browser streams: OUT/tiles3d/tileset.json, made by py3dtiles.

py3dtiles gets the points in a frame of east, north and up around the cloud's middle, where their boxes are tight and
32 bits are precise; the transform of the root tile puts them on the Earth.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from sirpy.cloud import Cloud, Points, positions
from sirpy.errors import InputError, OutputError
from sirpy.files import folder_written_whole, write_text
from sirpy.frame import Floats
from sirpy.laz import lattice, write_las
from sirpy.products import open_cloud
from sirpy.progress import Progress
from sirpy.workspace import Workspace

_WORKER = "sirpy.tiles3d_worker"
_GEOCENTRIC = "EPSG:4978"  # what 3D Tiles are in


def tiles3d(workspace: Workspace, *, progress: Progress | None = None) -> Path:
    """Makes 3D Tiles of the fused cloud; returns their tileset.json.

    Without a CRS they are in the local frame, and no globe shows them in their place; that is said.

    Raises:
        InputError: there is no cloud, it has no points, or py3dtiles is not installed.
        OutputError: the tiles cannot be written.
    """
    if find_spec("py3dtiles") is None:
        raise InputError('3D Tiles need py3dtiles: pip install "sirpy[tiles3d]"')
    progress = progress or Progress()
    cloud = open_cloud(workspace)
    if cloud.count == 0:
        raise InputError(f"the cloud of {workspace.folder} has no points: there is nothing to tile")
    place = Place(cloud)
    if cloud.frame.crs is None:
        progress.note("tiles3d: in the local frame, since the model has no place on the Earth")
    with (
        progress.stage("tiles3d", 2, "step") as step,
        folder_written_whole(workspace.tiles3d) as folder,
    ):
        points = folder.with_name(f"{folder.name}.las")
        try:
            write_las(points, place.points(cloud), lattice(cloud)[0], np.zeros(3))
            step.advance()
            _run(points, folder)
        finally:
            points.unlink(missing_ok=True)
        _finish(folder / "tileset.json", place.earth_from_local)
        step.advance()
    return workspace.tiles3d / "tileset.json"


class Place:
    """Where a cloud's own frame lies: its origin is the middle of the cloud, its axes east, north and up.

    Attributes:
        earth_from_local: (4, 4), geocentric (EPSG:4978); in a frame without a CRS, frame_from_local.
    """

    def __init__(self, cloud: Cloud) -> None:
        """Raises InputError where the cloud's CRS is unknown or has no such place."""
        middle = np.round((cloud.low + cloud.high) / 2)
        self.earth_from_local: Floats = np.eye(4)
        self._earth_from_frame = None
        if cloud.frame.crs is None:
            self.earth_from_local[:3, 3] = middle
            return
        from pyproj import CRS, Transformer

        crs = CRS.from_user_input(cloud.frame.crs)
        # Heights without a vertical CRS are above the ellipsoid, as GPS gives them.
        solid = crs if len(crs.axis_info) > 2 else crs.to_3d()
        self._earth_from_frame = Transformer.from_crs(solid, _GEOCENTRIC, always_xy=True)
        degrees = Transformer.from_crs(solid, "EPSG:4979", always_xy=True)
        longitude, latitude = np.radians(degrees.transform(*middle)[:2])
        self.earth_from_local[:3, :3] = _axes(longitude, latitude)
        self.earth_from_local[:3, 3] = self._earth_from_frame.transform(*middle)
        if not np.isfinite(self.earth_from_local).all():
            raise InputError(f"the cloud lies outside {cloud.frame.crs}: check the georeference")

    def points(self, cloud: Cloud) -> Iterator[Points]:
        """All points of the cloud in this frame, some thousand at a time; their normals are not turned."""
        for points in cloud.runs():
            local = self.local(positions(points))
            for axis, name in enumerate("xyz"):
                points[name] = local[:, axis]
            yield points

    def local(self, world: Floats) -> Floats:
        """Points (n, 3) of the cloud's frame, in its own."""
        if self._earth_from_frame is not None:
            world = np.column_stack(self._earth_from_frame.transform(*world.T))
        moved: Floats = (world - self.earth_from_local[:3, 3]) @ self.earth_from_local[:3, :3]
        return moved


def _axes(longitude: float, latitude: float) -> Floats:
    """East, north and up at a place (radians), as columns, geocentric."""
    east = [-np.sin(longitude), np.cos(longitude), 0.0]
    up = [
        np.cos(latitude) * np.cos(longitude),
        np.cos(latitude) * np.sin(longitude),
        np.sin(latitude),
    ]
    return np.column_stack([east, np.cross(up, east), up])


def _run(points: Path, folder: Path) -> None:
    """In a process of its own: py3dtiles forks, which a process with threads does not survive."""
    command = [sys.executable, "-m", _WORKER, str(points), str(folder)]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()
        reason = said[-1] if said else f"exit status {done.returncode}"
        raise OutputError(f"3D Tiles could not be made in {folder.parent} ({reason})")


def _finish(path: Path, earth_from_local: Floats | None = None) -> Floats:
    """Mends a tileset that py3dtiles wrote, and those that it holds, and puts it into its place.

    Takes out the date of its making. The box of a tile that is a tileset of its own may be smaller than what is in
    it, which a viewer would then not draw at the edge of its view: boxes are made to hold those below them.

    Returns:
        The corners (2, 3) around it, in the frame of what holds it.
    """
    tileset = json.loads(path.read_text(encoding="utf-8"))
    tileset["asset"].get("extras", {}).pop("created_date", None)
    root = tileset["root"]
    around = _grow(root, path.parent)
    if earth_from_local is not None:
        root["transform"] = (earth_from_local @ _transform(root)).T.ravel().tolist()
    write_text(path, json.dumps(tileset, separators=(",", ":")))
    return around


def _grow(tile: dict[str, Any], folder: Path) -> Floats:
    """Grows the box of a tile to hold its children; returns the corners (2, 3) in the frame of its parent."""
    box = np.array(tile["boundingVolume"]["box"]).reshape(4, 3)
    half = np.abs(box[1:]).sum(axis=0)  # the boxes have the axes of their frame
    inside = [_grow(child, folder) for child in tile.get("children", [])]
    content = tile.get("content", {}).get("uri", "")
    if content.endswith(".json"):
        inside.append(_finish(folder / content))
    ends = np.concatenate([[box[0] - half, box[0] + half], *inside])
    low, high = ends.min(axis=0), ends.max(axis=0)
    tile["boundingVolume"]["box"] = [*((low + high) / 2), *np.diag((high - low) / 2).ravel()]
    corners = np.array(list(product(*np.transpose([low, high]))))
    own = _transform(tile)
    moved = corners @ own[:3, :3].T + own[:3, 3]
    return np.stack([moved.min(axis=0), moved.max(axis=0)])


def _transform(tile: dict[str, Any]) -> Floats:
    """(4, 4) from a tile's frame to its parent's; in the file columns come one after the other."""
    return np.reshape(tile.get("transform", np.eye(4)), (4, 4)).T
