"""View windows: they hold every match, on the lattice of the level; fields and windows know no grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import plane_scene
from sirpy.errors import InputError
from sirpy.layout import Layout, Region
from sirpy.native_images import SubImage
from sirpy.native_scene import NativeScene
from sirpy.rectangle import Grid, Rectangle
from sirpy.view_fields import FieldSource, ViewField, view_field
from sirpy.view_windows import (
    PATCH_REACH,
    ViewSelection,
    aligned,
    coarsest_level,
    source_windows,
    sub_image_views,
    top_level,
)

SCENE = plane_scene(count=7, width=800, height=600)
NAMES = list(SCENE.cameras)
WHOLE = Rectangle(0, 0, 800, 600)
ALL = dict.fromkeys(NAMES, WHOLE)
RECTANGLES = st.tuples(
    st.integers(0, 790), st.integers(0, 590), st.integers(1, 800), st.integers(1, 600)
).map(lambda sides: Rectangle(*sides).intersection(WHOLE))


def _hilly(seed: int) -> tuple[NativeScene, ViewField]:
    """Cameras that look in all directions, and a field of any depths and sources."""
    rng = np.random.default_rng(seed)
    cameras = {}
    for name, camera in SCENE.cameras.items():
        x, y, z = rng.normal(0, 0.25, 3)
        turn = np.linalg.qr(np.array([[1, -z, y], [z, 1, -x], [-y, x, 1.0]]))[0]
        turn = turn * np.sign(np.diag(turn))
        cameras[name] = replace(camera, cam_from_world=turn @ camera.cam_from_world)
    low = rng.uniform(20, 100, (5, 7)).astype(np.float32)
    high = (low * rng.uniform(1, 2, (5, 7))).astype(np.float32)
    sources = tuple(FieldSource(name, int(rng.integers(0, 4))) for name in NAMES[1:])
    allowed = rng.integers(0, 1 << len(sources), (5, 7)).astype(np.uint32)
    scene = replace(SCENE, cameras=cameras)
    return scene, ViewField(NAMES[0], 128, sources, allowed, low, high)


@settings(max_examples=60)
@given(RECTANGLES, st.integers(0, 4), st.integers(0, 2**32 - 1))
def test_every_pixel_at_every_depth_of_its_block_projects_into_the_window_with_its_patch(
    window: Rectangle, level: int, seed: int
) -> None:
    scene, field = _hilly(seed)
    reference = scene.cameras[field.name]
    found = source_windows(scene, field, window, level=level)
    rng = np.random.default_rng(seed)
    pixel = rng.uniform([window.x0, window.y0], [window.x1, window.y1], (500, 2))
    block = tuple((pixel[:, ::-1] // 128).astype(int).T)
    depth = rng.uniform(field.min_depth[block], field.max_depth[block])
    world = reference.world(pixel, depth)
    for index, source in enumerate(field.sources):
        matched = field.allowed[block] >> np.uint32(index) & 1 == 1
        camera = scene.cameras[source.name]
        matched &= camera.in_camera(world)[:, 2] > 0
        seen = camera.project(world[matched])
        # A pixel of the level that the source is read at, and the patch around it, inside the image.
        reach = PATCH_REACH * 2.0 ** (level + source.level)
        low, high = np.maximum(seen - reach, 0), np.minimum(seen + reach, [800, 600])
        partly = (low < high).all(axis=1)
        if not partly.any():
            continue
        window_of = found[index]
        assert (low[partly] >= [window_of.x0, window_of.y0]).all()
        assert (high[partly] <= [window_of.x1, window_of.y1]).all()


@given(RECTANGLES, st.integers(0, 4), st.integers(0, 2**32 - 1))
def test_source_windows_are_whole_pixels_of_the_level_they_are_read_at(
    window: Rectangle, level: int, seed: int
) -> None:
    scene, field = _hilly(seed)
    part = Rectangle(101, 77, 600, 500)
    covered = dict.fromkeys(NAMES, part)
    blocks = field.allowed[field.blocks(window)]
    everything = source_windows(scene, field, window, level=level)
    for index, found in source_windows(scene, field, window, level=level, covered=covered).items():
        step = 1 << (level + field.sources[index].level)
        assert (found.x0 % step, found.y0 % step) == (0, 0)
        assert found.x1 % step == 0 or found.x1 == 800
        assert found.y1 % step == 0 or found.y1 == 600
        assert found.area and aligned(part, WHOLE, step).contains(found)
        assert everything[index].contains(found)
        assert (blocks >> np.uint32(index) & 1).any()


def test_a_source_in_the_middle_of_what_is_seen_is_needed_whole() -> None:
    """Where a corner of a frustum lies behind the source nothing is known of the projection."""
    field = view_field(SCENE, "003.jpg", num_sources=2)
    deep = replace(field, max_depth=np.full_like(field.max_depth, 1000.0))
    turned = SCENE.cameras["002.jpg"]
    down = np.diag([1.0, -1.0, -1.0])  # upwards from below the ground
    centre = np.array([0, 0, -50.0])
    flipped = np.column_stack([np.eye(3), -centre])
    assert turned.cam_from_world[:, :3] == pytest.approx(down)
    cameras = {**SCENE.cameras, "002.jpg": replace(turned, cam_from_world=flipped)}
    scene = replace(SCENE, cameras=cameras)
    index = [source.name for source in field.sources].index("002.jpg")
    middle = Rectangle(384, 256, 64, 64)
    assert source_windows(scene, deep, middle, level=0)[index] == WHOLE
    assert source_windows(SCENE, field, middle, level=0)[index] != WHOLE


@given(RECTANGLES, RECTANGLES, st.integers(0, 4))
def test_windows_of_a_part_lie_inside_those_of_the_whole(
    window: Rectangle, part: Rectangle, level: int
) -> None:
    part = part.intersection(window)
    if not part.area:
        return
    field = view_field(SCENE, "002.jpg", num_sources=3)
    whole = source_windows(SCENE, field, window, level=level)
    for index, found in source_windows(SCENE, field, part, level=level).items():
        assert whole[index].contains(found)


@given(
    st.integers(-50, 850),
    st.integers(-50, 650),
    st.integers(1, 300),
    st.integers(1, 300),
    st.integers(0, 6),
)
def test_aligned_windows_hold_the_window_on_the_lattice(
    x: int, y: int, w: int, h: int, level: int
) -> None:
    window, step = Rectangle(x, y, w, h), 1 << level
    found = aligned(window, WHOLE, step)
    inside = window.intersection(WHOLE)
    assert found.area == 0 if inside.area == 0 else found.contains(inside)
    if found.area:
        assert found.x0 % step == 0 and found.y0 % step == 0
        assert found.x1 % step == 0 or found.x1 == WHOLE.x1
        assert found.x1 - inside.x1 < step and inside.x0 - found.x0 < step


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 6), st.integers(1, 6), st.integers(0, 60), RECTANGLES, st.sampled_from(NAMES))
def test_the_field_is_the_same_whatever_is_cut(
    columns: int, rows: int, overlap: int, roi: Rectangle, name: str
) -> None:
    roi = Rectangle(roi.x0, roi.y0, max(roi.width, 8), max(roi.height, 8)).intersection(WHOLE)
    columns, rows = min(columns, roi.width), min(rows, roi.height)
    layout = Layout(Grid(columns, rows), overlap, Region(roi=roi))
    natives = {one: layout.native_image(one, (800, 600)) for one in NAMES}
    covered = {one: native.covered for one, native in natives.items()}
    selection = ViewSelection(SCENE, covered, num_sources=3, halo=16)
    uncut = view_field(SCENE, name, num_sources=3)
    field = selection.field(name)
    assert (field.name, field.side, field.sources) == (uncut.name, uncut.side, uncut.sources)
    for array in ("allowed", "min_depth", "max_depth"):
        assert getattr(field, array).tobytes() == getattr(uncut, array).tobytes()
    for sub_image in natives[name].sub_images:
        found = selection.sub_image(name, sub_image)
        assert found.window.contains(sub_image.stored)
        blocks = field.blocks(found.window)
        assert found.min_depth == field.min_depth[blocks].min()
        assert found.max_depth == field.max_depth[blocks].max()
        names = [source.name for source in found.sources]
        order = [source.name for source in field.sources if source.name in names]
        assert names == order


def test_sub_images_take_the_sources_and_depths_of_the_blocks_that_they_touch() -> None:
    field = view_field(SCENE, "003.jpg", num_sources=2)
    ramp = np.arange(35, dtype=np.float32).reshape(5, 7)
    field = replace(field, min_depth=90 + ramp, max_depth=100 + ramp)
    core = Rectangle(130, 140, 200, 90)  # blocks of column 1 and 2, row 1
    sub_image = SubImage("s", 0, 0, core, core)
    found = sub_image_views(SCENE, field, sub_image, halo=0, coarsest=2)
    assert found.window == Rectangle(128, 140, 204, 92)  # whole pixels of level 2
    assert (found.min_depth, found.max_depth) == (90 + 8, 100 + 9)
    masks = field.allowed[1, 1] | field.allowed[1, 2]
    expected = [s.name for i, s in enumerate(field.sources) if int(masks) >> i & 1]
    assert [source.name for source in found.sources] == expected
    assert len(expected) < len(field.sources)
    around = sub_image_views(SCENE, field, sub_image, halo=16, coarsest=2)
    assert around.window == Rectangle(112, 124, 236, 124)
    assert (around.min_depth, around.max_depth) == (90, 100 + 9)


def test_a_window_stays_inside_what_is_covered() -> None:
    covered = ALL | {"003.jpg": Rectangle(100, 101, 300, 200)}
    field = view_field(SCENE, "003.jpg", num_sources=2)
    core = Rectangle(100, 101, 150, 200)
    found = sub_image_views(
        SCENE, field, SubImage("s", 0, 0, core, core), halo=40, coarsest=3, covered=covered
    )
    assert found.window == Rectangle(96, 96, 200, 208)


@pytest.mark.parametrize(
    ("size", "level"),
    [((640, 480), 2), ((8000, 4000), 2), ((8001, 4000), 3), ((13470, 8670), 3), ((16000, 8001), 4)],
)
def test_the_coarsest_level_has_two_megapixels_at_most(size: tuple[int, int], level: int) -> None:
    small = SCENE.cameras["000.jpg"]
    large = replace(small, width=size[0], height=size[1])
    assert coarsest_level([small, large]) == level


def test_the_pixels_of_a_pass_are_those_of_its_level() -> None:
    selection = ViewSelection(SCENE, ALL, num_sources=8, halo=0)
    reference, sources = selection.pixels("003.jpg", None)
    assert reference == 800 * 600 // 16
    assert 2 * reference < sources < 6 * reference
    # At the native level all of the photograph is one sub-image, but a source may be read coarser.
    (whole,) = Layout(Grid(1, 1)).native_image("003.jpg", (800, 600)).sub_images
    native = selection.pixels("003.jpg", whole)
    assert native[0] == 800 * 600
    assert native[1] == pytest.approx(16 * sources, rel=0.2)
    field = selection.field("003.jpg")
    finer = tuple(replace(source, level=1) for source in field.sources)
    selection._fields["003.jpg"] = replace(field, sources=finer)
    assert selection.pixels("003.jpg", whole)[1] == pytest.approx(native[1] / 4, rel=0.1)


@pytest.mark.parametrize(
    ("sizes", "coarsest", "level"),
    [
        ([(432, 200)], 2, 3),  # 25 of the shorter side
        ([(60, 40)], 2, 2),  # never below the coarsest
        ([(6000, 4000)], 2, 7),
        ([(6000, 3071)], 2, 6),
        ([(13470, 8670)], 4, 7),  # and never above what blocks are made of
        ([(6000, 4000), (1000, 768)], 2, 5),  # the smallest photograph decides
    ],
)
def test_the_top_level_still_shows_something(
    sizes: list[tuple[int, int]], coarsest: int, level: int
) -> None:
    assert top_level(sizes, coarsest) == level


def test_a_window_wider_than_stereo_can_address_is_refused() -> None:
    scene = plane_scene(count=2, width=40_000, height=4000, spacing=1, points=100_000)
    everything = Rectangle(0, 0, 40_000, 4000)
    whole = SubImage("wide", 0, 0, everything, everything)
    selection = ViewSelection(scene, dict.fromkeys(scene.cameras, everything), 1, halo=0)
    with pytest.raises(InputError, match="cut more columns"):
        selection.sub_image(next(iter(scene.cameras)), whole)
