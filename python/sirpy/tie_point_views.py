"""Which tie points are measured, in which photographs, and how their surroundings look from there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap
from numpy.typing import NDArray

from sirpy.model_arrays import Floats, SparseModel

Ints = NDArray[np.int64]

_CELLS = 24  # along the longer side of a photograph; points are spread over these
_POINTS_OF_CELL = 6
_FEWEST = 3  # tie points of a cell that any point may add to, however long its track
_OBLIQUE = np.cos(np.radians(40))  # between the rays of a view that joins and of the reference
_COARSEST = 1.6  # ratio of the pixels on the ground of such a view and the reference
_NEIGHBOURS = 12  # of which the plane around a point is made
_STEP = 6.0  # px, over which the affine map is a difference quotient


@dataclass(frozen=True)
class Views:
    """k views of tie points, sorted by photograph and point: where the model sees each.

    Attributes:
        image, point: (k,) indices of model.images and model.points.
        xy: (k, 2) native pixels.
        is_reference: (k,) of each point one.
        starts: (images + 1,) where those of each photograph begin.
    """

    image: Ints
    point: Ints
    xy: Floats
    is_reference: NDArray[np.bool_]
    starts: Ints

    def of_image(self, index: int) -> slice:
        return slice(int(self.starts[index]), int(self.starts[index + 1]))

    def others(self, references: Ints) -> Ints:
        """The views of the same points that are no references, in the order of the views."""
        wanted = np.zeros(int(self.point.max(initial=-1)) + 1, bool)
        wanted[self.point[references]] = True
        return np.flatnonzero(wanted[self.point] & ~self.is_reference)


def choose_views(model: SparseModel) -> Views:
    """Tie points spread over all photographs, and everything that should see them.

    A point's reference is, of the photographs that observe it, the one in the middle of their directions: the
    others look least different from there.
    """
    chosen = _spread(model)
    reference = _references(model, chosen)
    centres = np.array([-p[:, :3].T @ p[:, 3] for p in _poses(model)])
    rays = model.points[chosen] - centres[reference]
    distances = np.linalg.norm(rays, axis=1)
    rays /= distances[:, None]
    focal = np.array([model.camera_of(image).mean_focal_length() for image in model.images])
    observed = np.zeros(len(model.points), bool)
    images, points, places = [], [], []
    for index, (image, pose) in enumerate(zip(model.images, _poses(model), strict=True)):
        camera = model.camera_of(image)
        seen = model.seen(index)
        observed[:] = False
        observed[model.point[seen]] = True
        own = model.points[chosen] - centres[index]
        own_distances = np.linalg.norm(own, axis=1)
        alike = np.sum(rays * own, axis=1) / own_distances > _OBLIQUE
        ratio = own_distances / focal[index] * focal[reference] / distances
        joins = alike & (ratio < _COARSEST) & (ratio > 1 / _COARSEST)
        candidates = np.flatnonzero(joins | observed[chosen])
        xy = project(camera, pose, model.points[chosen[candidates]])
        inside = np.all((xy >= 0) & (xy < [camera.width, camera.height]), axis=1)  # False of NaN
        images.append(np.full(int(inside.sum()), index))
        points.append(candidates[inside])
        places.append(xy[inside])
    image, local = np.concatenate(images), np.concatenate(points)
    starts = np.concatenate([[0], np.cumsum([len(part) for part in images])])
    return Views(image, chosen[local], np.concatenate(places), image == reference[local], starts)


def project(camera: pycolmap.Camera, cam_from_world: Floats, points: Floats) -> Floats:
    """(n, 2) pixels of world points; NaN behind the camera."""
    in_camera = points @ cam_from_world[:, :3].T + cam_from_world[:, 3]
    in_camera[in_camera[:, 2] <= 0] = np.nan
    return np.asarray(camera.img_from_cam(in_camera), float).reshape(-1, 2)


class LocalPlanes:
    """The surface around tie points of one reference photograph, as planes through them: what other photographs
    see of a window there.

    Attributes:
        local, common: (n, 2), how inverse depth changes with the normalised coordinates of the reference:
            a plane is linear there. Of the neighbours in the photograph, and of all its points.
    """

    def __init__(self, model: SparseModel, reference: int, points: Ints, xy: Floats) -> None:
        """`xy` (n, 2): native pixels where the tie points `points` lie in the reference."""
        self._model = model
        image = model.images[reference]
        camera, pose = model.camera_of(image), image.cam_from_world
        self._world_from_camera = np.column_stack([pose[:, :3].T, -pose[:, :3].T @ pose[:, 3]])
        self._rays = np.stack(
            [
                _normalised(camera, xy + step)
                for step in ([0, 0], [_STEP, 0], [-_STEP, 0], [0, _STEP], [0, -_STEP])
            ]
        )
        own = self._in_camera(pose, model.points[points])
        others = self._in_camera(pose, model.points[np.unique(model.point[model.seen(reference)])])
        others = others[others[:, 2] > 0]
        flat, inverse = others[:, :2] / others[:, 2:], 1 / others[:, 2]
        self.common = np.broadcast_to(_slope(flat, inverse), (len(points), 2))
        at = own[:, :2] / own[:, 2:]
        self.local = np.array(
            [
                _slope_around(place, 1 / depth, flat, inverse, self.common[0])
                for place, depth in zip(at, own[:, 2], strict=True)
            ]
        ).reshape(-1, 2)
        # The tie point may have moved to better texture: along the plane of its surroundings.
        self._at, self._inverse = at, 1 / own[:, 2]

    @staticmethod
    def _in_camera(pose: Floats, points: Floats) -> Floats:
        return points @ pose[:, :3].T + pose[:, 3]

    def seen_from(self, target: int, slopes: Floats, which: Ints) -> tuple[Floats, Floats]:
        """(m, 2) native pixels of photograph `target` and (m, 2, 2) target_from_reference of the tie points
        `which`, for planes of `slopes` (n, 2)."""
        image = self._model.images[target]
        camera, pose = self._model.camera_of(image), image.cam_from_world
        rays = self._rays[:, which]
        offset = rays - self._at[which]
        inverse = self._inverse[which] + np.sum(slopes[which] * offset, axis=2)
        in_camera = np.dstack([rays, np.ones(rays.shape[:2])]) / inverse[..., None]
        world = in_camera.reshape(-1, 3) @ self._world_from_camera[:, :3].T
        world += self._world_from_camera[:, 3]
        centre, right, left, below, above = project(camera, pose, world).reshape(5, -1, 2)
        columns = [(right - left) / (2 * _STEP), (below - above) / (2 * _STEP)]
        return centre, np.ascontiguousarray(np.stack(columns, axis=2))


def _slope(flat: Floats, inverse: Floats) -> Floats:
    """(2,) of the plane that most of the points lie near."""
    slope: Floats = np.zeros(2)
    if len(flat) < 3:
        return slope
    weights: Floats = np.ones(len(flat))
    terms = np.column_stack([flat, np.ones(len(flat))])
    for _ in range(5):
        normal = (terms * weights[:, None]).T @ terms
        solution = np.linalg.lstsq(normal, (terms * weights[:, None]).T @ inverse, rcond=None)[0]
        residual = np.abs(inverse - terms @ solution)
        scale = max(float(np.median(residual)), 1e-12)
        weights = 1 / (1 + (residual / (2 * scale)) ** 2)
        slope = np.asarray(solution[:2])
    return slope


def _slope_around(
    place: Floats, inverse: float, flat: Floats, inverses: Floats, common: Floats
) -> Floats:
    """(2,) of the plane through one point that its nearest neighbours lie near, or most of them."""
    squares = np.sum((flat - place) ** 2, axis=1)
    count = min(_NEIGHBOURS + 1, len(flat))
    near = np.argpartition(squares, count - 1)[:count]
    offsets, heights = flat[near] - place, inverses[near] - inverse
    reach = float(np.mean(squares[near])) + 1e-30
    # As strong as one neighbour: where those tell little, the photograph's plane counts.
    weights = np.ones(count)
    slope = common
    for _ in range(3):
        weighted = offsets * weights[:, None]
        normal = weighted.T @ offsets + reach * np.eye(2)
        slope = common + np.linalg.solve(normal, weighted.T @ (heights - offsets @ common))
        residual = np.abs(heights - offsets @ slope)
        scale = max(float(np.median(residual)), 1e-12)
        weights = 1 / (1 + (residual / (2 * scale)) ** 2)
    return np.asarray(slope)


def _normalised(camera: pycolmap.Camera, xy: Floats) -> Floats:
    return np.asarray(camera.cam_from_img(np.ascontiguousarray(xy)), float).reshape(-1, 2)


def _poses(model: SparseModel) -> list[Floats]:
    return [image.cam_from_world for image in model.images]


def _spread(model: SparseModel) -> Ints:
    """Points of long tracks and small errors first, until the cells of the photographs are full."""
    lengths = np.bincount(model.point, minlength=len(model.points))
    order = np.lexsort((model.point_ids, model.errors, -lengths))
    image = np.repeat(np.arange(len(model.images)), np.diff(model.starts))
    sizes = np.array([[c.width, c.height] for c in map(model.camera_of, model.images)])
    cell_side = sizes.max(axis=1) / _CELLS
    cells = np.clip(model.xy // cell_side[image][:, None], 0, _CELLS).astype(np.int64)
    cell = (image * (_CELLS + 1) + cells[:, 1]) * (_CELLS + 1) + cells[:, 0]
    by_point = np.argsort(model.point, kind="stable")
    starts = np.concatenate([[0], np.cumsum(lengths)])
    filled = np.zeros(len(model.images) * (_CELLS + 1) ** 2, np.int32)
    chosen = []
    for point in order[lengths[order] >= 2].tolist():
        of_point = cell[by_point[starts[point] : starts[point + 1]]]
        if np.any(filled[of_point] < _POINTS_OF_CELL):
            filled[of_point] += 1
            chosen.append(point)
    return np.sort(np.array(chosen, np.int64))


def _references(model: SparseModel, chosen: Ints) -> Ints:
    """(n,) of each chosen point the observing photograph nearest to the mean of their directions."""
    image = np.repeat(np.arange(len(model.images)), np.diff(model.starts))
    centres = np.array([-p[:, :3].T @ p[:, 3] for p in _poses(model)])
    rays = centres[image] - model.points[model.point]
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    mean = np.zeros((len(model.points), 3))
    np.add.at(mean, model.point, rays)
    nearness = np.sum(rays * mean[model.point], axis=1)
    order = np.lexsort((image, -nearness, model.point))
    first = np.unique(model.point[order], return_index=True)
    reference = np.full(len(model.points), -1)
    reference[first[0]] = image[order][first[1]]
    return reference[chosen]
