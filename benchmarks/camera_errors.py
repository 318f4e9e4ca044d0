"""Errors of the cameras of a model beside exact ones.

World points are (n, 3) in the frame of their model, pixels (n, 2) native ones, the centre of the top-left pixel at
(0.5, 0.5). The two frames differ by a similarity that nobody knows, so errors depend on how it is chosen.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray
from sirpy.model_arrays import PosedImage, SparseModel

Floats = NDArray[np.float64]

_ROUNDS = 6  # of Gauss-Newton in a triangulation: far more than it needs from where it starts
_ON_A_LINE = 1e-9  # spread across to along, squared
_STEP = 1e-5  # of the depth, in the differences that stand for derivatives


@dataclass(frozen=True, eq=False)
class Camera:
    """A lens and where it was; `cam_from_world` is (3, 4)."""

    lens: pycolmap.Camera
    cam_from_world: Floats

    @classmethod
    def of(cls, model: SparseModel, image: PosedImage) -> Camera:
        return cls(model.camera_of(image), image.cam_from_world)

    @property
    def rotation(self) -> Floats:
        return self.cam_from_world[:, :3]

    @property
    def centre(self) -> Floats:
        return -self.rotation.T @ self.cam_from_world[:, 3]

    def in_camera(self, world: Floats) -> Floats:
        return world @ self.rotation.T + self.cam_from_world[:, 3]

    def project(self, world: Floats) -> Floats:
        """NaN where a point is not before the camera."""
        return _pixels(self.lens, self.in_camera(world))

    def rays(self, pixels: Floats) -> Floats:
        """Directions of length 1 in the world; NaN where the lens has none."""
        in_camera = np.ones((len(pixels), 3))
        in_camera[:, :2] = self.lens.cam_from_img(pixels)
        rays: Floats = in_camera @ self.rotation
        return rays / _lengths(rays)[:, None]

    def derivatives(self, world: Floats) -> Floats:
        """(n, 2, 3) of the pixels by the world points."""
        in_camera = self.in_camera(world)
        step = _STEP * np.abs(in_camera[:, 2:])
        by_axis = [
            (
                _pixels(self.lens, in_camera + step * axis)
                - _pixels(self.lens, in_camera - step * axis)
            )
            / (2 * step)
            for axis in np.eye(3)
        ]
        return np.stack(by_axis, axis=2) @ self.rotation


@dataclass(frozen=True, eq=False)
class View:
    """A photograph that both models have, and the true points that it sees.

    Attributes:
        point: (n,), indices of the points.
        pixel: (n, 2), where the true camera sees them.
        depth: (n,), from the true camera.
    """

    name: str
    camera: Camera
    true_camera: Camera
    point: NDArray[np.int64]
    pixel: Floats
    depth: Floats


def judge(model: SparseModel, truth: SparseModel, most_points: int = 20000) -> dict[str, Any]:
    """Errors of `model`, whose photographs are those of the same names in `truth`.

    The two are aligned twice, by least squares (Umeyama 1991): by the projection centres, and by the true points
    as the model's own cameras triangulate them. Centres of a flat block say little of its turn and nothing of
    its bend, so the reprojection after the first exceeds what dense stereo feels; a cloud of these cameras,
    laid over the truth as well as it will go, has the second. For both:

    - centres, centres_gsd: distances of projection centres, in units of TRUTH and in GSD, the median of depth to
      focal length;
    - rotations_deg: angles between the cameras' axes, all three;
    - reprojection_px: a true point through the alignment and the model's camera, less where the true camera has it.

    Apart from them, since no alignment is needed:

    - consistency_px: the true pixels of a point triangulated by all of the model's cameras that see it; how far
      from these pixels they see the result. It is what native stereo sees of wrong cameras, whose matches lie
      beside the epipolar lines by as much. Since a point bends to its pixels, it is less than the error of a
      camera: by sqrt(1 - 3 / 2n) for n photographs if errors are independent. Exact cameras have 0.
    - points_lost: seen by two photographs or more, and not triangulated, since they would lie behind a camera.
    - points_gsd: those points after the alignment by points, from the true ones. The bend of the block.

    Args:
        most_points: evenly chosen from the points of `truth` if it has more.
    """
    views = common_views(model, truth, most_points)
    if len(views) < 3:
        sys.exit(f"the models have {len(views)} photographs in common: three are needed to align")
    points = truth.points
    pixels_per_unit = [view.true_camera.lens.mean_focal_length() / view.depth for view in views]
    gsd = 1 / float(np.median(np.concatenate(pixels_per_unit)))

    triangulated = triangulate(views, len(points))
    known = ~np.isnan(triangulated[:, 0])
    seen = np.bincount(np.concatenate([view.point for view in views]), minlength=len(points))
    consistency = [_inconsistency(view, triangulated, known) for view in views]
    by_centres = _similarity(
        np.array([view.camera.centre for view in views]),
        np.array([view.true_camera.centre for view in views]),
    )
    by_points = _similarity(triangulated[known], points[known])
    with_centres = _after(by_centres, views, points, gsd)
    with_points = _after(by_points, views, points, gsd)
    errors = _lengths(_moved(by_points, triangulated[known]) - points[known])
    return {
        "photographs": len(views),
        "missing": sorted({image.name for image in truth.images} - {view.name for view in views}),
        "points": int(known.sum()),
        "points_lost": int(((seen >= 2) & ~known).sum()),
        "observations": sum(map(len, consistency)),
        "gsd": gsd,
        "by_centres": {name: _summary(values) for name, values in with_centres.items()},
        "by_points": {name: _summary(values) for name, values in with_points.items()},
        "points_gsd": _summary([errors / gsd]),
        "consistency_px": _summary(consistency),
        "images": {
            view.name: {
                "centre_gsd": _summary([with_centres["centres_gsd"][i]])["rms"],
                "rotation_deg": _summary([with_centres["rotations_deg"][i]])["rms"],
                "reprojection_px": _summary([with_centres["reprojection_px"][i]]),
                "reprojection_by_points_px": _summary([with_points["reprojection_px"][i]]),
                "consistency_px": _summary([consistency[i]]),
            }
            for i, view in enumerate(views)
        },
    }


def common_views(model: SparseModel, truth: SparseModel, most_points: int) -> list[View]:
    """The photographs of both models in order of their names, with the true points before the true cameras."""
    chosen = np.zeros(len(truth.points), bool)
    chosen[:: max(1, -(-len(truth.points) // most_points))] = True
    ours = {image.name: Camera.of(model, image) for image in model.images}
    views = []
    for index, image in sorted(enumerate(truth.images), key=lambda item: item[1].name):
        if image.name not in ours:
            continue
        exact = Camera.of(truth, image)
        lens = ours[image.name].lens
        if (exact.lens.width, exact.lens.height) != (lens.width, lens.height):
            sys.exit(f"{image.name} has another size in the two models: judge native pixels")
        point = np.unique(truth.point[truth.seen(index)]).astype(np.int64)
        point = point[chosen[point]]
        depth = exact.in_camera(truth.points[point])[:, 2]
        point, depth = point[depth > 0], depth[depth > 0]
        pixel = exact.project(truth.points[point])
        views.append(View(image.name, ours[image.name], exact, point, pixel, depth))
    return views


def triangulate(views: Sequence[View], count: int) -> Floats:
    """(count, 3), in the frame of the model: the points whose pixels in its cameras are nearest to the true ones,
    by least squares. NaN where fewer than two photographs see a point.

    From where the rays pass nearest, which is linear, by Gauss-Newton.
    """
    normal, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    seen = np.zeros(count, np.int64)
    for view in views:
        rays = view.camera.rays(view.pixel)
        good = np.isfinite(rays).all(axis=1)
        point, rays = view.point[good], rays[good]
        across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
        normal[point] += across
        right[point] += across @ view.camera.centre
        seen[point] += 1
    points = _solved(normal, right)
    points[seen < 2] = np.nan
    for _ in range(_ROUNDS):
        normal[:], right[:] = 0, 0
        for view in views:
            error = view.pixel - view.camera.project(points[view.point])
            slopes = view.camera.derivatives(points[view.point])
            normal[view.point] += np.swapaxes(slopes, 1, 2) @ slopes
            right[view.point] += np.einsum("nki,nk->ni", slopes, error)
        points += _solved(normal, right)
    return points


def _solved(normal: Floats, right: Floats) -> Floats:
    """(n, 3) from (n, 3, 3) and (n, 3); NaN where these are not finite."""
    good = np.isfinite(normal).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
    solved = np.full(right.shape, np.nan)
    inverse = np.linalg.pinv(normal[good], hermitian=True)
    solved[good] = np.einsum("nij,nj->ni", inverse, right[good])
    return solved


def _inconsistency(view: View, triangulated: Floats, known: NDArray[np.bool_]) -> Floats:
    """Pixels, of the points that are known."""
    of_view = known[view.point]
    return _lengths(view.camera.project(triangulated[view.point[of_view]]) - view.pixel[of_view])


def _after(
    true_from_model: pycolmap.Sim3d, views: Sequence[View], points: Floats, gsd: float
) -> dict[str, list[Floats]]:
    """Errors of each view, (1,) or one for each of its points."""
    turn, back = true_from_model.rotation.matrix(), true_from_model.inverse()
    found: dict[str, list[Floats]] = {
        name: [] for name in ("centres", "centres_gsd", "rotations_deg", "reprojection_px")
    }
    for view in views:
        exact = view.true_camera
        centre = _lengths(_moved(true_from_model, view.camera.centre[None]) - exact.centre)
        # The length of R - 1 keeps the digits of small angles, which its trace loses.
        apart = np.linalg.norm(view.camera.rotation @ turn.T @ exact.rotation.T - np.eye(3))
        angle = 2 * np.arcsin(min(1.0, float(apart) / np.sqrt(8)))
        projected = view.camera.project(_moved(back, points[view.point]))
        found["centres"].append(centre)
        found["centres_gsd"].append(centre / gsd)
        found["rotations_deg"].append(np.degrees([angle]))
        found["reprojection_px"].append(_lengths(projected - view.pixel))
    return found


def _similarity(source: Floats, target: Floats) -> pycolmap.Sim3d:
    """target_from_source of points (n, 3), by least squares; also of points on a plane, as pycolmap's is not.

    Ends the program where all lie on a line.
    """
    origin, goal = source.mean(axis=0), target.mean(axis=0)
    left, values, right = np.linalg.svd((target - goal).T @ (source - origin))
    if values[1] <= _ON_A_LINE * values[0]:
        sys.exit("the models cannot be aligned: their centres, or points, lie on one line")
    values[2] *= (mirrored := np.sign(np.linalg.det(left @ right)))
    rotation = left @ np.diag([1, 1, mirrored]) @ right
    scale = values.sum() / np.square(source - origin).sum()
    return pycolmap.Sim3d(scale, pycolmap.Rotation3d(rotation), goal - scale * rotation @ origin)


def _moved(similarity: pycolmap.Sim3d, points: Floats) -> Floats:
    return points @ similarity.matrix()[:, :3].T + similarity.matrix()[:, 3]


def _pixels(lens: pycolmap.Camera, in_camera: Floats) -> Floats:
    pixels = np.full((len(in_camera), 2), np.nan)
    before = in_camera[:, 2] > 0
    pixels[before] = lens.img_from_cam(in_camera[before])
    return pixels


def _lengths(vectors: Floats) -> Floats:
    lengths: Floats = np.linalg.norm(vectors, axis=1)
    return lengths


def _summary(values: Sequence[Floats]) -> dict[str, float | None]:
    """None where one of the points is behind a camera, or there is none."""
    together = np.concatenate(values)
    found = {
        "rms": np.sqrt(np.mean(together**2)) if len(together) else np.nan,
        "median": np.median(together) if len(together) else np.nan,
        "max": together.max() if len(together) else np.nan,
    }
    return {name: round(float(x), 6) if np.isfinite(x) else None for name, x in found.items()}
