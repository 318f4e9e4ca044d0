"""Where cameras were."""

from __future__ import annotations

from pathlib import Path

import pytest
from sirpy.camera_positions import Photographs, exif_positions, read_positions
from sirpy.errors import InputError
from sirpy.progress import Progress
from test_exif import GPS, with_gps


class Notes(Progress):
    def __init__(self) -> None:
        self.said: list[str] = []

    def note(self, text: str) -> None:
        self.said.append(text)


def test_exif_of_those_that_have_all(tmp_path: Path) -> None:
    (tmp_path / "north").mkdir()
    with_gps(tmp_path / "north" / "a.jpg", {**GPS, 6: 380.5})
    with_gps(tmp_path / "b.jpg", GPS)
    with_gps(tmp_path / "c.jpg", {})
    notes = Notes()
    found = exif_positions(tmp_path, ["north/a.jpg", "b.jpg", "c.jpg", "d.jpg"], notes)
    assert found.names == ("north/a.jpg",)
    assert found.xyz[0] == pytest.approx((-98.089528, -30.170806, 380.5), abs=1e-6)
    said = "\n".join(notes.said)
    assert "without an altitude, which is not used: b.jpg" in said
    assert "have no GPS position: c.jpg" in said
    assert f"are not in {tmp_path}: d.jpg" in said


def test_no_exif_at_all(tmp_path: Path) -> None:
    with_gps(tmp_path / "c.jpg", {})
    with pytest.raises(InputError, match=r"no photograph .* has a GPS position"):
        exif_positions(tmp_path, ["c.jpg"], Progress())
    with pytest.raises(InputError, match="has none of the photographs"):
        exif_positions(tmp_path, ["x.jpg"], Progress())
    with pytest.raises(InputError, match="there is no folder"):
        exif_positions(tmp_path / "none", ["x.jpg"], Progress())


def test_a_table(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("#label;x;y;z\na.jpg;1,5;2;3\n")
    found = read_positions(path, None)
    assert (found.names, found.crs) == (("a.jpg",), None)
    assert found.xyz.tolist() == [[1.5, 2, 3]]


def test_photographs_by_what_tables_call_them() -> None:
    photographs = Photographs(["north/a.jpg", "south/a.jpg", "south/b.jpg", "c.d.tif"])
    assert photographs.find("north/a.jpg", "") == "north/a.jpg"
    assert photographs.find("b.jpg", "") == "south/b.jpg"
    assert photographs.find("b", "") == "south/b.jpg"
    assert photographs.find("C:\\flight\\b.JPG", "") == "south/b.jpg"
    assert photographs.find("c.d", "") == "c.d.tif"
    assert photographs.find("e.jpg", "") is None
    with pytest.raises(InputError, match=r"line 3 a.jpg may be north/a.jpg, south/a.jpg"):
        photographs.find("a.jpg", "line 3")
