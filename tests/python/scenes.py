"""Small scenes for tests, made without files."""

from __future__ import annotations

import numpy as np
from sirpy.native_scene import NativeCamera, NativeScene, Observations


def plane_scene(
    *,
    count: int,
    width: int,
    height: int,
    spacing: float = 20.0,
    points: int = 4000,
    seed: int = 0,
) -> NativeScene:
    """Cameras in a row at a height of 100 that look down at sparse points of the plane z = 0."""
    rng = np.random.default_rng(seed)
    focal = float(max(width, height))
    reach = 50 + spacing * count
    world = np.column_stack([rng.uniform(-reach, reach, (points, 2)), rng.uniform(-2, 2, points)])
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    # x right, y down on the ground, z towards it.
    down = np.diag([1.0, -1.0, -1.0])
    cameras, observations = {}, {}
    for i in range(count):
        centre = np.array([spacing * (i - (count - 1) / 2), 3.0 * (i % 2), 100.0])
        cam_from_world = np.column_stack([down, -down @ centre])
        camera = NativeCamera(f"{i:03}.jpg", width, height, intrinsics, cam_from_world)
        pixel = camera.project(world)
        inside = ((pixel >= 0) & (pixel < [width, height])).all(axis=1)
        index = np.flatnonzero(inside)
        cameras[camera.name] = camera
        observations[camera.name] = Observations(
            index, pixel[index], camera.in_camera(world[index])[:, 2]
        )
    return NativeScene(cameras, world, observations)
