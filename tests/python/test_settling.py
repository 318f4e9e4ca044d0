"""Which level's answer stays, on planes that are known."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from sirpy.filtering import FilterOptions
from sirpy.native_scene import NativeCamera
from sirpy.rectangle import Rectangle
from sirpy.settling import is_supported, settle
from sirpy.stereo_backend import DepthMap
from sirpy.stereo_passes import at_level

LEVEL = 1
OPTIONS = FilterOptions()
CAMERA = NativeCamera(
    "a.png",
    82,
    50,
    np.array([[90.0, 0, 41], [0, 90, 25], [0, 0, 1]]),
    np.eye(3, 4),
)
IMAGE = Rectangle(0, 0, CAMERA.width, CAMERA.height)
NORMAL = np.array([0.4, -0.3, -1.0]) / np.linalg.norm([0.4, -0.3, -1.0])


def plane(window: Rectangle, level: int, distance: float = 10.0) -> DepthMap:
    """A slanted plane, three of whose four sources agree."""
    step = 1 << level
    y, x = np.indices((window.height, window.width)) + 0.5
    pixel = np.stack([(x + window.x0) * step, (y + window.y0) * step, np.ones_like(x)])
    rays = np.tensordot(np.linalg.inv(CAMERA.intrinsics), pixel, 1)
    shape = window.height, window.width
    return DepthMap(
        depth=(-distance / np.tensordot(NORMAL, rays, 1)).astype(np.float32),
        normal=np.broadcast_to(NORMAL[:, None, None], (3, *shape)).astype(np.float32),
        views=np.full(shape, 7, np.uint32),
        cost=np.full(shape, 0.1, np.float32),
        texture=np.full(shape, 90, np.float32),
        num_seeing=np.full(shape, 4, np.uint8),
        num_consistent=np.full(shape, 3, np.uint8),
        sigma=np.full(shape, 0.05 * step, np.float32),
        motion=np.full(shape, 0.1 * step, np.float32),
        level=np.full(shape, level, np.uint8),
    )


def part_of(found: DepthMap, rows: slice, columns: slice) -> DepthMap:
    return DepthMap(
        **{one.name: getattr(found, one.name)[..., rows, columns].copy() for one in fields(found)}
    )


class Coarser:
    """The maps of the next coarser level, as PassMaps gives them."""

    def __init__(self, found: DepthMap) -> None:
        self.found = found

    def start_rectangle(self, native: str, rectangle: Rectangle, level: int) -> Rectangle:
        x0, y0 = rectangle.x0 // 2, rectangle.y0 // 2
        x1, y1 = (rectangle.x1 + 1) // 2, (rectangle.y1 + 1) // 2
        image = at_level(IMAGE, LEVEL + 1)
        return Rectangle.from_corners(x0, y0, x1, y1).padded(1).intersection(image)

    def read(self, native: str, rectangle: Rectangle, kind: str) -> np.ndarray:
        rows, columns = rectangle.slices_in(at_level(IMAGE, LEVEL + 1))
        if kind == "counts":
            agreeing = self.found.num_consistent.astype(np.uint32)
            return (self.found.num_seeing + (agreeing << np.uint32(8)))[rows, columns]
        return getattr(self.found, kind)[..., rows, columns]


def coarse() -> DepthMap:
    return plane(at_level(IMAGE, LEVEL + 1), LEVEL + 1)


def fine() -> DepthMap:
    """Wrong and without support in its left half, another plane with support in its right half."""
    window = at_level(IMAGE, LEVEL)
    found = plane(window, LEVEL, distance=11)
    found.depth[:, :20] *= 1.3
    found.num_consistent[:, :20] = 1
    return found


def test_enough_is_what_can_be_had() -> None:
    agreeing, seeing = np.array([0, 1, 1, 2, 2, 3, 0]), np.array([0, 1, 2, 2, 9, 9, 5])
    alike = np.full(7, 0.1, np.float32)
    np.testing.assert_array_equal(
        is_supported(agreeing, seeing, alike, OPTIONS),
        [False, True, False, True, True, True, False],
    )
    none = FilterOptions(min_consistent=0)
    assert not is_supported(np.array(0), np.array(3), np.float32(0.1), none)  # one at least


def test_what_looks_different_needs_more_sources() -> None:
    agreeing, seeing = np.array([2, 4, 5]), np.array([9, 9, 9])
    different = np.full(3, 0.9, np.float32)
    np.testing.assert_array_equal(
        is_supported(agreeing, seeing, different, OPTIONS), [False, False, True]
    )


def test_what_is_held_has_the_cost_of_its_level() -> None:
    window, found = at_level(IMAGE, LEVEL), plane(at_level(IMAGE, LEVEL), LEVEL)
    found.level[:, 20:] = LEVEL + 1  # the level's own pixels are noise there
    found.cost[:] = 0.9
    found.num_consistent[:] = 5
    settle(found, CAMERA, window, LEVEL, Coarser(coarse()), OPTIONS)  # type: ignore[arg-type]
    np.testing.assert_array_equal(found.cost[:, :20], np.float32(0.9))
    np.testing.assert_array_equal(found.cost[:, 20:], np.float32(0.1))


def test_what_has_no_support_takes_the_plane_of_the_coarser_level() -> None:
    window, found = at_level(IMAGE, LEVEL), fine()
    before = fine()
    settle(found, CAMERA, window, LEVEL, Coarser(coarse()), OPTIONS)  # type: ignore[arg-type]
    left, right = np.s_[..., :20], np.s_[..., 20:]
    expected = plane(window, LEVEL)
    # On the plane, not in its steps.
    np.testing.assert_allclose(found.depth[left], expected.depth[left], rtol=1e-5)
    np.testing.assert_allclose(found.normal[left], expected.normal[left], rtol=1e-6)
    for name in ("sigma", "level", "num_consistent", "num_seeing", "cost", "texture", "views"):
        taken, kept = getattr(found, name), getattr(before, name)
        assert (taken[left] == getattr(coarse(), name)[0, 0]).all(), name
        assert taken.dtype == kept.dtype
        np.testing.assert_array_equal(taken[right], kept[right])
    np.testing.assert_array_equal(found.depth[right], before.depth[right])
    # A pixel of motion is what it is at the depth that is taken.
    ratio = found.depth[left] / before.depth[left]
    np.testing.assert_allclose(found.motion[left], before.motion[left] * ratio**2, rtol=1e-5)


def test_what_no_level_supports_stays() -> None:
    window, found, before = at_level(IMAGE, LEVEL), fine(), fine()
    unsupported = coarse()
    unsupported.num_consistent[:] = 1
    settle(found, CAMERA, window, LEVEL, Coarser(unsupported), OPTIONS)  # type: ignore[arg-type]
    for one in fields(found):
        np.testing.assert_array_equal(getattr(found, one.name), getattr(before, one.name))


@pytest.mark.filterwarnings("error")
def test_planes_edge_on_and_holes_are_not_taken() -> None:
    window, found, before = at_level(IMAGE, LEVEL), fine(), fine()
    damaged = coarse()
    damaged.depth[:, :5] = 0
    damaged.normal[:, :, 5:] = 0
    damaged.normal[0, :, 6:] = 1  # along the view: the plane is met anywhere
    settle(found, CAMERA, window, LEVEL, Coarser(damaged), OPTIONS)  # type: ignore[arg-type]
    assert np.isfinite(found.depth).all()
    np.testing.assert_array_equal(found.depth[:, :12], before.depth[:, :12])
    changed = found.depth != before.depth
    assert ((found.depth / before.depth)[changed] < 2).all()


@pytest.mark.parametrize(
    "window",
    [
        Rectangle(3, 4, 11, 9),
        Rectangle(40, 24, 1, 1),
        Rectangle(0, 0, 2, 25),
        Rectangle(8, 1, 33, 3),
    ],
)
def test_the_window_has_no_part_in_it(window: Rectangle) -> None:
    image, whole = at_level(IMAGE, LEVEL), fine()
    rows, columns = window.slices_in(image)
    part = part_of(fine(), rows, columns)
    coarser = Coarser(coarse())
    settle(whole, CAMERA, image, LEVEL, coarser, OPTIONS)  # type: ignore[arg-type]
    settle(part, CAMERA, window, LEVEL, coarser, OPTIONS)  # type: ignore[arg-type]
    for one in fields(part):
        np.testing.assert_array_equal(
            getattr(part, one.name), getattr(whole, one.name)[..., rows, columns]
        )
