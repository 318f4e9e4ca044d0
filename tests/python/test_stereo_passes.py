"""What a pass starts from: maps of units, read in any rectangle, on cases solved by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sirpy import _core
from sirpy.errors import InputError
from sirpy.native_images import NativeImage, SubImage
from sirpy.patch_match import PatchMatch
from sirpy.rectangle import Grid, Rectangle
from sirpy.stereo_backend import DepthMap
from sirpy.stereo_passes import (
    PassMaps,
    at_level,
    native_pixels,
    units,
    write_planes,
)
from sirpy.workspace import Workspace

SIZE = 21, 12
COARSEST = 2
GRID = Grid.with_cuts((9,), (5,))  # inside pixels of level 1


def cut(folder: Path, region: Rectangle = Rectangle(0, 0, *SIZE), grid: Grid = GRID) -> Workspace:
    workspace = Workspace(folder)
    subs = [SubImage(f"{row}{col}.png", row, col, one, one) for row, col, one in grid.tiles(region)]
    workspace.write_index([NativeImage("a.png", *SIZE, tuple(subs))], [])
    return workspace


def planes_of(rectangle: Rectangle) -> DepthMap:
    """Of every pixel of a level its own values, whatever the rectangle."""
    y, x = (axis.astype(np.float32) for axis in np.indices((rectangle.height, rectangle.width)))
    depth = 1 + x + rectangle.x0 + 100 * (y + rectangle.y0)
    views = np.uint32(0xFFFFFFFF) - depth.astype(np.int32).astype(np.uint32)  # many are no number
    level = (depth % 5).astype(np.uint8)
    seeing = (depth % 7).astype(np.uint8)
    return DepthMap(
        depth,
        normal=np.stack([depth, -depth, depth / 2]),
        views=views,
        cost=depth / 3,
        texture=depth / 4,
        num_seeing=seeing,
        num_consistent=seeing // 2,
        sigma=depth / 5,
        motion=depth / 6,
        level=level,
    )


def pass_maps(workspace: Workspace, of_pass: PatchMatch) -> PassMaps:
    """Of a pass that was written, each unit with more around it than it keeps."""
    for unit in units(workspace.natives, of_pass.level, COARSEST):
        window = unit.kept.padded(2)
        path = workspace.pass_map(unit.name, of_pass.name)
        write_planes(path, planes_of(window), of_pass.planes, unit.kept.slices_in(window))
    return PassMaps(workspace, of_pass, COARSEST)


@pytest.fixture
def start_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the core is given, as a dictionary."""
    monkeypatch.setattr(_core, "StartMaps", dict)


@pytest.mark.parametrize("level", [0, 1, 2])
def test_a_rectangle_is_read_across_the_borders_of_units(tmp_path: Path, level: int) -> None:
    maps = pass_maps(cut(tmp_path), PatchMatch(level, "photometric", 1))
    whole = at_level(Rectangle(0, 0, *SIZE), level)
    for rectangle in (whole, Rectangle(1, 1, whole.width - 2, whole.height - 2)):
        expected = vars(planes_of(rectangle))
        for kind in ("depth", "normal", "views"):
            found = maps.read("a.png", rectangle, kind)  # type: ignore[arg-type]
            assert found.dtype == expected[kind].dtype
            np.testing.assert_array_equal(found, expected[kind])


def test_a_geometric_pass_writes_what_settles_the_finer_levels(tmp_path: Path) -> None:
    geometric, photometric = (PatchMatch(1, kind, 1) for kind in ("geometric", "photometric"))
    rectangle = Rectangle(2, 1, 7, 4)
    expected = planes_of(rectangle)
    for of_pass in (photometric, geometric):
        maps = pass_maps(cut(tmp_path), of_pass)
        np.testing.assert_array_equal(maps.read("a.png", rectangle, "sigma"), expected.sigma)
        np.testing.assert_array_equal(maps.read("a.png", rectangle, "level"), expected.level)
    assert geometric.planes == (*photometric.planes, "cost", "texture", "counts")
    np.testing.assert_array_equal(maps.read("a.png", rectangle, "cost"), expected.cost)
    counts = maps.read("a.png", rectangle, "counts")
    np.testing.assert_array_equal(counts & np.uint32(255), expected.num_seeing)
    np.testing.assert_array_equal(counts >> np.uint32(8), expected.num_consistent)


def test_what_is_not_cut_reads_as_0(tmp_path: Path) -> None:
    maps = pass_maps(cut(tmp_path, Rectangle(6, 3, 9, 8)), PatchMatch(1, "photometric", 1))
    window = Rectangle(0, 0, 11, 6)
    kept = np.zeros((6, 11), bool)
    kept[2:6, 3:8] = True  # whose first native pixel is inside
    expected = vars(planes_of(window))
    for kind in ("depth", "normal", "views"):
        found = maps.read("a.png", window, kind)  # type: ignore[arg-type]
        np.testing.assert_array_equal(found, expected[kind] * kept)


def test_coarser_depths_are_those_next_to_the_centres(tmp_path: Path) -> None:
    workspace = cut(tmp_path)
    maps = pass_maps(workspace, PatchMatch(0, "photometric", 1))
    native = workspace.natives[0]
    depth = planes_of(native.rectangle).depth
    # Pixel i of level 1 has its centre at native pixels 2 i and 2 i + 1; of level 2, 4 i + 1 and 4 i + 2. The
    # last column of both is less than half inside.
    at_1 = depth[np.ix_([3, 5], [17, 19, 20])]
    np.testing.assert_array_equal(maps.read_coarser(native, Rectangle(8, 1, 3, 2), 1), at_1)
    at_2 = depth[np.ix_([2, 6, 10], [14, 18, 20])]
    np.testing.assert_array_equal(maps.read_coarser(native, Rectangle(3, 0, 3, 3), 2), at_2)
    same = Rectangle(7, 2, 5, 6)
    np.testing.assert_array_equal(
        maps.read_coarser(native, same, 0), depth[same.slices_in(native.rectangle)]
    )


def test_a_pass_starts_from_the_same_level_or_with_the_four_nearest_of_the_coarser(
    tmp_path: Path, start_maps: None
) -> None:
    maps = pass_maps(cut(tmp_path), PatchMatch(2, "geometric", 1))
    for level, rectangle, read in [
        (2, Rectangle(1, 1, 3, 2), Rectangle(1, 1, 3, 2)),
        (1, Rectangle(5, 3, 3, 1), Rectangle(1, 0, 4, 3)),  # pixels 5 to 7 lie in 2 and 3
        (1, Rectangle(0, 0, 11, 6), Rectangle(0, 0, 6, 3)),  # no more than there are
    ]:
        start: Any = maps.start("a.png", rectangle, level)
        assert (start["level"], start["x0"], start["y0"]) == (2, read.x0, read.y0)
        for kind in ("depth", "normal", "views"):
            expected = getattr(planes_of(read), kind)
            np.testing.assert_array_equal(start[kind], expected)
        np.testing.assert_array_equal(start["sigma"], planes_of(read).sigma)
        np.testing.assert_array_equal(start["level_of"], planes_of(read).level)
        assert start["level_of"].dtype == np.uint8


def test_what_is_narrower_than_a_pixel_has_no_unit_and_no_start(tmp_path: Path) -> None:
    workspace = cut(tmp_path, Rectangle(1, 0, 3, 12), Grid(1, 2))
    coarse, finer, native = (PatchMatch(level, "photometric", 1) for level in (COARSEST, 1, 0))
    assert not list(units(workspace.natives, COARSEST, COARSEST))
    maps = pass_maps(workspace, coarse)
    assert maps.start("a.png", Rectangle(1, 0, 1, 6), 1) is None
    assert not maps.read("a.png", Rectangle(0, 0, 2, 3), "depth").any()
    assert [one.kept.width for one in units(workspace.natives, 1, COARSEST)] == [1, 1]
    assert pass_maps(workspace, finer).start("a.png", Rectangle(1, 0, 3, 12), 0) is not None
    assert len(list(units(workspace.natives, native.level, COARSEST))) == 2


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:150],
        lambda data: b"",
        lambda data: b"x" * len(data),
        lambda data: data.replace(b"<f4", b"<u4"),
        lambda data: data.replace(b"(7, 3, 6)", b"(7, 6, 3)"),
    ],
)
def test_damaged_files_are_said_and_can_be_made_again(
    tmp_path: Path, damage: Callable[[bytes], bytes]
) -> None:
    workspace, of_pass = cut(tmp_path), PatchMatch(1, "photometric", 1)
    maps = pass_maps(workspace, of_pass)
    path = workspace.pass_map("01.png", of_pass.name)
    sound = path.read_bytes()
    path.write_bytes(damage(sound))
    assert path.read_bytes() != sound
    with pytest.raises(InputError, match=r"01\.png\.npy .*: delete it and run the stereo again$"):
        maps.read("a.png", Rectangle(0, 0, 11, 6), "depth")
    np.testing.assert_array_equal(  # what the damage does not touch
        maps.read("a.png", Rectangle(0, 0, 5, 6), "depth"),
        planes_of(Rectangle(0, 0, 5, 6)).depth,
    )
    path.unlink()
    with pytest.raises(InputError, match=r"there is no .*01\.png\.npy: run the stereo again$"):
        maps.read("a.png", Rectangle(0, 0, 11, 6), "depth")
    again = pass_maps(workspace, of_pass).read("a.png", Rectangle(0, 0, 11, 6), "depth")
    np.testing.assert_array_equal(again, planes_of(Rectangle(0, 0, 11, 6)).depth)


def test_rectangles_that_tile_an_image_tile_its_levels() -> None:
    for level in (1, 2, 3):
        whole = at_level(Rectangle(0, 0, *SIZE), level)
        owners = np.zeros((whole.height, whole.width), int)
        for _, _, core in GRID.cores(*SIZE):
            owners[at_level(core, level).slices_in(whole)] += 1
        assert (owners == 1).all()
        assert native_pixels(whole, level, Rectangle(0, 0, *SIZE)) == Rectangle(0, 0, *SIZE)
