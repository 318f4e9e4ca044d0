"""View fields: blocks have sources that see them and depths that hold the points, whatever the grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import plane_scene
from sirpy.native_scene import NativeScene
from sirpy.rectangle import Rectangle
from sirpy.view_fields import (
    MOST_SOURCES,
    ViewField,
    field_shape,
    frustum_corners,
    observations_around,
    projected_boxes,
    source_scores,
    view_field,
)

SCENE = plane_scene(count=7, width=800, height=600, points=60_000)  # about 90 in a block
WHOLE = Rectangle(0, 0, 800, 600)


def _without_points(scene: NativeScene, name: str, lost: np.ndarray) -> NativeScene:
    seen = scene.observations[name]
    kept = type(seen)(seen.point[~lost], seen.pixel[~lost], seen.depth[~lost])
    return replace(scene, observations={**scene.observations, name: kept})


def _allowed_names(field: ViewField, row: int, column: int) -> list[str]:
    mask = int(field.allowed[row, column])
    return [source.name for i, source in enumerate(field.sources) if mask >> i & 1]


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((13470, 8670), (1664, 6, 9)),
        ((1930, 1444), (256, 6, 8)),
        ((1444, 1930), (256, 8, 6)),
        ((100, 50), (128, 1, 1)),
        ((1024, 1025), (128, 9, 8)),
    ],
)
def test_blocks_are_an_eighth_of_the_longest_side(
    size: tuple[int, int], expected: tuple[int, int, int]
) -> None:
    assert field_shape(*size) == expected


@given(st.integers(0, 799), st.integers(0, 599), st.integers(1, 800), st.integers(1, 600))
def test_parts_tile_a_window_in_the_order_of_the_blocks(x: int, y: int, w: int, h: int) -> None:
    window = Rectangle(x, y, w, h).intersection(WHOLE)
    number = np.arange(35, dtype=np.uint32).reshape(5, 7)
    field = ViewField("", 128, (), number, number.astype(np.float32), number.astype(np.float32))
    blocks = np.full((600, 800), -1)
    parts = field.parts(window)
    for block, part in zip(field.allowed[field.blocks(window)].ravel(), parts, strict=True):
        blocks[part.slices_in(WHOLE)] = block
    every = np.kron(number, np.ones((128, 128), int))[:600, :800]
    inside = window.slices_in(WHOLE)
    assert (blocks[inside] == every[inside]).all()
    assert (blocks >= 0).sum() == window.area


def test_depths_hold_the_points_around_each_block_and_little_more() -> None:
    field = view_field(SCENE, "003.jpg", num_sources=4)
    assert field.side == 128 and field.allowed.shape == (5, 7)
    seen = SCENE.observations["003.jpg"]
    for row, column in np.ndindex(*field.allowed.shape):
        block = Rectangle(128 * column, 128 * row, 128, 128)
        depths = seen.depth[observations_around(SCENE, "003.jpg", block)]
        assert field.min_depth[row, column] < np.percentile(depths, 1)
        assert field.max_depth[row, column] > np.percentile(depths, 99)
    # Points lie within 2 of a depth of 100; margins are 2 %.
    assert field.min_depth.min() > 95.8 and field.max_depth.max() < 104.3


def test_a_tower_whose_points_fall_into_the_next_block_is_in_range() -> None:
    seen = SCENE.observations["003.jpg"]
    tower = (abs(seen.pixel - [448, 320]) < 20).all(axis=1)  # in row 2, column 3
    assert tower.sum() > 1
    depth = np.where(tower, 50.0, seen.depth)
    scene = replace(
        SCENE,
        observations={
            **SCENE.observations,
            "003.jpg": type(seen)(seen.point, seen.pixel, depth),
        },
    )
    near = view_field(scene, "003.jpg", num_sources=4).min_depth < 90
    expected = np.zeros_like(near)
    expected[1:4, 2:5] = True
    assert (near == expected).all()


def test_sloping_ground_goes_on_where_its_points_end() -> None:
    """A plane of inverse depths 0.01 to 0.019, seen up to 60 pixels from the borders of the image."""
    rng = np.random.default_rng(3)
    pixel = rng.uniform([60, 60], [836, 580], (5000, 2))

    def depth(xy: np.ndarray) -> np.ndarray:
        return 1 / (0.01 + xy @ [7e-6, 4e-6])

    seen = SCENE.observations["003.jpg"]
    plane = type(seen)(np.resize(seen.point, 5000), pixel, depth(pixel))
    camera = replace(SCENE.cameras["003.jpg"], width=896, height=640)
    scene = replace(
        SCENE,
        cameras={**SCENE.cameras, "003.jpg": camera},
        observations={**SCENE.observations, "003.jpg": plane},
    )
    field = view_field(scene, "003.jpg", num_sources=1)
    ys, xs = np.mgrid[0:640, 0:896]
    true = depth(np.stack([xs + 0.5, ys + 0.5], axis=-1))
    block = np.ix_(np.arange(640) // 128, np.arange(896) // 128)
    assert (field.min_depth[block] < true).all() and (true < field.max_depth[block]).all()
    share = (1 / field.min_depth - 1 / field.max_depth).mean() / (0.019 - 0.01)
    assert share < 0.75  # three blocks of seven, and the margins


def test_ground_without_points_is_where_the_rest_of_the_ground_goes_on() -> None:
    """Inverse depths of a plane with houses, seen in the left half of the image alone."""
    rng = np.random.default_rng(3)
    pixel = rng.uniform([0, 0], [400, 600], (3000, 2))

    def inverse(xy: np.ndarray) -> np.ndarray:
        return 0.01 + xy @ [1e-5, 2e-6]

    houses = rng.uniform(size=3000) < 0.2
    depth = 1 / (inverse(pixel) * np.where(houses, 1.05, 1.0))
    seen = SCENE.observations["003.jpg"]
    half = type(seen)(np.resize(seen.point, 3000), pixel, depth)
    scene = replace(SCENE, observations={**SCENE.observations, "003.jpg": half})
    field = view_field(scene, "003.jpg", num_sources=1)
    ys, xs = np.mgrid[0:600, 0:800]
    true = inverse(np.stack([xs + 0.5, ys + 0.5], axis=-1))
    block = np.ix_(np.arange(600) // 128, np.arange(800) // 128)
    assert (1 / field.max_depth[block] < true).all()
    assert (1.04 * true < 1 / field.min_depth[block]).all()
    # Where there are points, no wider than the slope over three blocks and the houses ask for.
    wide = 1 / field.min_depth[:, :2] - 1 / field.max_depth[:, :2]
    assert wide.max() < 1.5 * (3 * 128 * 1.2e-5 + 9e-4)


def test_the_sky_is_not_deeper_than_twice_the_points() -> None:
    """Inverse depths that would fall below 0 beyond the points."""
    rng = np.random.default_rng(3)
    pixel = rng.uniform([0, 150], [800, 600], (5000, 2))
    depth = 1 / (4e-5 * (pixel[:, 1] - 149))
    seen = SCENE.observations["003.jpg"]
    ground = type(seen)(np.resize(seen.point, 5000), pixel, depth)
    scene = replace(SCENE, observations={**SCENE.observations, "003.jpg": ground})
    field = view_field(scene, "003.jpg", num_sources=1)
    assert (field.min_depth > 0).all()
    assert depth.max() / 4 < field.max_depth.max() <= 2 * depth.max()


def test_blocks_are_matched_against_what_sees_them_best() -> None:
    field = view_field(SCENE, "003.jpg", num_sources=3)
    assert {source.level for source in field.sources} == {0}
    middle = _allowed_names(field, 2, 3)
    # 20 to the side at a height of 100 is 11 degrees: the best.
    assert len(middle) == 3 and {"002.jpg", "004.jpg"} <= set(middle)
    assert {source.name for source in field.sources[:2]} == {"002.jpg", "004.jpg"}
    left, right = _allowed_names(field, 2, 0), _allowed_names(field, 2, 6)
    assert "001.jpg" in left and "001.jpg" not in right
    assert "005.jpg" in right and "005.jpg" not in left


@pytest.mark.parametrize("num_sources", [1, 2, 8, 16])
def test_every_allowed_source_sees_the_block(num_sources: int) -> None:
    for name, camera in SCENE.cameras.items():
        field = view_field(SCENE, name, num_sources=num_sources)
        assert (field.allowed != 0).mean() > 0.5
        for row, column in np.ndindex(*field.allowed.shape):
            names = _allowed_names(field, row, column)
            assert (
                len(names) <= num_sources + 2
            )  # more where some pixels would have less than three
            block = Rectangle(128 * column, 128 * row, 128, 128).intersection(WHOLE)
            ys, xs = np.mgrid[block.y0 : block.y1 : 4, block.x0 : block.x1 : 4]
            pixels = np.column_stack([xs.ravel(), ys.ravel()]).astype(float)
            for other in names:
                source = SCENE.cameras[other]
                seen = [
                    source.project(camera.world(pixels, np.full(len(pixels), depth[row, column])))
                    for depth in (field.min_depth, field.max_depth)
                ]
                inside = [((p > 0) & (p < [800, 600])).all(axis=1).any() for p in seen]
                assert any(inside)


def test_images_that_are_not_cut_are_no_sources() -> None:
    field = view_field(SCENE, "003.jpg", num_sources=2, cut={"003.jpg", "000.jpg", "005.jpg"})
    assert {source.name for source in field.sources} <= {"000.jpg", "005.jpg"}
    assert field.allowed.any()


def test_a_block_without_points_takes_those_around_it() -> None:
    lost = SCENE.observations["003.jpg"].pixel[:, 0] <= 600
    field = view_field(_without_points(SCENE, "003.jpg", lost), "003.jpg", num_sources=4)
    assert (field.min_depth > 90).all() and (field.allowed != 0).all()
    # What the points show of the sources is far to the right, but those that cannot see the left are out.
    assert "006.jpg" not in _allowed_names(field, 0, 0)


def test_a_block_without_points_takes_what_would_see_its_ground() -> None:
    """No other photograph shares points with the left of this one, as where oblique views meet."""
    seen = SCENE.observations["003.jpg"]
    start, camera = SCENE.observers
    first = list(SCENE.cameras).index("001.jpg")
    shared = np.array([first in camera[start[i] : start[i + 1]] for i in seen.point])
    scene = _without_points(SCENE, "003.jpg", (seen.pixel[:, 0] <= 600) | shared)
    field = view_field(scene, "003.jpg", num_sources=4)
    whole = view_field(SCENE, "003.jpg", num_sources=4)
    assert "001.jpg" in _allowed_names(whole, 2, 0) and "001.jpg" in _allowed_names(field, 2, 0)


def test_an_image_with_hardly_a_point_has_an_empty_field() -> None:
    lost = np.arange(len(SCENE.observations["003.jpg"].point)) >= 2
    field = view_field(_without_points(SCENE, "003.jpg", lost), "003.jpg", num_sources=4)
    assert field.sources == ()
    assert not (field.allowed.any() or field.min_depth.any() or field.max_depth.any())


def test_a_table_holds_the_best_32_and_blocks_use_no_others() -> None:
    scene = plane_scene(count=45, width=800, height=600, spacing=2.0)
    field = view_field(scene, "022.jpg", num_sources=16)
    every = view_field(scene, "022.jpg", num_sources=2)
    assert len(field.sources) == MOST_SOURCES
    assert len({source.name for source in field.sources}) == MOST_SOURCES
    assert (field.allowed != 0).all()
    counts = [bin(mask).count("1") for mask in field.allowed.ravel()]
    assert max(counts) == 16
    # The two best of every block are among them, in the order of the blocks' first choices.
    assert {source.name for source in every.sources} <= {source.name for source in field.sources}
    best = source_scores(scene, "022.jpg", Rectangle(384, 256, 128, 128))
    assert next(iter(best)) in {source.name for source in field.sources[:8]}


def test_the_choice_of_a_block_does_not_know_the_rest_of_the_image() -> None:
    """Points far from a block can be lost, and neither its sources nor its depths change."""
    whole = view_field(SCENE, "003.jpg", num_sources=3)
    lost = SCENE.observations["003.jpg"].pixel[:, 0] > 640
    part = view_field(_without_points(SCENE, "003.jpg", lost), "003.jpg", num_sources=3)
    for row in range(5):
        for column in range(3):
            assert set(_allowed_names(part, row, column)) == set(_allowed_names(whole, row, column))
    assert (part.min_depth[:, :3] == whole.min_depth[:, :3]).all()
    assert (part.max_depth[:, :3] == whole.max_depth[:, :3]).all()


def _scaled(scene: NativeScene, name: str, factor: float) -> NativeScene:
    """The same scene with one photograph taken with `factor` times the pixels."""
    camera, seen = scene.cameras[name], scene.observations[name]
    larger = replace(
        camera,
        width=round(camera.width * factor),
        height=round(camera.height * factor),
        intrinsics=np.diag([factor, factor, 1.0]) @ camera.intrinsics,
    )
    return replace(
        scene,
        cameras={**scene.cameras, name: larger},
        observations={
            **scene.observations,
            name: type(seen)(seen.point, factor * seen.pixel, seen.depth),
        },
    )


@pytest.mark.parametrize(
    ("factor", "level"), [(0.25, 0), (1.0, 0), (1.35, 0), (1.5, 1), (2.0, 1), (4.5, 2), (20.0, 3)]
)
def test_a_source_of_finer_pixels_is_read_coarser(factor: float, level: int) -> None:
    scene = _scaled(SCENE, "002.jpg", factor)
    field = view_field(scene, "003.jpg", num_sources=16)
    levels = {source.name: source.level for source in field.sources}
    assert levels.pop("002.jpg") == level
    assert set(levels.values()) == {0}
    # The other way it is too coarse, for which there is no mending.
    own = view_field(scene, "002.jpg", num_sources=16)
    expected = max(0, min(3, round(-np.log2(factor))))
    assert {source.level for source in own.sources} == {expected}


@settings(max_examples=30)
@given(st.integers(0, 6), st.integers(0, 6), st.floats(5, 90), st.floats(1, 3), st.integers(0, 99))
def test_projected_boxes_hold_the_frustum(
    ref: int, src: int, near: float, ratio: float, seed: int
) -> None:
    cameras = list(SCENE.cameras.values())
    reference, source = cameras[ref], cameras[src]
    rng = np.random.default_rng(seed)
    parts = [Rectangle(*map(int, rng.integers(1, 300, 4))) for _ in range(3)]
    depths = np.array([[near, near * ratio]] * 3)
    corners = frustum_corners(reference, parts, depths)
    for part, box in zip(parts, projected_boxes(source, corners), strict=True):
        pixel = rng.uniform([part.x0, part.y0], [part.x1, part.y1], (200, 2))
        seen = source.project(reference.world(pixel, rng.uniform(near, near * ratio, 200)))
        assert (seen >= box[:2] - 1e-6).all() and (seen <= box[2:] + 1e-6).all()
        assert box[0] == pytest.approx(box[0]) and box[2] - box[0] < 20_000


def test_a_frustum_behind_the_source_may_be_anywhere() -> None:
    reference = SCENE.cameras["003.jpg"]
    corners = frustum_corners(reference, [Rectangle(0, 0, 8, 8)], np.array([[-5.0, 100.0]]))
    box = projected_boxes(SCENE.cameras["002.jpg"], corners)[0]
    assert (box[:2] < -1e6).all() and (box[2:] > 1e6).all()
