"""Coordinate reference systems: as users write them, and from degrees to metres on the ground."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sirpy.errors import InputError

if TYPE_CHECKING:
    from pyproj import CRS

Floats = npt.NDArray[np.float64]

WGS84 = "OGC:CRS84"  # longitude, latitude: of GPS and of GeoJSON (RFC 7946)
_UTM_LATITUDES = (-80.0, 84.0)


def parse_crs(text: str, option: str) -> CRS:
    """Raises InputError, which names the option, where pyproj does not know it."""
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        return CRS.from_user_input(text)
    except CRSError:
        raise InputError(f"{option} {text} is not a known CRS: write it like EPSG:25832") from None


def ground_crs(text: str, option: str) -> str:
    """A CRS that products can be in, as `Frame.crs` has it: projected, metres, x east and y north.

    Raises:
        InputError: it is unknown, or another kind.
    """
    crs = parse_crs(text, option)
    if not crs.is_projected:
        raise InputError(
            f"{option} {text} is not projected, so x and y would not be lengths on the ground: give a "
            "projected CRS, such as a UTM zone"
        )
    axes = {axis.direction: axis.unit_name for axis in crs.axis_info[:2]}
    if axes != {"east": "metre", "north": "metre"}:
        raise InputError(
            f"{option} {text} does not count metres to the east and north ({_listed(axes)}), as the "
            "products do: give a CRS that does"
        )
    authority = crs.to_authority(min_confidence=100)
    return ":".join(authority) if authority else crs.to_wkt()


def utm_zone(longitude: float, latitude: float) -> str:
    """The UTM zone (WGS84) of a place in degrees.

    Raises:
        InputError: it lies near a pole, where there is none.
    """
    if not _UTM_LATITUDES[0] <= latitude <= _UTM_LATITUDES[1]:
        raise InputError(
            f"there is no UTM zone at a latitude of {latitude:.1f} degrees: name a projected CRS with --crs"
        )
    zone = min(int((longitude + 180) // 6) + 1, 60)
    return f"EPSG:{(32600 if latitude >= 0 else 32700) + zone}"


def converted(places: Floats, source: str, target: str) -> Floats:
    """(x, y, height) or (longitude, latitude, height), n x 3, from one CRS to another.

    Heights stay as they are: which surface they count from is not known, and no geoid is guessed. Infinite
    where a place does not exist in the target.
    """
    from pyproj import Transformer

    move = Transformer.from_crs(source, target, always_xy=True)
    x, y = move.transform(places[:, 0].tolist(), places[:, 1].tolist())
    return np.column_stack([x, y, places[:, 2]])


def length_error(crs: str, x: float, y: float) -> float:
    """How far lengths at a place of a projected CRS are from those on the ground: 0.01 for a hundredth;
    infinite where it knows no such place."""
    from pyproj import Geod

    around = np.array([[-500, 0, 0], [500, 0, 0], [0, -500, 0], [0, 500, 0]])
    ends = np.array([x, y, 0]) + around
    longitude, latitude, _ = converted(ends, crs, WGS84).T
    if not np.isfinite([longitude, latitude]).all():
        return np.inf
    first, last = [0, 2], [1, 3]
    _, _, lengths = Geod(ellps="WGS84").inv(
        longitude[first], latitude[first], longitude[last], latitude[last]
    )
    return float(np.abs(1000 / lengths - 1).max())


def _listed(axes: dict[str, str]) -> str:
    return ", ".join(f"{unit} to the {direction}" for direction, unit in axes.items())
