"""Where cameras were, as EXIF or a table says."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePath, PureWindowsPath

import numpy as np

from sirpy.crs import WGS84
from sirpy.errors import InputError, first_few
from sirpy.exif import read_exif
from sirpy.places import Places, read_places
from sirpy.point_tables import read_table
from sirpy.progress import Progress

_NAME = ("name", "image", "photo", "photograph", "filename", "file", "label", "image_name")


def exif_positions(images: Path, names: Sequence[str], progress: Progress) -> Places:
    """Longitude, latitude and altitude of the photographs whose EXIF has all three.

    Raises:
        InputError: there is no such folder, or none of them has.
    """
    if not images.is_dir():
        raise InputError(f"there is no folder {images}: give the folder of the photographs")
    found: dict[str, tuple[float, float, float]] = {}
    flat, nowhere, missing = list[str](), list[str](), list[str]()
    with progress.stage("reading positions", len(names), "photograph") as steps:
        for name in names:
            exif = read_exif(images / name)
            if exif.position is not None and exif.altitude is not None:
                latitude, longitude = exif.position
                found[name] = (longitude, latitude, exif.altitude)
            elif exif.position is not None:
                flat.append(name)
            else:
                (nowhere if (images / name).is_file() else missing).append(name)
            steps.advance()
    if len(missing) == len(names):
        raise InputError(
            f"{images} has none of the photographs of this workspace ({first_few(missing)}): give their folder"
        )
    if not found:
        raise InputError(
            f"no photograph in {images} has a GPS position with an altitude in its EXIF: give positions as a "
            "table with --positions, or control points with --gcp and --marks"
        )
    for some, what in (
        (missing, f"are not in {images}"),
        (flat, "have a GPS position without an altitude, which is not used"),
        (nowhere, "have no GPS position"),
    ):
        if some:
            progress.note(f"{len(some)} of {len(names)} photographs {what}: {first_few(some)}")
    return Places(tuple(found), np.array(list(found.values())), WGS84)


def read_positions(path: Path, crs: str | None) -> Places:
    """The positions of a table with a column of names, and of coordinates as `read_places` takes them.

    Raises:
        InputError: it cannot be read as such.
    """
    table = read_table(path)
    table.need(_NAME)
    return read_places(table, list(table.by_name(_NAME)), crs)


class Photographs:
    """Finds photographs by what tables call them: their name, the last part of it, or that without its
    extension."""

    def __init__(self, names: Iterable[str]) -> None:
        self._called: dict[str, list[str]] = defaultdict(list)
        for name in names:
            path = PurePath(name)
            for called in {name, path.name, path.stem}:
                self._called[called].append(name)

    def find(self, called: str, where: str) -> str | None:
        """The name of a photograph; None when there is no such.

        Args:
            where: the place in a table, for the message.

        Raises:
            InputError: several could be meant.
        """
        last = PureWindowsPath(called).name  # splits at / and \
        for key in (called, last, PurePath(last).stem):
            if found := self._called.get(key, []):
                exact = [name for name in found if name == called]
                if len(exact or found) > 1:
                    raise InputError(
                        f"{where} {called} may be {first_few(found)}: write its name with its folder"
                    )
                return (exact or found)[0]
        return None
