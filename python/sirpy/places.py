"""Places on the Earth with names, and the CRS that they are in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sirpy.crs import WGS84, converted, ground_crs, length_error, parse_crs, utm_zone
from sirpy.errors import InputError
from sirpy.point_tables import Row, Table

Floats = npt.NDArray[np.float64]

_EASTWARD = ("x", "e", "east", "easting")
_NORTHWARD = ("y", "n", "north", "northing")
_UPWARD = ("z", "h", "height", "up", "elevation", "altitude", "alt")
_LONGITUDE = ("lon", "long", "lng", "longitude")
_LATITUDE = ("lat", "latitude")

_LENGTH_ERROR = 0.01  # of UTM in its own zone it is 0.001 at most


@dataclass(frozen=True, eq=False)
class Places:
    """`xyz` (n, 3) of the names: x and y, or longitude and latitude, and a height; `crs` None where nobody
    said."""

    names: tuple[str, ...]
    xyz: Floats
    crs: str | None

    def on_the_ground(self, target: str | None) -> Places:
        """The same in a CRS that products can be in: `target`; else their own where it is projected; else the
        UTM zone of their middle. Places without a CRS are taken to be in `target`. Not finite where a place does
        not exist in that CRS.

        Raises:
            InputError: a CRS cannot be used there.
        """
        if self.crs is None and target is None:
            return self
        ground = Places(self.names, *self._moved(target))
        known = ground.xyz[np.isfinite(ground.xyz).all(axis=1)]
        middle = np.median(known, axis=0) if len(known) else np.full(3, np.inf)
        error = length_error(str(ground.crs), float(middle[0]), float(middle[1]))
        if error > _LENGTH_ERROR:
            by = f"{error:.0%} off" if np.isfinite(error) else "without meaning"
            raise InputError(
                f"lengths in {target or ground.crs} are {by} at these coordinates: check them, and choose a "
                "projected CRS of that place with --crs"
            )
        return ground

    def _moved(self, target: str | None) -> tuple[Floats, str]:
        if self.crs is None or (target is None and not _in_degrees(self.crs)):
            crs = ground_crs(str(target or self.crs), "--crs" if target else "the CRS")
            return self.xyz, crs
        if target is None:
            longitude, latitude = np.median(converted(self.xyz, self.crs, WGS84)[:, :2], axis=0)
            target = utm_zone(float(longitude), float(latitude))
        target = ground_crs(target, "--crs")
        return converted(self.xyz, self.crs, target), target

    def which_exist(self) -> Places:
        """Those that are finite."""
        rows = np.flatnonzero(np.isfinite(self.xyz).all(axis=1))
        return Places(tuple(self.names[row] for row in rows), self.xyz[rows], self.crs)


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
    if crs is not None and degrees and not _in_degrees(crs):
        raise InputError(
            f"{table.path} has longitudes and latitudes, which {crs} has not: leave its CRS out"
        )
    crs = crs or (WGS84 if degrees else None)
    xyz = np.array([[row.number(names) for names in columns] for _, row in rows])
    if crs is not None and _in_degrees(crs):
        for (_, row), (longitude, latitude, _) in zip(rows, xyz, strict=True):
            if abs(longitude) > 180 or abs(latitude) > 90:
                raise InputError(
                    f"{row.where} has longitude {longitude:g} and latitude {latitude:g}, which are no place on "
                    "the Earth: mend the line, or say what CRS these are in"
                )
    return Places(tuple(name for name, _ in rows), xyz, crs)


def _in_degrees(crs: str) -> bool:
    return bool(parse_crs(crs, "the CRS").is_geographic)
