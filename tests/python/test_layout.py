"""Layouts: which rectangles of a native image become sub-images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sirpy.errors import InputError
from sirpy.layout import Layout, Region, parse_cuts, read_region
from sirpy.rectangle import Grid, Rectangle


@given(st.data(), st.integers(1, 50), st.integers(1, 50), st.integers(0, 60))
def test_cores_tile_the_region_and_files_hold_them(
    data: st.DataObject, width: int, height: int, overlap: int
) -> None:
    x0, y0 = data.draw(st.integers(0, width - 1)), data.draw(st.integers(0, height - 1))
    roi = Rectangle(
        x0, y0, data.draw(st.integers(1, width - x0)), data.draw(st.integers(1, height - y0))
    )
    grid = Grid(data.draw(st.integers(1, roi.width)), data.draw(st.integers(1, roi.height)))
    layout = Layout(grid, overlap, Region(roi=roi))
    native = layout.named(layout.native_image("a.jpg", (width, height)), "a", "jpg")
    owners = np.zeros((height, width), int)
    for sub in native.sub_images:
        owners[sub.core.slices_in(native.rectangle)] += 1
        assert sub.stored.contains(sub.core) and roi.contains(sub.stored)
        assert sub.stored == sub.core.padded(overlap).intersection(roi)
    inside = np.zeros((height, width), int)
    inside[roi.slices_in(native.rectangle)] = 1
    np.testing.assert_array_equal(owners, inside)
    assert native.covered == roi
    assert len({sub.name for sub in native.sub_images}) == grid.columns * grid.rows


def test_a_list_names_single_images_and_the_rest_has_the_common_region(tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_text("# name and region\nb 1.jpg 5,6,7,8\n\nc.jpg\t0,0,1,1\n")
    region = read_region("1,2,3,4", tmp_path / "list.txt")
    assert region.roi_of("a.jpg") == Rectangle(1, 2, 3, 4)
    assert region.roi_of("b 1.jpg") == Rectangle(5, 6, 7, 8)
    assert region.roi_of("c.jpg") == Rectangle(0, 0, 1, 1)
    layout = Layout(Grid(1, 1), 0, region)
    layout.check_names(["a.jpg", "b 1.jpg", "c.jpg"])
    with pytest.raises(InputError, match=r"c\.jpg, which is not among the images"):
        layout.check_names(["a.jpg", "b 1.jpg"])
    assert read_region(None, tmp_path / "list.txt").roi_of("a.jpg") is None


@pytest.mark.parametrize("roi", ["", "1,2,3", "1,2,3,4,5", "a,2,3,4", "1.5,2,3,4"])
def test_what_is_no_region_is_refused(roi: str) -> None:
    with pytest.raises(InputError, match="is no region: write X0,Y0,WIDTH,HEIGHT"):
        read_region(roi)


@pytest.mark.parametrize("roi", ["-1,0,5,5", "0,-1,5,5", "0,0,0,5", "0,0,5,0"])
def test_an_empty_or_negative_region_is_refused(roi: str) -> None:
    with pytest.raises(InputError, match="at least"):
        read_region(roi)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("a.jpg 0,0,1,1\na.jpg 0,0,2,2\n", "line 2, names a.jpg twice"),
        ("0,0,1,1\n", "line 1, has no name"),
        ("a.jpg 0,0,1\n", "line 1: "),
    ],
)
def test_lists_that_cannot_be_understood(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "list.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_region(None, path)
    with pytest.raises(InputError, match="cannot be read"):
        read_region(None, tmp_path / "absent")


@pytest.mark.parametrize("roi", ["91,0,10,10", "0,61,10,20", "100,0,1,1"])
def test_a_region_outside_the_image_is_refused(roi: str) -> None:
    layout = Layout(Grid(1, 1), 0, read_region(roi))
    with pytest.raises(InputError, match=r"outside the undistorted image of a\.jpg, .*100x80"):
        layout.native_image("a.jpg", (100, 80))


def test_cuts_of_a_command_line() -> None:
    assert parse_cuts("3000,8000", "--column-cuts") == (3000, 8000)
    assert parse_cuts(None, "--column-cuts") == ()
    with pytest.raises(InputError, match=r'--column-cuts "3000;8000" is not a list of pixels'):
        parse_cuts("3000;8000", "--column-cuts")
