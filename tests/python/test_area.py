"""Areas on the ground: what GeoJSON says, and which sub-images see it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import plane_scene
from sirpy.area import Area, AreaFilter, footprint, read_area
from sirpy.errors import InputError
from sirpy.layout import Layout
from sirpy.native_scene import NativeCamera, NativeScene, Observations
from sirpy.rectangle import Grid, Rectangle

SQUARE = [[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]
HOLE = [[4, 4], [4, 6], [6, 6], [6, 4], [4, 4]]
SCENE = plane_scene(count=4, width=600, height=400)


def box(x0: float, y0: float, x1: float, y1: float) -> list[list[float]]:
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]


def area_of(*polygons: Any) -> Area:
    return Area(tuple(tuple(np.array(ring, float) for ring in rings) for rings in polygons))


def written(folder: Path, document: Any) -> Path:
    path = folder / "area.geojson"
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return path


def test_inside_is_in_a_polygon_and_in_no_hole_of_it() -> None:
    area = area_of([SQUARE, HOLE], [box(4.5, 4.5, 5.5, 5.5)], [box(20, 0, 30, 10)])
    points = np.array([[1, 1], [4.2, 4.2], [5, 5], [25, 5], [15, 5], [-1, 5]], float)
    np.testing.assert_array_equal(area.contains(points), [True, False, True, True, False, False])


def test_a_convex_polygon_touches_inside_outside_around_and_across() -> None:
    area = area_of([SQUARE, HOLE])

    def touches(*corners: float) -> bool:
        return area.touches(np.array(box(*corners)[:-1], float))

    assert touches(1, 1, 2, 2)  # inside
    assert touches(-5, -5, 20, 20)  # around
    assert touches(-5, 3, 20, 4)  # across, no corner of either inside the other
    assert touches(3, 3, 7, 7)  # around the hole
    assert not touches(4.5, 4.5, 5.5, 5.5)  # in the hole
    assert not touches(11, 11, 12, 12)
    assert not touches(-3, 12, 20, 13)
    assert not area.touches(np.empty((0, 2)))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=200, deadline=None)
def test_touching_is_sharing_a_point(seed: int) -> None:
    random = np.random.default_rng(seed)
    angles = np.sort(random.uniform(0, 2 * np.pi, 5))
    convex = random.uniform(-5, 15, 2) + 4 * np.column_stack([np.cos(angles), np.sin(angles)])
    area = area_of([SQUARE, HOLE])
    weights = random.dirichlet(np.full(5, 0.3), 300)
    if area.contains(weights @ convex).any():
        assert area.touches(convex)
    # The distance from the middle of one bounds all of it away from the other.
    if np.linalg.norm(convex.mean(axis=0) - 5) > 8 + 2 * 7.1:
        assert not area.touches(convex)


def looking(tilt: float, centre: tuple[float, float, float] = (0, 0, 100)) -> NativeCamera:
    """A camera of 200x200 pixels and 90 degrees that looks down, turned up towards +y by `tilt`."""
    c, s = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
    cam_from_world = np.array([[1, 0, 0], [0, -c, -s], [0, s, -c]], float)
    intrinsics = np.array([[100, 0, 100], [0, 100, 100], [0, 0, 1.0]])
    pose = np.column_stack([cam_from_world, -cam_from_world @ np.array(centre, float)])
    return NativeCamera("a.jpg", 200, 200, intrinsics, pose)


def test_the_footprint_holds_all_heights() -> None:
    # Looking straight down from 100: the right upper quarter sees 0 <= x, y <= 100 - z.
    found = footprint(looking(0), Rectangle(100, 0, 100, 100), (-10, 20), 1000)
    np.testing.assert_allclose(sorted(map(tuple, found)), [(0, 0), (0, 110), (110, 0), (110, 110)])


def test_above_the_horizon_it_ends_at_the_reach() -> None:
    # Looking at the horizon from 100: the lower half sees the ground from y = 100 on.
    found = footprint(looking(90), Rectangle(0, 100, 200, 100), (0, 0.001), 500)
    assert found[:, 1].min() == pytest.approx(99.999)
    assert found[:, 1].max() == pytest.approx(500)
    assert len(footprint(looking(90), Rectangle(0, 0, 200, 99), (0, 1), 500)) == 0


@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(1, 4))
@settings(max_examples=60, deadline=None)
def test_a_sub_image_that_sees_the_area_stays(seed: int, columns: int, rows: int) -> None:
    random = np.random.default_rng(seed)
    x, y = random.uniform([-60, -40], [60, 40])
    width, height = random.uniform(1, 30, 2)
    seeing = AreaFilter(area_of([box(x, y, x + width, y + height)]), SCENE)
    # The surface is where the sparse points are: within 2 of zero.
    low, high = [x, y, -2], [x + width, y + height, 2]
    surface = random.uniform(low, high, (300, 3))
    for camera in SCENE.cameras.values():
        pixels = camera.project(surface)
        native = Layout(Grid(columns, rows)).native_image(camera.name, (600, 400))
        kept = seeing(native)
        margin = 0.06 * 600  # 2 % of the depth and the range of heights, as pixels at the border
        for sub in native.sub_images:
            core = sub.core
            inside = (pixels >= [core.x0, core.y0]) & (pixels < [core.x1, core.y1])
            near = core.padded(int(margin))
            corners = camera.project(
                np.array(
                    [[a, b, c] for a in (x, x + width) for b in (y, y + height) for c in (-2, 2)]
                )
            )
            seen = Rectangle.from_corners(
                *np.floor(corners.min(0)).astype(int), *np.ceil(corners.max(0)).astype(int)
            )
            if inside.all(axis=1).any():
                assert sub in kept.sub_images
            elif near.intersection(seen).area == 0:
                assert sub not in kept.sub_images


def test_a_sub_image_with_a_point_in_the_area_stays_whatever_its_height() -> None:
    # A mast of 60 in the middle of a flat field: no percentile knows of it.
    camera = looking(0)
    field = np.column_stack([np.random.default_rng(0).uniform(-90, 90, (500, 2)), np.zeros(500)])
    points = np.vstack([field, [[30, 30, 60]]])
    seen = Observations(np.arange(501), camera.project(points), camera.in_camera(points)[:, 2])
    scene = NativeScene({"a.jpg": camera}, points, {"a.jpg": seen})
    seeing = AreaFilter(area_of([box(29, 29, 31, 31)]), scene)
    native = Layout(Grid(4, 4)).native_image("a.jpg", (200, 200))
    places = {(sub.row, sub.column) for sub in seeing(native).sub_images}
    assert (0, 3) in places  # the top, at 30 / 40 of the half side
    assert (1, 2) in places  # the foot
    assert (3, 0) not in places


def test_a_photograph_without_points_has_the_heights_of_all() -> None:
    blind = {"b.jpg": looking(0, (0, 0, 100))}
    nothing = Observations(np.empty(0, np.int64), np.empty((0, 2)), np.empty(0))
    scene = NativeScene(
        {**SCENE.cameras, **blind}, SCENE.points, {**SCENE.observations, "b.jpg": nothing}
    )
    seeing = AreaFilter(area_of([box(20, 20, 25, 25)]), scene)
    native = Layout(Grid(2, 2)).native_image("b.jpg", (200, 200))
    assert [(sub.row, sub.column) for sub in seeing(native).sub_images] == [(0, 1)]


@pytest.mark.parametrize(
    "document",
    [
        {"type": "Polygon", "coordinates": [SQUARE, HOLE]},
        {"type": "MultiPolygon", "coordinates": [[SQUARE, HOLE]]},
        {"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [SQUARE, HOLE]}},
        {
            "type": "FeatureCollection",
            "features": [
                {"type": "Feature", "geometry": None},
                {
                    "type": "Feature",
                    "geometry": {
                        "type": "GeometryCollection",
                        "geometries": [
                            {"type": "Polygon", "coordinates": [[[*p, 7.0] for p in SQUARE], HOLE]}
                        ],
                    },
                },
            ],
        },
    ],
)
def test_every_kind_of_geojson(tmp_path: Path, document: Any) -> None:
    ((outer, hole),) = read_area(written(tmp_path, document)).polygons
    np.testing.assert_array_equal(outer, SQUARE)
    np.testing.assert_array_equal(hole, HOLE)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ("{", "cannot be read as GeoJSON"),
        ("[" * 100_000, "cannot be read as GeoJSON"),
        ("[]", "holds a value where a Polygon"),
        ({"type": "Point", "coordinates": [0, 0]}, "holds a Point where a Polygon"),
        ({"type": "FeatureCollection", "features": []}, "holds no polygon"),
        ({"type": "FeatureCollection"}, "a list is missing"),
        ({"type": "Polygon", "coordinates": []}, "without a ring"),
        ({"type": "Polygon", "coordinates": [SQUARE[:-1]]}, "not closed"),
        ({"type": "Polygon", "coordinates": [[[0, 0]]]}, "not closed"),
        ({"type": "Polygon", "coordinates": [[["a", 0]] * 4]}, "not two numbers"),
        ({"type": "Polygon", "coordinates": [[0, 1, 2, 3]]}, "not two numbers"),
        ({"type": "Polygon", "coordinates": [[[1]] * 4]}, "not"),
        ('{"type": "Polygon", "coordinates": [[[NaN,0],[1,0],[1,1],[NaN,0]]]}', "not closed"),
    ],
)
def test_what_is_no_area_is_one_sentence(tmp_path: Path, document: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_area(written(tmp_path, document))
    with pytest.raises(InputError, match="cannot be read"):
        read_area(tmp_path / "absent.geojson")


def test_longitude_and_latitude_become_the_models_crs(tmp_path: Path) -> None:
    # On the central meridian of UTM zone 32 the easting is 500 000; 1/1000 degree of latitude is 111.2 m.
    area = read_area(
        written(tmp_path, {"type": "Polygon", "coordinates": [box(9, 48, 9.001, 48.001)]}),
        model_crs="EPSG:25832",
    )
    ring = area.polygons[0][0]
    low, high = ring.min(axis=0), ring.max(axis=0)
    assert low[0] == pytest.approx(500_000, abs=0.01)
    assert high[0] - low[0] == pytest.approx(74.6, abs=0.1)
    assert high[1] - low[1] == pytest.approx(111.2, abs=0.1)
    assert low[1] == pytest.approx(5_316_300, abs=100)


def test_the_crs_is_the_one_given_then_the_files_own(tmp_path: Path) -> None:
    square = {"type": "Polygon", "coordinates": [box(5e5, 53e5, 5e5 + 10, 53e5 + 10)]}
    named = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
    own = read_area(written(tmp_path, {**square, "crs": named}), model_crs="EPSG:25832")
    given_ = read_area(written(tmp_path, square), area_crs="EPSG:25832", model_crs="EPSG:25832")
    plain = read_area(written(tmp_path, square))
    for area in (own, given_, plain):
        assert area.polygons[0][0].min(axis=0) == pytest.approx([5e5, 53e5])
        assert area.polygons[0][0].max(axis=0) == pytest.approx([5e5 + 10, 53e5 + 10])
    with pytest.raises(InputError, match="does not know"):
        read_area(written(tmp_path, square), model_crs="EPSG:25832")


@pytest.mark.parametrize(
    ("crs", "message"),
    [
        ({"area_crs": "EPSG:4326"}, "needs the CRS of the model too"),
        ({"model_crs": "EPSG:4326"}, "is not projected"),
        ({"model_crs": "EPSG:999999"}, "--model_crs EPSG:999999 is not a known CRS"),
        ({"model_crs": "EPSG:25832", "area_crs": "here"}, "--area_crs here is not a known CRS"),
    ],
)
def test_a_crs_that_cannot_be_used(tmp_path: Path, crs: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_area(written(tmp_path, {"type": "Polygon", "coordinates": [SQUARE]}), **crs)
