"""CRS as users write them."""

from __future__ import annotations

import numpy as np
import pytest
from sirpy.crs import WGS84, converted, ground_crs, length_error, utm_zone
from sirpy.errors import InputError


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("EPSG:25832", "EPSG:25832"),
        ("epsg:32614", "EPSG:32614"),
        ("2154", "EPSG:2154"),
        ("EPSG:2193", "EPSG:2193"),  # whose axes are listed north first
    ],
)
def test_projected_metres_are_ground(text: str, code: str) -> None:
    assert ground_crs(text, "--crs") == code


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("EPSG:4326", "not projected"),
        ("EPSG:4978", "not projected"),
        ("EPSG:2277", "US survey foot"),
        ("EPSG:2048", "to the west"),
        ("EPSG:999999", "not a known CRS"),
        ("nonsense", "not a known CRS"),
    ],
)
def test_others_are_not(text: str, why: str) -> None:
    with pytest.raises(InputError, match=f"--crs {text} .*{why}"):
        ground_crs(text, "--crs")


@pytest.mark.parametrize(
    ("longitude", "latitude", "code"),
    [
        (-98.09, 30.17, "EPSG:32614"),
        (7.75, 48.58, "EPSG:32632"),
        (18.4, -33.9, "EPSG:32734"),
        (-180.0, 1.0, "EPSG:32601"),
        (180.0, 1.0, "EPSG:32660"),
    ],
)
def test_zones(longitude: float, latitude: float, code: str) -> None:
    assert utm_zone(longitude, latitude) == code


def test_no_zone_at_the_poles() -> None:
    with pytest.raises(InputError, match="--crs"):
        utm_zone(0, 86)


def test_heights_are_not_touched() -> None:
    place = np.array([[7.75, 48.58, 123.25]])
    east, north, height = converted(place, WGS84, "EPSG:25832")[0]
    assert height == 123.25
    assert (east, north) == pytest.approx((407796, 5381599), abs=200)
    np.testing.assert_allclose(
        converted(np.array([[east, north, height]]), "EPSG:25832", WGS84), place, atol=1e-9
    )


def test_lengths_are_right_in_the_zone_alone() -> None:
    assert length_error("EPSG:32614", 500_000, 3_338_000) == pytest.approx(0.0004, abs=2e-5)
    assert length_error("EPSG:3857", 0, 6_000_000) > 0.3
    assert length_error("EPSG:32614", 1e12, 0) == np.inf
