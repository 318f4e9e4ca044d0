"""Clouds with colours from files, by parts."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest
from rephotograph_scene import COLOURED, coloured
from sirpy.coloured_points import read_coloured
from sirpy.errors import InputError
from sirpy.ply import write_vertices

POINTS = np.arange(30.0).reshape(10, 3)
COLOURS = np.arange(30, dtype=np.uint8).reshape(10, 3) * 8


def read(path: Path, size: int) -> tuple[np.ndarray, np.ndarray]:
    parts = list(read_coloured(path, size))
    assert max(len(points) for points, _ in parts) <= size
    points, colours = zip(*parts, strict=True)
    return np.concatenate(points), np.concatenate(colours)


def write_las(path: Path, colours: np.ndarray, point_format: int = 7) -> Path:
    las = laspy.create(point_format=point_format, file_version="1.4")
    las.header.scales, las.header.offsets = np.full(3, 1e-3), np.zeros(3)
    las.x, las.y, las.z = POINTS.T
    if point_format == 7:
        las.red, las.green, las.blue = colours.T
    las.write(path)
    return path


def test_ply_by_parts_without_points_that_are_not_finite(tmp_path: Path) -> None:
    points = POINTS.copy()
    points[4, 2] = np.nan
    write_vertices(tmp_path / "a.ply", COLOURED, [coloured(points, COLOURS)])
    for size in (3, 100):
        found, colours = read(tmp_path / "a.ply", size)
        np.testing.assert_array_equal(found, np.delete(POINTS, 4, axis=0))
        np.testing.assert_array_equal(colours, np.delete(COLOURS, 4, axis=0))


@pytest.mark.parametrize("name", ["a.laz", "a.LAS"])
@pytest.mark.parametrize("scale", [1, 257])
def test_las_with_colours_of_8_and_of_16_bits(tmp_path: Path, name: str, scale: int) -> None:
    path = write_las(tmp_path / name, COLOURS.astype(np.uint16) * scale)
    found, colours = read(path, 4)
    np.testing.assert_allclose(found, POINTS)
    np.testing.assert_array_equal(colours, COLOURS)


def test_what_cannot_be_read_ends_in_one_sentence(tmp_path: Path) -> None:
    plain = np.dtype([(name, "<f4") for name in "xyz"])
    write_vertices(tmp_path / "plain.ply", plain, [np.zeros(3, plain)])
    wide = np.dtype([*plain.descr, *((name, "<u2") for name in ("red", "green", "blue"))])
    write_vertices(tmp_path / "wide.ply", wide, [np.zeros(3, wide)])
    (tmp_path / "damaged.laz").write_bytes(b"LASF" + bytes(100))
    whole = write_las(tmp_path / "whole.laz", COLOURS.astype(np.uint16)).read_bytes()
    (tmp_path / "cut.laz").write_bytes(whole[:-40])
    write_las(tmp_path / "plain.las", COLOURS, point_format=6)
    for name, words in {
        "plain.ply": "have no colours",
        "wide.ply": "not of 8 bits",
        "damaged.laz": "damaged",
        "cut.laz": "damaged",
        "plain.las": "have no colours",
        "none.laz": "cannot be read",
    }.items():
        with pytest.raises(InputError, match=words):
            list(read_coloured(tmp_path / name))
