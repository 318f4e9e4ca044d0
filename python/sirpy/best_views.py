"""Which photograph sees a place on the surface best, and the colour that it has there.

Best is the finest ground sampling of a level surface, among photographs of one height the most nadir one: a smooth
criterion, so that neighbouring places have the same photograph. A photograph does not count where its own depth map
shows something in front of the place. What is chosen for a place does not depend on which others are asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sirpy.depth_maps import DepthMaps
from sirpy.frame import Floats, Frame
from sirpy.native_images import NativeImage
from sirpy.native_scene import NativeCamera, read_native_scene
from sirpy.rectangle import Rectangle
from sirpy.windows import read_mask_window, read_window
from sirpy.workspace import Workspace

_TOLERANCE = 6  # pixels' size at the place: what a depth map may differ by
_AROUND = 2  # pixels: something in front that near may show at the place too
_STEEPEST = 0.2  # least cosine of the angle from the nadir
_FEATHER = 5  # pixels on each side of a seam, over which colours are mixed
_SHARP = 1e-9
# Added to a sampling, so that any view of a better kind goes before.
_NOTHING_NEAR = 0.0
_EDGE_NEAR = 1e6
_UNKNOWN = 2e6  # no depth there: nothing says that something is in front

_LARGEST = float(np.finfo(np.float64).max)

Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class _View:
    """A photograph as it sees places that are given from the origin of the frame's model."""

    native: NativeImage  # with the sub-images that have a depth map
    focal: float  # pixels
    centre: Floats  # (3,)
    pixel_from_place: Floats  # (3, 4), homogeneous; the last is the depth, in the unit of the model
    sides: Floats  # (4, 4) planes through the centre and the sides of the image, positive inside

    def project(self, places: Floats) -> tuple[Floats, Floats, Floats]:
        """(u, v, depth) of places (3, n); u and v mean nothing where the depth is not positive."""
        u, v, depth = (_dot(row, places) for row in self.pixel_from_place)
        with np.errstate(divide="ignore", invalid="ignore"):
            return u / depth, v / depth, depth

    def may_see(self, middle: Floats, radius: float) -> bool:
        """Whether a ball may be in the image."""
        return bool((self.sides[:, :3] @ middle + self.sides[:, 3] >= -radius).all())

    def sampling(self, places: Floats) -> Floats:
        """Size of a pixel along a level surface at places (3, n), in the unit of the frame; infinite where seen
        too steeply."""
        x, y, z = (centre - place for centre, place in zip(self.centre, places, strict=True))
        distance = np.sqrt(x * x + y * y + z * z)
        with np.errstate(divide="ignore", invalid="ignore"):
            sampling = distance**3 / (self.focal * z * z)
        return np.where(z > _STEEPEST * distance, sampling, np.inf)


class BestViews:
    """The photographs of a workspace as they see the frame of its products.

    Attributes:
        left_out: sub-images that show nothing, since they have no depth map, and why.
    """

    def __init__(self, workspace: Workspace, frame: Frame) -> None:
        """Raises InputError where the native model is missing or damaged, or there is no sound depth map."""
        cameras = read_native_scene(workspace).cameras
        self._maps = DepthMaps(workspace)
        self._workspace, self._origin = workspace, frame.translation
        natives = [native for name, native in self._maps.natives.items() if name in cameras]
        self._views = [_make_view(native, cameras[native.name], frame) for native in natives]
        self.left_out = self._maps.left_out
        self._centres = np.array([view.centre for view in self._views]).reshape(-1, 3)

    def colours(self, places: Floats) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.bool_]]:
        """(RGB (n, 3), seen (n,)) of places (n, 3) of the frame that lie near each other.

        Raises:
            InputError: a sub-image is missing or damaged.
        """
        places = np.ascontiguousarray((places - self._origin).T)
        choice = _Choice(places.shape[1])
        for best, number in self._candidates(places):
            if best > choice.key[1].max():
                break
            view = self._views[number]
            sampling = view.sampling(places)
            asked = np.flatnonzero(sampling <= np.minimum(choice.key[1], _LARGEST))
            if len(asked) > 0:
                kind = _kinds(self._workspace, self._maps, view, places[:, asked])
                choice.offer(asked, sampling[asked] + kind, number)
        return self._mixed(places, choice)

    def _candidates(self, places: Floats) -> list[tuple[float, int]]:
        """(best sampling, number) of the photographs that may see some of the places, in that order."""
        low, high = places.min(axis=1), places.max(axis=1)
        middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
        near = [n for n, view in enumerate(self._views) if view.may_see(middle, radius)]
        found = [(float(self._views[number].sampling(places).min()), number) for number in near]
        return sorted((best, number) for best, number in found if best < np.inf)

    def _mixed(
        self, places: Floats, choice: _Choice
    ) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.bool_]]:
        """The colours of the best views, those of the second mixed in where both are nearly as good: no sharp
        seam."""
        (first, second), (best, next_best) = choice.view, choice.key
        weight = np.ones(places.shape[1])
        mixed = np.flatnonzero(next_best < _EDGE_NEAR)
        if len(mixed) > 0:
            one, other = self._centres[first[mixed]].T, self._centres[second[mixed]].T
            # How fast two samplings of one height part, across the line where they are equal.
            slope = 3 * np.hypot(*(one - other)[:2]) / (one[2] - places[2, mixed]) ** 2
            fade = np.maximum(_FEATHER * best[mixed] * slope, _SHARP)
            weight[mixed] = 0.5 + 0.5 * np.minimum((next_best[mixed] / best[mixed] - 1) / fade, 1)
        colours = np.zeros((places.shape[1], 3))
        for number, view in enumerate(self._views):
            for chosen, share in ((first, weight), (second, 1 - weight)):
                wanted = np.flatnonzero((chosen == number) & (share > 0))
                if len(wanted) > 0:
                    colour = _sampled(self._workspace, view, places[:, wanted])
                    colours[wanted] += share[wanted, None] * colour
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


def _make_view(native: NativeImage, camera: NativeCamera, frame: Frame) -> _View:
    rotation = camera.cam_from_world[:, :3] @ frame.rotation.T / frame.scale
    cam_from_place = np.column_stack([rotation, camera.cam_from_world[:, 3]])
    corners = np.array(
        [[0, 0], [camera.width, 0], [camera.width, camera.height], [0, camera.height]]
    )
    rays = np.column_stack([corners, np.ones(4)]) @ np.linalg.inv(camera.intrinsics).T
    inward = np.cross(rays, np.roll(rays, -1, axis=0))
    inward *= frame.scale / np.linalg.norm(inward, axis=1, keepdims=True)
    return _View(
        native,
        float(camera.intrinsics[0, 0]),
        frame.world(camera.centre[None])[0] - frame.translation,
        camera.intrinsics @ cam_from_place,
        inward @ cam_from_place,
    )


def _dot(row: Floats, places: Floats) -> Floats:
    """Not by matrices: their sums depend on how many places there are."""
    dot: Floats = row[0] * places[0] + row[1] * places[1] + row[2] * places[2] + row[3]
    return dot


def _kinds(workspace: Workspace, maps: DepthMaps, view: _View, places: Floats) -> Floats:
    """How places (3, n) are seen: one of the three kinds, or infinite where they are not."""
    kinds = np.full(places.shape[1], np.inf)
    u, v, depth = view.project(places)
    right, bottom = view.native.width - 1, view.native.height - 1
    seen = np.flatnonzero((depth > 0) & (u >= 1) & (u < right) & (v >= 1) & (v < bottom))
    if len(seen) == 0:
        return kinds
    column, row, depth = u[seen].astype(np.int64), v[seen].astype(np.int64), depth[seen]
    window = _window(column, row, _AROUND, view.native)
    column, row = column - window.x0, row - window.y0
    stored = maps.depth(view.native.name, window)
    stored = np.where(stored > 0, stored, np.float32(np.inf))
    at, around = stored[row, column], _least_around(stored)[row, column]
    nearest = depth - _TOLERANCE * depth / view.focal
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
    """Where a window is of a sub-image that has a depth map, and not masked out."""
    usable = np.zeros((window.height, window.width), bool)
    for sub_image in native.sub_images:
        part = sub_image.stored.intersection(window)
        if part.area > 0:
            usable[part.slices_in(window)] = True
    return usable & ~read_mask_window(workspace, native.name, window)


def _sampled(workspace: Workspace, view: _View, places: Floats) -> Floats:
    """RGB (n, 3) at places (3, n) that are seen, bilinear."""
    u, v, _ = view.project(places)
    column, row = np.floor(u - 0.5).astype(np.int64), np.floor(v - 0.5).astype(np.int64)
    right, down = (u - 0.5 - column)[:, None], (v - 0.5 - row)[:, None]
    window = _window(column, row, 1, view.native)
    photograph = read_window(workspace, view.native.name, window, "color")
    column, row = column - window.x0, row - window.y0
    above = (1 - right) * photograph[row, column] + right * photograph[row, column + 1]
    below = (1 - right) * photograph[row + 1, column] + right * photograph[row + 1, column + 1]
    colours: Floats = (1 - down) * above + down * below
    return colours


def _window(column: Indices, row: Indices, margin: int, native: NativeImage) -> Rectangle:
    """The pixels around some, as far as they are in the image."""
    around = Rectangle.from_corners(
        int(column.min()), int(row.min()), int(column.max()) + 1, int(row.max()) + 1
    )
    return around.padded(margin).intersection(native.rectangle)
