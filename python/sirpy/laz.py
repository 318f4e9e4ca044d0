"""The cloud as LAZ: LAS 1.4, point format 7, compressed by lazrs, written as a stream.

Coordinates are whole multiples of a power of ten, colours fill 16 bits as the format wants, and what it has no place
for are extra dimensions: `views`, `confidence`, `gsd`, `sigma`, `level`. There is no date in it, so that the same
cloud gives the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sirpy import __version__
from sirpy.cloud import Cloud, Points
from sirpy.errors import InputError
from sirpy.files import written_whole
from sirpy.frame import Floats

if TYPE_CHECKING:
    import laspy

_COARSEST = -3  # power of ten: a millimetre
_STEPS = 2**30  # a coordinate has 32 bits with its sign
_DATE_AT, _DATE_BYTES = 90, 4  # of the header: day and year of the file's creation
_KEPT_BITS = 10  # of the mantissa of extra dimensions: 0.05 %, and they compress


def write_laz(path: Path, cloud: Cloud, points: Iterator[Points]) -> int:
    """Writes some points of a cloud; returns their number.

    Raises:
        InputError: the CRS of the cloud is unknown.
        OutputError: the file cannot be written.
    """
    step, origin = lattice(cloud)
    return write_las(path, points, step, origin, cloud.frame.crs, compress=True)


def lattice(cloud: Cloud) -> tuple[float, Floats]:
    """The step of the coordinates, a tenth of the GSD or less, and their origin (3,) in whole units.

    They are those of the whole cloud: a point has the same coordinates in the file of a tile.
    """
    finest = math.floor(math.log10(cloud.gsd / 10)) if cloud.gsd > 0 else _COARSEST
    origin = np.round((cloud.low + cloud.high) / 2)
    reach = float(np.abs([cloud.low - origin, cloud.high - origin]).max())
    # An outlier far away costs digits, not the file.
    needed = math.ceil(math.log10(reach / _STEPS)) if reach > 0 else _COARSEST
    return float(f"1e{max(min(finest, _COARSEST), needed)}"), origin


def write_las(
    path: Path,
    points: Iterator[Points],
    step: float,
    origin: Floats,
    crs: str | None = None,
    *,
    compress: bool = False,
) -> int:
    """Writes points as LAS, or as LAZ, with coordinates origin + step * whole number; returns their number."""
    import laspy

    header = laspy.LasHeader(version="1.4", point_format=7)
    header.scales, header.offsets = np.full(3, step), origin
    header.generating_software = f"sirpy {__version__}"
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams("views", np.uint8, "photographs that agree"),
            laspy.ExtraBytesParams("confidence", np.float32, "0 to 1"),
            laspy.ExtraBytesParams("gsd", np.float32, "of the pixel, unit of x and y"),
            laspy.ExtraBytesParams("sigma", np.float32, "along the ray, unit of x and y"),
            laspy.ExtraBytesParams("level", np.uint8, "2^level pixels gave the depth"),
        ]
    )
    if crs is not None:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(_wkt(crs)))
    header.global_encoding.wkt = True  # point format 7 knows no other way
    count = 0
    with written_whole(path) as temporary, temporary.open("w+b") as file:
        with laspy.LasWriter(file, header, do_compress=compress, closefd=False) as writer:
            for some in points:
                writer.write_points(_record(some, header))
                count += len(some)
        file.seek(_DATE_AT)  # laspy writes today
        file.write(bytes(_DATE_BYTES))
    return count


def _wkt(crs: str) -> str:
    """WKT 1, which the format asks for; WKT 2 where a CRS has no other."""
    from pyproj import CRS
    from pyproj.enums import WktVersion
    from pyproj.exceptions import CRSError

    try:
        known = CRS.from_user_input(crs)
    except CRSError:
        raise InputError(f"{crs} is not a known CRS: write it like EPSG:25832") from None
    try:
        return known.to_wkt(WktVersion.WKT1_GDAL)
    except CRSError:
        return known.to_wkt()


def _record(points: Points, header: laspy.LasHeader) -> Any:
    import laspy

    record = laspy.ScaleAwarePointRecord.zeros(len(points), header=header)
    for axis, place in enumerate("xyz"):
        steps = (points[place] - header.offsets[axis]) / header.scales[axis]
        record[place.upper()] = np.rint(steps).astype(np.int32)
    for name in ("red", "green", "blue"):
        record[name] = points[name].astype(np.uint16) * 257
    record["return_number"][:] = record["number_of_returns"][:] = 1
    record["views"] = points["views"]
    record["level"] = points["level"]
    for name in ("confidence", "gsd", "sigma"):
        record[name] = _rounded(points[name])
    return record


def _rounded(values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """To some bits of the mantissa: the bytes after them are zero."""
    dropped = 23 - _KEPT_BITS
    bits = values.astype(np.float32).view(np.uint32)
    half = np.uint32(1 << (dropped - 1))
    return ((bits + half) & np.uint32(~((1 << dropped) - 1) & 0xFFFFFFFF)).view(np.float32)
