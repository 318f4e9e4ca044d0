"""What a photograph's EXIF says about its lens and its place; read from the header alone.

Pillow's reader of EXIF on its own: GDAL rounds to six digits, which moves a latitude in decimal degrees by 10 m.
"""

from __future__ import annotations

import math
import struct
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:
    from PIL.Image import Exif as ExifTags

_EXIF_IFD, _GPS_IFD = 0x8769, 0x8825
_MAKE_AND_MODEL = (0x010F, 0x0110)
_FOCAL_LENGTHS = (0x920A, 0xA405)  # and as of 35 mm film
_LENS = (0xA431, 0xA434, 0xA435)  # serial number of the body, model and serial number of the lens
_LATITUDE, _LONGITUDE, _ALTITUDE = 2, 4, 6  # the tag before each says which way
_BELOW = (1, 3)  # sea level, the ellipsoid

_JPEG, _TIFF = b"\xff\xd8\xff", (b"II*\0", b"MM\0*")
_SCAN, _APP1, _EXIF = 0xDA, 0xE1, b"Exif\0\0"
# What Pillow raises of damaged EXIF.
_DAMAGED = (
    *(OSError, EOFError, SyntaxError, struct.error),
    *(ValueError, TypeError, LookupError, ArithmeticError, AttributeError, MemoryError),
)


@dataclass(frozen=True)
class Exif:
    """`lens`: what tells one camera with one focal length from another, empty when EXIF does not
    say; `position`: latitude and longitude in degrees (WGS84), None without GPS; `altitude`: metres as GPS
    gave them, None where it did not."""

    lens: tuple[str, ...]
    position: tuple[float, float] | None
    altitude: float | None = None


def read_exif(photograph: Path) -> Exif:
    """The EXIF of a photograph; empty where the format has none, or it is damaged."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what is damaged
            tags = _tags(photograph)
            main, more, gps = (
                dict(tags),
                dict(tags.get_ifd(_EXIF_IFD)),
                dict(tags.get_ifd(_GPS_IFD)),
            )
    except _DAMAGED:
        return Exif((), None)
    names = [main.get(tag) for tag in _MAKE_AND_MODEL] + [more.get(tag) for tag in _LENS]
    focals = [more.get(tag) for tag in _FOCAL_LENGTHS]
    has_focal = any(focals)
    lens = tuple("" if value is None else str(value).strip("\0 ") for value in names + focals)
    latitude, longitude = _degrees(gps, _LATITUDE, "S", 90), _degrees(gps, _LONGITUDE, "W", 180)
    position = None
    if latitude is not None and longitude is not None and (latitude, longitude) != (0, 0):
        position = latitude, longitude  # both 0 is what cameras without a fix write
    return Exif(lens if has_focal else (), position, _altitude(gps) if position else None)


def exif_bytes(photograph: Path) -> bytes:
    """The EXIF of a photograph, as another JPEG may carry it; empty where there is none, or it is
    damaged."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tags = _tags(photograph)
            tags.get_ifd(_EXIF_IFD)
            return tags.tobytes() if len(tags) else b""
    except _DAMAGED:
        return b""


def _tags(photograph: Path) -> ExifTags:
    from PIL import Image

    tags = Image.Exif()
    with photograph.open("rb") as file:
        begin = file.read(4)
        file.seek(0)
        if begin[:3] == _JPEG:
            tags.load(_exif_of_jpeg(file))
        elif begin in _TIFF:
            tags.load_from_fp(file)
            tags.get_ifd(_EXIF_IFD), tags.get_ifd(_GPS_IFD)  # while the file is open
    return tags


def _exif_of_jpeg(file: BinaryIO) -> bytes:
    """The segment with EXIF; empty where there is none before the pixels."""
    file.seek(2)
    while len(head := file.read(4)) == 4 and head[0] == 0xFF and head[1] != _SCAN:
        content = file.read(max(0, int.from_bytes(head[2:], "big") - 2))
        if head[1] == _APP1 and content.startswith(_EXIF):
            return content
    return b""


def _degrees(gps: dict[int, Any], tag: int, negative: str, most: int) -> float | None:
    """Degrees, minutes and seconds as degrees; None when it is missing or no angle."""
    try:
        parts = [float(part) for part in gps[tag]]
        degrees = sum(part / 60.0**power for power, part in enumerate(parts[:3]))
        if len(parts) != 3 or not 0 <= degrees <= most:  # also what is not finite
            return None
        return (
            -degrees if str(gps.get(tag - 1, "")).strip().upper().startswith(negative) else degrees
        )
    except (LookupError, TypeError, ValueError, ArithmeticError):
        return None


def _altitude(gps: dict[int, Any]) -> float | None:
    try:
        altitude = float(gps[_ALTITUDE])
        reference = gps.get(_ALTITUDE - 1, 0)
        below = int(reference[0] if isinstance(reference, bytes) else reference) in _BELOW
    except (LookupError, TypeError, ValueError, ArithmeticError):
        return None
    if not math.isfinite(altitude):  # 0/0
        return None
    return -altitude if below else altitude
