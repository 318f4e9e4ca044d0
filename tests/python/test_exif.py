"""What EXIF says about lens and place."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from PIL import Image, TiffImagePlugin
from PIL.TiffImagePlugin import IFDRational
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
    zero = {"GPSLatitude": "(0) (0) (0)", "GPSLongitude": "(0) (0) (0)", "GPSAltitude": "(0)"}
    assert read_exif(write(tmp_path / "a.jpg", Model="SX260", **zero)) == Exif((), None)
    (tmp_path / "b.jpg").write_bytes(b"no image")
    assert read_exif(tmp_path / "b.jpg") == Exif((), None)
    assert read_exif(tmp_path / "none.jpg") == Exif((), None)


GPS = {1: "S", 2: (30.0, 10.0, 14.9), 3: "W", 4: (98.0, 5.0, 22.3)}


def with_gps(path: Path, gps: dict[int, Any]) -> Path:
    """A small JPEG or TIFF with this GPS directory, written by Pillow."""
    picture = Image.new("RGB", (16, 16))
    if path.suffix == ".tif":
        tags = TiffImagePlugin.ImageFileDirectory_v2()
        tags[0x8825] = gps
        picture.save(path, tiffinfo=tags)
    else:
        exif = Image.Exif()
        exif.get_ifd(0x8825).update(gps)
        picture.save(path, exif=exif)
    return path


@pytest.mark.parametrize(
    ("reference", "altitude"), [(b"\0", 380.5), (b"\1", -380.5), (b"\2", 380.5), (b"\3", -380.5)]
)
def test_altitudes_above_and_below(tmp_path: Path, reference: bytes, altitude: float) -> None:
    exif = read_exif(with_gps(tmp_path / "a.jpg", {**GPS, 5: reference, 6: 380.5}))
    assert exif.altitude == altitude


def test_an_altitude_may_be_missing(tmp_path: Path) -> None:
    without = read_exif(with_gps(tmp_path / "a.jpg", GPS))
    divided_by_zero = read_exif(with_gps(tmp_path / "b.jpg", {**GPS, 6: IFDRational(0, 0)}))
    assert without.altitude is None and divided_by_zero.altitude is None
    assert without.position is not None and without.position == divided_by_zero.position


def test_degrees_keep_their_digits(tmp_path: Path) -> None:
    decimal = {1: "N", 2: (30.1708061, 0.0, 0.0), 3: "E", 4: (0.0, 0.0, 0.0), 6: 1234.5678}
    exif = read_exif(with_gps(tmp_path / "a.jpg", decimal))
    assert exif.position == pytest.approx(
        (30.1708061, 0.0), abs=1e-9
    )  # on the meridian of Greenwich
    assert exif.altitude == pytest.approx(1234.5678, abs=1e-6)


def test_tiff(tmp_path: Path) -> None:
    exif = read_exif(with_gps(tmp_path / "a.tif", {**GPS, 5: b"\0", 6: 12.5}))
    assert exif.position == pytest.approx((-30.170806, -98.089528), abs=1e-6)
    assert exif.altitude == 12.5


@pytest.mark.parametrize("extension", ["jpg", "tif"])
def test_damaged_exif_says_nothing_or_something(tmp_path: Path, extension: str) -> None:
    whole = with_gps(tmp_path / f"a.{extension}", {**GPS, 5: b"\0", 6: 12.5}).read_bytes()
    random = np.random.default_rng(0)
    damaged = tmp_path / f"b.{extension}"
    for _ in range(300):
        content = bytearray(whole)
        for place in random.integers(0, min(len(whole), 400), 6):
            content[place] = random.integers(256)
        damaged.write_bytes(content[: random.integers(1, len(content))])
        position = read_exif(damaged).position
        assert position is None or (abs(position[0]) <= 90 and abs(position[1]) <= 180)
