"""What EXIF says about lens and place."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import rasterio
from sirpy.exif import Exif, read_exif


def write(path: Path, **tags: str) -> Path:
    """A small JPEG with these EXIF tags, in GDAL's notation."""
    warnings.simplefilter("ignore")
    profile = {"driver": "JPEG", "width": 16, "height": 16, "count": 3, "dtype": "uint8"}
    with rasterio.open(path, "w", **profile) as target:
        target.write(np.zeros((3, 16, 16), np.uint8))
        target.update_tags(**{f"EXIF_{name}": value for name, value in tags.items()})
    return path


def test_lens_and_position(tmp_path: Path) -> None:
    exif = read_exif(
        write(
            tmp_path / "a.jpg",
            Make="Canon",
            Model="SX260",
            FocalLength="(4.5)",
            GPSLatitude="(30) (10) (14.904)",
            GPSLatitudeRef="S",
            GPSLongitude="(98) (5) (22.308)",
            GPSLongitudeRef="E",
        )
    )
    assert exif.lens[:2] == ("Canon", "SX260")
    assert exif.position == pytest.approx((-30.170807, 98.089530), abs=1e-6)


def test_cameras_with_other_zoom_are_other_lenses(tmp_path: Path) -> None:
    wide = read_exif(write(tmp_path / "a.jpg", Model="SX260", FocalLength="(4.5)"))
    tele = read_exif(write(tmp_path / "b.jpg", Model="SX260", FocalLength="(90)"))
    again = read_exif(write(tmp_path / "c.jpg", Model="SX260", FocalLength="(4.5)"))
    assert wide.lens == again.lens != tele.lens


def test_without_focal_length_or_fix_nothing_is_known(tmp_path: Path) -> None:
    zero = {"GPSLatitude": "(0) (0) (0)", "GPSLongitude": "(0) (0) (0)"}
    assert read_exif(write(tmp_path / "a.jpg", Model="SX260", **zero)) == Exif((), None)
    (tmp_path / "b.jpg").write_bytes(b"no image")
    assert read_exif(tmp_path / "b.jpg") == Exif((), None)
