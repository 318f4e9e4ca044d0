"""Positions of GPS as priors of structure from motion: metres, x east, y north, z up, from the mean
of the positions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

# Standard deviations, m: of GPS without corrections, and of a height that is not known.
_HORIZONTAL, _VERTICAL, _UNKNOWN = 5.0, 10.0, 10_000.0


def write_priors(
    database: Path, positions: Mapping[str, tuple[float, float, float | None]]
) -> None:
    """Writes the position of each photograph (latitude, longitude, degrees; altitude, m, where it
    is known) to a database that has none."""
    known = [altitude for _, _, altitude in positions.values() if altitude is not None]
    mean_altitude = float(np.mean(known)) if known else 0.0
    geodetic = np.array(
        [
            (latitude, longitude, mean_altitude if altitude is None else altitude)
            for latitude, longitude, altitude in positions.values()
        ]
    )
    local: NDArray[np.float64] = pycolmap.GPSTransform().ellipsoid_to_enu(
        geodetic, *geodetic.mean(axis=0)
    )
    with pycolmap.Database.open(database) as opened:
        data_ids = {image.name: image.data_id for image in opened.read_all_images()}
        for (name, (*_, altitude)), position in zip(positions.items(), local, strict=True):
            vertical = _UNKNOWN if altitude is None else _VERTICAL
            opened.write_pose_prior(
                pycolmap.PosePrior(
                    corr_data_id=data_ids[name],
                    position=position,
                    position_covariance=np.diag(np.square([_HORIZONTAL, _HORIZONTAL, vertical])),
                    coordinate_system=pycolmap.PosePriorCoordinateSystem.CARTESIAN,
                )
            )
