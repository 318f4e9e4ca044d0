"""Drawing points and comparing pictures, on cases solved by hand."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest
from sirpy.posed_camera import PosedCamera
from sirpy.rectangle import Rectangle
from sirpy.rephotography import comparable, draw, luma, ncc, shrunk, shrunk_buffer

FOCAL = 1000.0
WHOLE = Rectangle(0, 0, 12, 8)


def view() -> PosedCamera:
    """At depth FOCAL the world's x and y are pixels."""
    lens = pycolmap.Camera(
        camera_id=1, model="PINHOLE", width=12, height=8, params=[FOCAL, FOCAL, 0.0, 0.0]
    )
    return PosedCamera("a.png", lens, np.eye(4)[:3])


def drawn(
    points: list[tuple[float, float, float]],
    greys: list[int],
    radius: float = 0.5,
    window: Rectangle = WHOLE,
) -> np.ndarray:
    """Grey values, -1 where there is nothing; places are in pixels, at any depth."""
    x, y, z = np.array(points, np.float64).T
    world = np.column_stack([x * z / FOCAL, y * z / FOCAL, z])
    colours = np.repeat(np.array(greys, np.uint8)[:, None], 3, axis=1)
    grey, covered = shrunk_buffer(draw(view(), lambda: [(world, colours)], window, radius), 1)
    return np.where(covered, grey, -1)


def test_a_point_fills_the_square_around_it() -> None:
    one = drawn([(3.7, 2.2, 5.0)], [100])
    assert one[2, 3] == pytest.approx(100, abs=0.01)
    assert (one >= 0).sum() == 1
    two = drawn([(3.7, 2.2, 5.0)], [100], radius=1)
    np.testing.assert_array_equal(np.argwhere(two >= 0), [[1, 3], [1, 4], [2, 3], [2, 4]])
    three = drawn([(3.7, 2.2, 5.0)], [100], radius=1.5)
    assert (three[1:4, 2:5] >= 0).all() and (three >= 0).sum() == 9
    corner = drawn([(-0.4, 7.9, 5.0)], [100], radius=1)  # half outside
    np.testing.assert_array_equal(np.argwhere(corner >= 0), [[7, 0]])


def test_points_in_any_place_fill_squares_of_one_size() -> None:
    places = np.random.default_rng(0).uniform(3, 5, (50, 2))
    for x, y in places:
        assert (drawn([(x, y, 1.0)], [9], radius=2) >= 0).sum() == 16


def test_the_nearest_point_hides_those_behind_it_in_any_order() -> None:
    near, far = (5.5, 4.5, 2.0), (5.5, 4.5, 3.0)
    for points, greys in (([near, far], [10, 200]), ([far, near], [200, 10])):
        assert drawn(points, greys)[4, 5] == pytest.approx(10, abs=0.01)
    behind = [(5.5, 4.5, -1.0)]
    assert (drawn(behind, [10]) == -1).all()


def test_of_one_surface_the_point_nearest_to_the_centre_shows() -> None:
    # Pixels on the ground are 0.1 % of the depth: a step of 3.5 pixels is a slope, one of 40 an edge.
    slope = [(4.6, 4.5, 2.0), (5.6, 4.5, 2.007)]
    assert drawn(slope, [10, 200], radius=1)[4, 4:7].round().tolist() == [10, 200, 200]
    edge = [(4.6, 4.5, 2.0), (5.6, 4.5, 2.08)]
    assert drawn(edge, [10, 200], radius=1)[4, 4:7].round().tolist() == [10, 10, 200]


def test_windows_are_parts_of_the_whole() -> None:
    random = np.random.default_rng(1)
    points = random.uniform([-1, -1, 1], [13, 9, 2], (300, 3))
    greys = random.integers(0, 256, 300).tolist()
    whole = drawn(points.tolist(), greys, 1.3)
    for window in (Rectangle(0, 0, 12, 3), Rectangle(0, 3, 12, 5), Rectangle(4, 2, 5, 4)):
        part = drawn(points.tolist(), greys, 1.3, window)
        np.testing.assert_array_equal(part, whole[window.slices_in(WHOLE)])


def test_shrinking_takes_means_of_what_is_there() -> None:
    places = np.array([[0.5, 0.5, FOCAL], [1.5, 0.5, FOCAL], [0.5, 1.5, FOCAL], [2.5, 0.5, FOCAL]])
    buffer = draw(
        view(),
        lambda: [(places, greys(10, 20, 30, 40))],
        Rectangle(0, 0, 5, 3),
        0.5,
    )
    grey, covered = shrunk_buffer(buffer, 2)
    np.testing.assert_array_equal(covered, [[True, False]])  # three of four, one of four
    np.testing.assert_allclose(grey, [[20, 40]], atol=0.01)
    np.testing.assert_array_equal(
        shrunk(np.arange(15, dtype=np.float32).reshape(3, 5), 2), [[3, 5]]
    )


def greys(*values: int) -> np.ndarray:
    return np.repeat(np.array(values, np.uint8)[:, None], 3, axis=1)


def test_luma_of_colours_and_of_greys() -> None:
    np.testing.assert_allclose(
        luma(np.array([[255, 0, 0], [7, 7, 7]], np.uint8)), [76.245, 7], 1e-6
    )
    np.testing.assert_array_equal(luma(np.array([[9], [300]], np.uint16)), [9, 300])


def texture(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, (30, 40)).astype(np.float32)


def test_ncc_is_1_for_the_same_but_for_gain_and_offset() -> None:
    picture, full = texture(), np.ones((30, 40), bool)
    whole = comparable(picture)
    assert whole.sum() == 22 * 32  # windows inside the picture
    np.testing.assert_allclose(ncc(0.5 * picture + 40, picture, full)[whole], 1, atol=1e-4)
    np.testing.assert_allclose(ncc(255 - picture, picture, full)[whole], -1, atol=1e-4)
    assert np.abs(ncc(texture(1), picture, full)[whole]).mean() < 0.2


def test_ncc_agrees_with_its_definition_where_the_cloud_has_gaps() -> None:
    photograph, cloud = texture(), 0.7 * texture() + 0.3 * texture(2)
    covered = np.random.default_rng(3).uniform(size=photograph.shape) < 0.9
    covered[15, 20] = True
    window = np.s_[11:20, 16:25]
    a, b = cloud[window][covered[window]], photograph[window][covered[window]]
    found = ncc(np.where(covered, cloud, 0), photograph, covered)
    assert found[15, 20] == pytest.approx(np.corrcoef(a, b)[0, 1], abs=1e-5)


def test_nothing_is_alike_without_points_or_texture() -> None:
    picture = texture()
    covered = np.ones(picture.shape, bool)
    covered[:, :20] = False
    found = ncc(picture, picture, covered)
    assert (found[:, :21] == -1).all()  # no point, or too few around
    assert (found[4:-4, 24:] > 0.999)[:, :-4].all()
    flat = np.full_like(picture, 90)
    assert not comparable(flat).any()
    assert (ncc(picture, flat, ~np.zeros_like(covered)) == -1).all()
