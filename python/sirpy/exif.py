"""What a photograph's EXIF says about its lens and its place; read from the header alone."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import rasterio
from rasterio.errors import NotGeoreferencedWarning, RasterioIOError

_LENS_TAGS = (
    "Make",
    "Model",
    "BodySerialNumber",
    "LensModel",
    "LensSerialNumber",
    "FocalLength",
    "FocalLengthIn35mmFilm",
)


@dataclass(frozen=True)
class Exif:
    """`lens`: what tells one camera with one focal length from another, empty when EXIF does not
    say; `position`: latitude and longitude in degrees, None without GPS."""

    lens: tuple[str, ...]
    position: tuple[float, float] | None


def read_exif(photograph: Path) -> Exif:
    """The EXIF of a photograph; empty where the format has none, or it is damaged."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(photograph) as dataset:
                tags = {**dataset.tags(), **dataset.tags(ns="EXIF")}
    except RasterioIOError:
        return Exif((), None)
    lens = tuple(str(tags.get(f"EXIF_{name}", "")).strip() for name in _LENS_TAGS)
    has_focal = any(lens[_LENS_TAGS.index(name)] for name in _LENS_TAGS if "Focal" in name)
    latitude = _degrees(tags.get("EXIF_GPSLatitude"), tags.get("EXIF_GPSLatitudeRef"), "S")
    longitude = _degrees(tags.get("EXIF_GPSLongitude"), tags.get("EXIF_GPSLongitudeRef"), "W")
    position = None if latitude is None or longitude is None else (latitude, longitude)
    return Exif(lens if has_focal else (), position)


def _degrees(angle: str | None, reference: str | None, negative: str) -> float | None:
    """GDAL's "(30) (10) (14.9)" as degrees; None when it is missing or no angle."""
    try:
        parts = [float(part) for part in re.findall(r"\(([^)]+)\)", angle or "")]
    except ValueError:
        return None
    if len(parts) != 3 or not all(math.isfinite(part) for part in parts):
        return None
    degrees = parts[0] + parts[1] / 60 + parts[2] / 3600
    if not 0 < degrees <= 180:  # exactly 0 is what cameras without a fix write
        return None
    return -degrees if (reference or "").strip().upper().startswith(negative) else degrees
