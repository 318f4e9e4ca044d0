"""What other photographs see of the ground of one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from sirpy.common_ground import CommonGround, Observer, common_ground
from sirpy.errors import InputError
from sirpy.posed_camera import PosedCamera
from sirpy.rectangle import Rectangle

LENS = pycolmap.Camera(
    camera_id=1, model="PINHOLE", width=320, height=160, params=[100, 100, 160, 80]
)


def at(x: float, name: str = "other.jpg") -> PosedCamera:
    """Looks along z from (x, 0, 0); at depth 10, 10 pixels are a unit."""
    pose = np.eye(4)[:3]
    pose[0, 3] = -x
    return PosedCamera(name, LENS, pose)


def slanted(x: np.ndarray) -> np.ndarray:
    """Depths of the plane z = 10 + x / 4."""
    return 10 + x / 4


GROUND = np.array([[x, y, 10.0] for x in (-9, -3, 3, 9) for y in (-5, 0, 5)])


def test_enough_others_must_see_the_ground() -> None:
    view = at(0, "held.jpg")
    # The frames end at -16 and 16 units, at 16 left of the one and right of the other.
    observers = [Observer(at(8)), Observer(at(-8)), Observer(replace(at(0), name="held.jpg"))]
    one = common_ground(view, GROUND, observers, 1)
    assert one.cells.shape == (10, 20) and one.cells.all()
    two = common_ground(view, GROUND, observers, 2)
    assert two.cells[:, 5:15].all() and two.cells.sum() == 100
    assert not common_ground(view, GROUND, observers, 3).cells.any()


def test_only_the_parts_that_were_reconstructed_count() -> None:
    parts = (Rectangle(0, 0, 160, 80), Rectangle(160, 80, 80, 80))
    found = common_ground(at(0, "held.jpg"), GROUND, [Observer(at(0), parts)], 1).cells
    expected = np.zeros((10, 20), bool)
    expected[:5, :10] = expected[5:, 10:15] = True
    np.testing.assert_array_equal(found, expected)


def test_the_ground_may_slope() -> None:
    points = GROUND.copy()
    points[:, 2] = slanted(points[:, 0])
    seen = common_ground(at(0, "held.jpg"), points, [Observer(at(4))], 1).cells
    # Pixel u sees x = z (u - 160) / 100 at z = 10 / (1 - (u - 160) / 400), and the other one u - 400 / z.
    u = np.arange(8, 320, 16)
    expected = u - 40 * (1 - (u - 160) / 400) >= 0
    np.testing.assert_array_equal(seen, np.broadcast_to(expected, (10, 20)))


def test_windows_of_shrunk_photographs() -> None:
    cells = np.zeros((10, 20), bool)
    cells[2:4, 5] = True
    ground = CommonGround(cells, 320, 160)
    window = ground.window(2, 4)
    assert window == Rectangle(36, 12, 16, 24)
    inside = ground.at(window, 2)
    assert inside[4:20, 4:12].all() and inside.sum() == 16 * 8
    assert ground.window(1, 100) == Rectangle(0, 0, 196, 160)
    assert CommonGround(np.zeros((10, 20), bool), 320, 160).window(2, 4).area == 0


def test_a_photograph_without_points_has_no_ground() -> None:
    with pytest.raises(InputError, match=r"held\.jpg sees 2 sparse points .* another photograph"):
        common_ground(at(0, "held.jpg"), GROUND[:2], [], 1)
