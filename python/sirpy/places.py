"""Places on the Earth with names, and the CRS that they are in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sirpy.crs import WGS84, converted, ground_crs, parse_crs, utm_zone
from sirpy.errors import InputError, first_few
from sirpy.point_tables import Row, Table

Floats = npt.NDArray[np.float64]

_EASTWARD = ("x", "e", "east", "easting")
_NORTHWARD = ("y", "n", "north", "northing")
_UPWARD = ("z", "h", "height", "up", "elevation", "altitude", "alt")
_LONGITUDE = ("lon", "long", "lng", "longitude")
_LATITUDE = ("lat", "latitude")


@dataclass(frozen=True, eq=False)
class Places:
    """`xyz` (n, 3) of the names: x and y, or longitude and latitude, and a height; `crs` None where nobody
    said."""

    names: tuple[str, ...]
    xyz: Floats
    crs: str | None

    def on_the_ground(self, target: str | None) -> Places:
        """The same in a CRS that products can be in: `target`; else their own where it is projected; else the
        UTM zone of their middle. Places without a CRS are taken to be in `target`.

        Raises:
            InputError: a CRS cannot be used, or does not know a place.
        """
        if self.crs is None:
            return Places(self.names, self.xyz, target and ground_crs(target, "--crs"))
        if target is not None:
            target = ground_crs(target, "--crs")
        elif parse_crs(self.crs, "the CRS").is_geographic:
            longitude, latitude = np.median(converted(self.xyz, self.crs, WGS84)[:, :2], axis=0)
            target = utm_zone(float(longitude), float(latitude))
        else:
            return Places(self.names, self.xyz, ground_crs(self.crs, "the CRS"))
        moved = converted(self.xyz, self.crs, target)
        unknown = np.flatnonzero(~np.isfinite(moved).all(axis=1))
        if len(unknown):
            lost = [self.names[row] for row in unknown]
            raise InputError(
                f"{target} does not know where {first_few(lost)} lies: check the coordinates, or name another "
                "CRS with --crs"
            )
        return Places(self.names, moved, target)


def read_places(table: Table, rows: Sequence[tuple[str, Row]], crs: str | None) -> Places:
    """The named rows of a table.

    Args:
        crs: of the coordinates; without, WGS84 where the columns are longitude and latitude, and unknown
            where they are x and y.

    Raises:
        InputError: a column is missing, a field is no number, or no place on the Earth.
    """
    degrees = any(name in table.headers for name in _LONGITUDE)
    columns = (*((_LONGITUDE, _LATITUDE) if degrees else (_EASTWARD, _NORTHWARD)), _UPWARD)
    table.need(*columns)
    if crs is not None and degrees and not parse_crs(crs, "the CRS").is_geographic:
        raise InputError(
            f"{table.path} has longitudes and latitudes, which {crs} has not: leave its CRS out"
        )
    crs = crs or (WGS84 if degrees else None)
    xyz = np.array([[row.number(names) for names in columns] for _, row in rows])
    if crs is not None and parse_crs(crs, "the CRS").is_geographic:
        for (_, row), (longitude, latitude, _) in zip(rows, xyz, strict=True):
            if abs(longitude) > 180 or abs(latitude) > 90:
                raise InputError(
                    f"{row.where} has longitude {longitude:g} and latitude {latitude:g}, which are no place on "
                    "the Earth: mend the line, or say what CRS these are in"
                )
    return Places(tuple(name for name, _ in rows), xyz, crs)
