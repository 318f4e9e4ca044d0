"""Who shares a camera, and focal lengths as COLMAP reads them, without decoding the photograph."""

from __future__ import annotations

from pathlib import Path

import pycolmap
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from sirpy.errors import InputError
from sirpy.exif import Exif
from sirpy.initial_cameras import CameraPer, check_camera_options, initial_camera, lens_groups

MM, DPI = IFDRational(45, 10), IFDRational(16395, 10)
NO_EXIF = Exif((), None)
SIZES = {"a/1.jpg": (60, 40), "a/2.jpg": (60, 40), "b/3.jpg": (60, 40), "b/4.jpg": (60, 40)}
EXIFS = {
    "a/1.jpg": Exif(("wide",), None),
    "a/2.jpg": Exif(("tele",), None),
    "b/3.jpg": Exif(("wide",), None),
    "b/4.jpg": NO_EXIF,
}


@pytest.mark.parametrize(
    ("camera_per", "groups"),
    [
        ("auto", [["a/1.jpg", "b/3.jpg"], ["a/2.jpg"], ["b/4.jpg"]]),
        ("image", [["a/1.jpg"], ["a/2.jpg"], ["b/3.jpg"], ["b/4.jpg"]]),
        ("folder", [["a/1.jpg", "a/2.jpg"], ["b/3.jpg", "b/4.jpg"]]),
        ("single", [["a/1.jpg", "a/2.jpg", "b/3.jpg", "b/4.jpg"]]),
    ],
)
def test_groups(camera_per: CameraPer, groups: list[list[str]]) -> None:
    assert lens_groups(SIZES, EXIFS, camera_per) == groups


def test_photographs_of_two_sizes_never_share_a_camera() -> None:
    sizes = {"1.jpg": (60, 40), "2.jpg": (40, 60)}
    exifs = {"1.jpg": Exif(("wide",), None), "2.jpg": Exif(("wide",), None)}
    assert lens_groups(sizes, exifs, "auto") == [["1.jpg"], ["2.jpg"]]
    with pytest.raises(InputError, match=r"1\.jpg has 60x40 pixels and 2\.jpg 40x60"):
        lens_groups(sizes, exifs, "single")


def test_unknown_words_are_refused() -> None:
    with pytest.raises(InputError, match="camera_model = 'FISH' is not possible"):
        check_camera_options("FISH", "auto")
    with pytest.raises(InputError, match="camera_per = 'lens' is not possible"):
        check_camera_options("OPENCV", "lens")


def photograph(path: Path, tags: dict[int, IFDRational]) -> Path:
    picture = Image.new("L", (400, 300))
    exif = picture.getexif()
    exif[0x010F], exif[0x0110] = "Canon", "Canon PowerShot SX260 HS"
    exif.get_ifd(0x8769).update(tags)
    picture.save(path, exif=exif)
    return path


@pytest.mark.parametrize(
    "tags",
    [
        {0x920A: MM},  # of COLMAP's table of cameras
        {0x920A: MM, 0xA405: 25},
        {0x920A: MM, 0xA20E: DPI, 0xA20F: DPI, 0xA210: 2, 0xA002: 400, 0xA003: 300},
    ],
)
def test_focal_length_is_what_colmap_reads(tmp_path: Path, tags: dict[int, IFDRational]) -> None:
    path = photograph(tmp_path / "a.jpg", tags)
    expected = pycolmap.infer_camera_from_image(path)
    camera = initial_camera(path, (400, 300), "SIMPLE_RADIAL", has_exif=True)
    assert expected.has_prior_focal_length and camera.has_prior_focal_length
    assert camera.params == pytest.approx(expected.params, rel=1e-5)


def test_without_focal_length_it_is_guessed(tmp_path: Path) -> None:
    path = photograph(tmp_path / "a.jpg", {})
    camera = initial_camera(path, (400, 300), "PINHOLE", has_exif=True)
    assert not camera.has_prior_focal_length
    assert camera.params.tolist() == [480, 480, 200, 150]
