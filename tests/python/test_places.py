"""Places and their CRS."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sirpy.crs import WGS84
from sirpy.errors import InputError
from sirpy.places import Places, read_places
from sirpy.point_tables import read_table

HERE = np.array([[-98.0895, 30.1708, 380.0], [-98.0890, 30.1710, 381.0]])


def places(folder: Path, text: str, crs: str | None = None) -> Places:
    path = folder / "p.csv"
    path.write_text(text)
    table = read_table(path)
    return read_places(table, list(table.by_name(("name",))), crs)


def test_degrees_are_wgs84_whatever_their_order(tmp_path: Path) -> None:
    found = places(tmp_path, "name,Latitude,Longitude,Altitude\na,30.1708,-98.0895,380\n")
    assert found.crs == WGS84
    np.testing.assert_array_equal(found.xyz, HERE[:1])


def test_metres_have_no_crs_unless_named(tmp_path: Path) -> None:
    text = "name,E,N,H\na,587000,3338000,380\n"
    assert places(tmp_path, text).crs is None
    assert places(tmp_path, text, "EPSG:32614").crs == "EPSG:32614"


@pytest.mark.parametrize(
    ("text", "crs", "why"),
    [
        ("name,x,y\na,1,2\n", None, "no column z"),
        ("name,lon,lat,alt\na,200,2,3\n", None, "line 2 .* no place on the Earth"),
        ("name,lon,lat,alt\na,20,98,3\n", None, "line 2 .* no place on the Earth"),
        ("name,x,y,z\na,587000,3338000,3\n", "EPSG:4326", "line 2 .* no place on the Earth"),
        ("name,lon,lat,alt\na,20,50,3\n", "EPSG:32614", "leave its CRS out"),
        ("name,x,y,z\na,1,2,3\n", "EPSG:0", "not a known CRS"),
    ],
)
def test_what_cannot_be_read(tmp_path: Path, text: str, crs: str | None, why: str) -> None:
    with pytest.raises(InputError, match=why):
        places(tmp_path, text, crs)


def test_the_zone_of_the_place_or_what_is_asked_for() -> None:
    given = Places(("a", "b"), HERE, WGS84)
    chosen, asked = given.on_the_ground(None), given.on_the_ground("EPSG:32613")
    assert (chosen.crs, asked.crs) == ("EPSG:32614", "EPSG:32613")
    np.testing.assert_array_equal(chosen.xyz[:, 2], HERE[:, 2])
    # The same way between the two, on the ground.
    lengths = [np.linalg.norm(np.diff(one.xyz, axis=0)) for one in (chosen, asked)]
    assert lengths[0] == pytest.approx(lengths[1], rel=0.01)
    again = chosen.on_the_ground(None)
    np.testing.assert_array_equal(again.xyz, chosen.xyz)


def test_without_any_crs_they_stay() -> None:
    given = Places(("a", "b"), HERE, None)
    assert given.on_the_ground(None) is given


def test_a_place_that_does_not_exist_there_is_not_finite() -> None:
    nowhere = np.array([[-98.0895 + 90, 0.0, 3.0]])
    found = Places(("a", "b", "c"), np.concatenate([HERE, nowhere]), WGS84).on_the_ground(
        "EPSG:32614"
    )
    assert found.which_exist().names == ("a", "b")


@pytest.mark.parametrize("crs", ["EPSG:27700", "EPSG:3857", "EPSG:5514"])
def test_a_crs_of_elsewhere_is_refused(crs: str) -> None:
    with pytest.raises(InputError, match=f"lengths in {crs} are .* off"):
        Places(("a", "b"), HERE, WGS84).on_the_ground(crs)
