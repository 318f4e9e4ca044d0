"""What the 3D Tiles 1.0 specification asks of a tileset of points, checked without py3dtiles.

https://docs.ogc.org/cs/18-053r2/18-053r2.html; every broken rule raises.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
_HEADER = struct.Struct("<4sIIIIII")
_SLACK = 1e-3  # of a box: coordinates are 32-bit


@dataclass
class Found:
    """Of the finest tiles: `places` (n, 3) in the tileset's frame, `colours` (n, 3)."""

    places: Floats
    colours: npt.NDArray[np.uint8]
    files: int


def check_tileset(path: Path) -> Found:
    """Reads a tileset, and holds it against the specification."""
    parts: list[tuple[Floats, npt.NDArray[np.uint8]]] = []
    files: set[Path] = {path}
    _check_file(path, np.eye(4), parts, files)
    assert {file for file in path.parent.rglob("*") if file.is_file()} == files
    places, colours = zip(*parts, strict=True)
    return Found(np.concatenate(places), np.concatenate(colours), len(files))


def _check_file(
    path: Path, above: Floats, parts: list[tuple[Floats, npt.NDArray[np.uint8]]], files: set[Path]
) -> Floats:
    """The corners of the tileset's box in the frame of what holds it (8, 3)."""
    tileset = json.loads(path.read_text(encoding="utf-8"))
    assert tileset["asset"]["version"] == "1.0"
    assert "created_date" not in path.read_text(encoding="utf-8")
    assert tileset["geometricError"] >= tileset["root"]["geometricError"] >= 0
    assert tileset["root"]["refine"] in ("ADD", "REPLACE")
    return _check_tile(tileset["root"], path.parent, above, "ADD", parts, files)


def _check_tile(
    tile: dict[str, Any],
    folder: Path,
    above: Floats,
    refine: str,
    parts: list[tuple[Floats, npt.NDArray[np.uint8]]],
    files: set[Path],
) -> Floats:
    """The corners of the tile's box in the frame of its parent (8, 3)."""
    own = np.reshape(tile.get("transform", np.eye(4)), (4, 4)).T
    assert own[3].tolist() == [0, 0, 0, 1]
    refine = tile.get("refine", refine)
    box = np.array(tile["boundingVolume"]["box"], np.float64)
    assert box.shape == (12,) and np.isfinite(box).all()
    assert tile["geometricError"] >= 0
    children = tile.get("children", [])
    if "content" in tile:
        file = folder / tile["content"]["uri"]
        files.add(file)
        if file.suffix == ".json":  # a tileset of its own
            assert not children
            _check_inside(_check_file(file, above @ own, parts, files), box)
        else:
            places, colours = read_pnts(file)
            _check_inside(places, box)
            if refine == "ADD" or not children:
                parts.append((_moved(places, above @ own), colours))
    for child in children:
        assert child["geometricError"] <= tile["geometricError"]
        _check_inside(_check_tile(child, folder, above @ own, refine, parts, files), box)
    signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, 8).T
    return _moved(box[:3] + signs @ box[3:].reshape(3, 3), own)


def _check_inside(places: Floats, box: Floats) -> None:
    axes = box[3:].reshape(3, 3)
    lengths = np.linalg.norm(axes, axis=1)
    flat = lengths == 0  # points of one plane along an axis
    directions = np.where(flat[:, None], np.eye(3), axes / np.where(flat, 1, lengths)[:, None])
    beyond = np.abs((places - box[:3]) @ directions.T) - lengths
    assert beyond.max() <= _SLACK * lengths.max(), f"{beyond.max()} outside of its box"


def _moved(places: Floats, matrix: Floats) -> Floats:
    moved: Floats = places @ matrix[:3, :3].T + matrix[:3, 3]
    return moved


def read_pnts(path: Path) -> tuple[Floats, npt.NDArray[np.uint8]]:
    """The points (n, 3) and colours (n, 3) of a .pnts file."""
    data = path.read_bytes()
    magic, version, size, *lengths = _HEADER.unpack_from(data)
    assert (magic, version, size) == (b"pnts", 1, len(data)) and size % 8 == 0
    assert sum(lengths) + _HEADER.size == size
    begin = _HEADER.size + lengths[0]
    assert begin % 8 == 0  # the binary part of the feature table is aligned
    table = json.loads(data[_HEADER.size : begin])
    count, body = table["POINTS_LENGTH"], data[begin : begin + lengths[1]]
    at, colour_at = table["POSITION"]["byteOffset"], table["RGB"]["byteOffset"]
    assert count > 0 and at % 4 == 0
    assert max(at + 12 * count, colour_at + 3 * count) <= len(body)
    places = np.frombuffer(body, "<f4", 3 * count, at).reshape(-1, 3).astype(np.float64)
    assert np.isfinite(places).all()
    return places, np.frombuffer(body, np.uint8, 3 * count, colour_at).reshape(-1, 3)
