"""The level that carries the signal: where a level's pixels say nothing, the answer of the coarser one stays.

A depth is supported when the sources agree with it. What a level found without support is replaced by what the next
coarser level found with it, if it did; so a pixel ends with the answer of the finest level that has one, and with the
standard deviation of that level.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sirpy.filtering import FilterOptions
from sirpy.native_scene import Floats, NativeCamera
from sirpy.rectangle import Rectangle
from sirpy.stereo_backend import DepthMap, FloatMap
from sirpy.stereo_passes import PassMaps, seeing_and_consistent

Counts = npt.NDArray[np.integer]


def is_supported(
    num_consistent: Counts, num_seeing: Counts, cost: FloatMap, options: FilterOptions
) -> npt.NDArray[np.bool_]:
    """Whether enough sources agree (all where fewer see the place, and one at least), more where it looks different
    in them."""
    needed = np.maximum(np.minimum(num_seeing, options.min_consistent), 1)
    alike = (cost <= options.max_cost) | (num_consistent >= options.costly_consistent)
    supported: npt.NDArray[np.bool_] = (num_consistent >= needed) & alike
    return supported


def settle(
    found: DepthMap,
    camera: NativeCamera,
    window: Rectangle,
    level: int,
    coarser: PassMaps,
    options: FilterOptions,
) -> None:
    """Puts the supported planes of the next coarser level in place of what a level found without support.

    A depth that was held, since the level's pixels say less than the coarser ones, has their cost and texture: its
    own would tell of noise.

    Args:
        found: of a geometric pass; changed.
        camera: of the reference.
        window: of `found`, pixels of the level.
        coarser: what the last pass of level + 1 has written.
        options: what makes a depth supported.
    """
    assert found.num_consistent is not None and found.num_seeing is not None
    start = coarser.start_rectangle(camera.name, window, level)
    if not start.area:
        return
    rows = np.clip(np.arange(window.y0, window.y1) // 2 - start.y0, 0, start.height - 1)
    columns = np.clip(np.arange(window.x0, window.x1) // 2 - start.x0, 0, start.width - 1)
    nearest = np.ix_(rows, columns)
    seeing, consistent = seeing_and_consistent(coarser.read(camera.name, start, "counts"))
    depth = coarser.read(camera.name, start, "depth")
    cost = coarser.read(camera.name, start, "cost")
    texture = coarser.read(camera.name, start, "texture")
    known = (is_supported(consistent, seeing, cost, options) & (depth > 0))[nearest]
    assert found.cost is not None and found.texture is not None and found.level is not None
    held = (found.depth > 0) & (found.level > level) & (depth > 0)[nearest]
    found.cost[held] = cost[nearest][held]
    found.texture[held] = texture[nearest][held]
    own = is_supported(found.num_consistent, found.num_seeing, found.cost, options)
    taken = known & ~(own & (found.depth > 0))
    if not taken.any():
        return
    normal = coarser.read(camera.name, start, "normal")
    on_plane, facing = _on_planes(camera, window, level, start, depth, normal, (rows, columns))
    taken &= facing
    if found.motion is not None:  # goes with the square of the depth
        ratio = on_plane[taken] / np.where(found.depth > 0, found.depth, on_plane)[taken]
        found.motion[taken] *= ratio * ratio
    found.depth[taken] = on_plane[taken]
    assert found.normal is not None
    for axis in range(3):
        found.normal[axis][taken] = normal[axis][nearest][taken]
    found.num_seeing[taken] = seeing[nearest][taken]
    found.num_consistent[taken] = consistent[nearest][taken]
    found.cost[taken] = cost[nearest][taken]
    found.texture[taken] = texture[nearest][taken]
    for name in ("views", "sigma", "level"):
        plane = getattr(found, name)
        plane[taken] = coarser.read(camera.name, start, name)[nearest][taken]


def _on_planes(
    camera: NativeCamera,
    window: Rectangle,
    level: int,
    start: Rectangle,
    depth: FloatMap,
    normal: FloatMap,
    places: tuple[npt.NDArray[np.integer], npt.NDArray[np.integer]],
) -> tuple[FloatMap, npt.NDArray[np.bool_]]:
    """Depths of the pixels of a window on the planes of the next coarser level, and where they are sound."""
    nearest = np.ix_(*places)
    rays = _rays(camera, level, window)
    coarse_rays = _rays(camera, level + 1, start)
    along = np.zeros((window.height, window.width))
    own = np.zeros_like(along)
    for axis in range(3):
        plane = normal[axis][nearest]
        along += plane * rays[axis]
        own += plane * np.broadcast_to(coarse_rays[axis], depth.shape)[nearest]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = own / along
        found = (depth[nearest] * ratio).astype(np.float32)
    return found, (ratio > 0.5) & (ratio < 2)


def _rays(camera: NativeCamera, level: int, window: Rectangle) -> tuple[Floats, Floats, float]:
    """x (1, width), y (height, 1) and z of the rays of the pixels of a window of a level."""
    step = 1 << level
    x = (np.arange(window.x0, window.x1) + 0.5) * step - camera.intrinsics[0, 2]
    y = (np.arange(window.y0, window.y1) + 0.5) * step - camera.intrinsics[1, 2]
    return x[None] / camera.intrinsics[0, 0], y[:, None] / camera.intrinsics[1, 1], 1.0
