"""What is said of depths that were found elsewhere, on surfaces that are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from sirpy.judging import normals
from sirpy.rectangle import Rectangle

INTRINSICS = np.array([[300.0, 0, 80.3], [0, 290, 61.7], [0, 0, 1]])
WINDOW = Rectangle(20, 10, 90, 70)


def rays(window: Rectangle) -> NDArray[np.float64]:
    """(3, height, width), z = 1."""
    x = (np.arange(window.x0, window.x1) + 0.5 - INTRINSICS[0, 2]) / INTRINSICS[0, 0]
    y = (np.arange(window.y0, window.y1) + 0.5 - INTRINSICS[1, 2]) / INTRINSICS[1, 1]
    return np.stack([*np.meshgrid(x, y), np.ones((window.height, window.width))])


def plane_depth(
    normal: NDArray[np.float64], distance: float, window: Rectangle
) -> NDArray[np.float32]:
    """Of the plane normal . X = -distance."""
    return (-distance / np.einsum("i,iyx->yx", normal, rays(window))).astype(np.float32)


@pytest.mark.parametrize("direction", [(0, 0, -1), (0.5, -0.3, -1), (-1.5, 1, -1)])
@pytest.mark.parametrize("distance", [10, 1e-3, 1e5])
def test_normals_of_a_plane(direction: tuple[float, float, float], distance: float) -> None:
    normal = np.array(direction) / np.linalg.norm(direction)
    found = normals(plane_depth(normal, distance, WINDOW), INTRINSICS, WINDOW)
    assert np.degrees(np.arccos(np.clip(np.einsum("i,iyx->yx", normal, found), -1, 1))).max() < 0.3
    np.testing.assert_allclose(np.linalg.norm(found, axis=0), 1, atol=1e-5)


def test_at_an_edge_each_side_has_its_own_plane() -> None:
    left, right = (np.array(one) / np.linalg.norm(one) for one in ((0.4, 0.1, -1), (-0.6, 0.2, -1)))
    near, far = plane_depth(left, 10, WINDOW), plane_depth(right, 14, WINDOW)
    is_left = np.arange(WINDOW.width) < 41
    found = normals(np.where(is_left, near, far), INTRINSICS, WINDOW)
    expected = np.where(is_left, left[:, None, None], right[:, None, None])
    angle = np.degrees(np.arccos(np.clip((found * expected).sum(axis=0), -1, 1)))
    assert angle.max() < 0.5


def test_pixels_without_a_depth_have_no_normal_and_spoil_none() -> None:
    normal = np.array([0.4, 0.1, -1]) / np.linalg.norm([0.4, 0.1, -1])
    depth = plane_depth(normal, 10, WINDOW)
    depth[30:34, 40:60] = 0
    found = normals(depth, INTRINSICS, WINDOW)
    assert not found[:, depth == 0].any()
    np.testing.assert_allclose(np.einsum("i,iyx->yx", normal, found)[depth > 0], 1, atol=1e-4)


def test_normals_do_not_depend_on_the_bands() -> None:
    generator = np.random.default_rng(1)
    depth = generator.uniform(9, 11, (700, 400)).astype(np.float32)
    window = Rectangle(0, 0, 400, 700)  # more than one band
    whole = normals(depth, INTRINSICS, window)
    part = Rectangle(0, 300, 400, 90)
    around = normals(depth[part.slices_in(window)], INTRINSICS, part)
    inside = slice(4, -4)
    np.testing.assert_allclose(around[:, inside, inside], whole[:, 304:386, inside], atol=1e-5)
