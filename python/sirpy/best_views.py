"""Which photograph sees a place on the surface best, and the colour that it has there.

Best is the finest ground sampling of a level surface, among photographs of one height the most nadir one: a smooth
criterion, so that neighbouring places have the same photograph. A photograph does not count where its own depth map
shows something in front of the place. What is chosen for a place does not depend on which others are asked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sirpy.frame import Floats, Frame
from sirpy.native_images import NativeImage
from sirpy.native_scene import NativeCamera, read_native_scene
from sirpy.rectangle import Rectangle
from sirpy.windows import read_map_window, read_mask_window, read_window
from sirpy.workspace import Workspace

_TOLERANCE = 6  # pixels' size at the place: what a depth map may differ by
_AROUND = 2  # pixels: something in front that near may show at the place too
_STEEPEST = 0.2  # least cosine of the angle from the nadir
_FEATHER = 0.002  # relative difference of two samplings, up to which their colours are mixed
# Added to a sampling, so that any view of a better kind goes before.
_NOTHING_NEAR = 0.0
_EDGE_NEAR = 1e6
_UNKNOWN = 2e6  # no depth there: nothing says that something is in front

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class _View:
    native: NativeImage
    camera: NativeCamera
    centre: Floats  # (3,) in the frame of the products
    sides: Floats  # (4, 3) inward normals of the frustum's sides, camera frame

    @property
    def focal(self) -> float:
        return float(self.camera.intrinsics[0, 0])


class BestViews:
    """The photographs of a workspace as they see the frame of its products."""

    def __init__(self, workspace: Workspace, frame: Frame) -> None:
        """Raises InputError where the native model is missing or damaged."""
        cameras = read_native_scene(workspace).cameras
        self._workspace, self._frame = workspace, frame
        self._views = [
            _View(
                native,
                camera := cameras[native.name],
                frame.world(camera.centre[None])[0],
                _sides(camera),
            )
            for native in workspace.natives
            if native.name in cameras
        ]

    def colours(self, places: Floats) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.bool_]]:
        """(RGB (n, 3), seen (n,)) of places (n, 3) of the frame that lie near each other.

        Raises:
            InputError: a depth map or a sub-image is missing or damaged.
        """
        model = self._frame.model(places)
        choice = _Choice(len(places))
        for number, sampling in self._candidates(places, model):
            asked = np.flatnonzero((sampling <= choice.key[1]) & (sampling < np.inf))
            if len(asked) > 0:
                kind = _kinds(self._workspace, self._views[number], model[asked])
                choice.offer(asked, sampling[asked] + kind, number)
        return self._mixed(model, choice)

    def _candidates(self, places: Floats, model: Floats) -> Iterator[tuple[int, Floats]]:
        """Photographs that may see some of the places, the best first: (number, sampling (n,)), infinite where
        seen too steeply."""
        middle = (model.min(axis=0) + model.max(axis=0)) / 2
        radius = np.sqrt(((model - middle) ** 2).sum(axis=1).max())
        near = []
        for number, view in enumerate(self._views):
            in_camera = view.camera.in_camera(middle[None])[0]
            if (view.sides @ in_camera >= -radius).all():
                near.append((float(_sampling(view, places).min()), number))
        for best, number in sorted(near):
            if best < np.inf:
                yield number, _sampling(self._views[number], places)

    def _mixed(
        self, model: Floats, choice: _Choice
    ) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.bool_]]:
        """The colours of the best views, those of the second mixed in where both are nearly as good: no sharp
        seam."""
        (first, second), (best, next_best) = choice.view, choice.key
        with np.errstate(invalid="ignore"):
            apart = np.minimum((next_best - best) / (_FEATHER * best), 1)
        weight = np.where(next_best < _EDGE_NEAR, 0.5 + 0.5 * apart, 1.0)
        colours = np.zeros((len(model), 3))
        for number, view in enumerate(self._views):
            for chosen, share in ((first, weight), (second, 1 - weight)):
                wanted = np.flatnonzero((chosen == number) & (share > 0))
                if len(wanted) > 0:
                    pixels = view.camera.project(model[wanted])
                    colours[wanted] += share[wanted, None] * _sampled(self._workspace, view, pixels)
        return (colours + 0.5).astype(np.uint8), np.isfinite(best)


class _Choice:
    """The two best views of each place.

    Attributes:
        key: (2, n) sampling and kind; infinite where there is none. Of equal ones the lower number is better.
        view: (2, n) number of the view, -1 where there is none.
    """

    def __init__(self, count: int) -> None:
        self.key = np.full((2, count), np.inf)
        self.view = np.full((2, count), -1)

    def offer(self, places: Indices, key: Floats, number: int) -> None:
        for rank in (1, 0):
            known, view = self.key[rank, places], self.view[rank, places]
            better = (key < known) | ((key == known) & (key < np.inf) & (number < view))
            better_places = places[better]
            if rank == 0:
                self.key[1, better_places] = known[better]
                self.view[1, better_places] = view[better]
            self.key[rank, better_places] = key[better]
            self.view[rank, better_places] = number


def _sides(camera: NativeCamera) -> Floats:
    """Inward unit normals (4, 3) of the planes through the camera and the sides of its image."""
    corners = np.array(
        [[0, 0], [camera.width, 0], [camera.width, camera.height], [0, camera.height]]
    )
    rays = np.column_stack([corners, np.ones(4)]) @ np.linalg.inv(camera.intrinsics).T
    normals = np.cross(rays, np.roll(rays, -1, axis=0))
    sides: Floats = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return sides


def _sampling(view: _View, places: Floats) -> Floats:
    """Size of a pixel along a level surface, in the unit of the frame."""
    towards = view.centre - places
    distance = np.sqrt((towards**2).sum(axis=1))
    cosine = towards[:, 2] / distance
    steep = ~(cosine > _STEEPEST)
    cosine[steep] = 1
    sampling: Floats = distance / (view.focal * cosine**2)
    sampling[steep] = np.inf
    return sampling


def _kinds(workspace: Workspace, view: _View, model: Floats) -> Floats:
    """How places (n, 3) of the model are seen: one of the three kinds, or infinite where they are not."""
    kinds = np.full(len(model), np.inf)
    in_camera = view.camera.in_camera(model)
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = in_camera @ view.camera.intrinsics.T
        pixels = pixels[:, :2] / pixels[:, 2:]
    size = [view.camera.width, view.camera.height]
    inside = (in_camera[:, 2] > 0) & ((pixels >= 1) & (pixels < np.array(size) - 1)).all(axis=1)
    seen = np.flatnonzero(inside)
    if len(seen) == 0:
        return kinds
    pixel, depth = pixels[seen].astype(np.int64), in_camera[seen, 2]
    window = _window(pixel, _AROUND, view.native)
    stored = read_map_window(workspace, view.native, window, "depth")
    stored = np.where(stored > 0, stored, np.float32(np.inf))
    column, row = (pixel - [window.x0, window.y0]).T
    nearest = depth - _TOLERANCE * depth / view.focal
    at, around = stored[row, column], _least_around(stored)[row, column]
    kind = np.where(around == np.inf, _UNKNOWN, _NOTHING_NEAR)
    in_front = around < nearest
    kind[in_front] = np.where((at >= nearest) & (at < np.inf), _EDGE_NEAR, np.inf)[in_front]
    kind[~_usable(workspace, view.native, window)[row, column]] = np.inf
    kinds[seen] = kind
    return kinds


def _least_around(depths: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """The least of the squares of 2 * _AROUND + 1 pixels around each."""
    for axis in (0, 1):
        least = depths.copy()
        for shift in range(1, _AROUND + 1):
            one, other = (slice(shift, None), slice(None, -shift))
            for to, of in ((one, other), (other, one)):
                place = tuple(to if a == axis else slice(None) for a in (0, 1))
                source = tuple(of if a == axis else slice(None) for a in (0, 1))
                least[place] = np.minimum(least[place], depths[source])
        depths = least
    return depths


def _usable(workspace: Workspace, native: NativeImage, window: Rectangle) -> npt.NDArray[np.bool_]:
    """Where a window is stored, and not masked out."""
    usable = np.zeros((window.height, window.width), bool)
    for sub_image in native.sub_images:
        part = sub_image.stored.intersection(window)
        if part.area > 0:
            usable[part.slices_in(window)] = True
    return usable & ~read_mask_window(workspace, native.name, window)


def _sampled(workspace: Workspace, view: _View, pixels: Floats) -> Floats:
    """RGB (n, 3) at pixels (n, 2), bilinear."""
    corner = np.floor(pixels - 0.5).astype(np.int64)
    fraction = pixels - 0.5 - corner
    window = _window(corner, 1, view.native)
    photograph = read_window(workspace, view.native.name, window, "color")
    column, row = (corner - [window.x0, window.y0]).T
    u, v = fraction[:, 0, None], fraction[:, 1, None]
    above = (1 - u) * photograph[row, column] + u * photograph[row, column + 1]
    below = (1 - u) * photograph[row + 1, column] + u * photograph[row + 1, column + 1]
    colours: Floats = (1 - v) * above + v * below
    return colours


def _window(pixels: npt.NDArray[np.int64], margin: int, native: NativeImage) -> Rectangle:
    """The pixels around some, as far as they are in the image."""
    (x0, y0), (x1, y1) = pixels.min(axis=0), pixels.max(axis=0) + 1
    around = Rectangle.from_corners(int(x0), int(y0), int(x1), int(y1)).padded(margin)
    return around.intersection(native.rectangle)
