"""The exact surface of a scene as a judge: depth maps, distances, quality of a point cloud."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sirpy import _core
from sirpy.errors import InputError
from sirpy.files import written_whole
from sirpy.ply import read_vertices

Floats = NDArray[np.float64]

_LEAST_VIEWS = 3
_STEEPEST = np.cos(
    np.radians(75)
)  # a surface seen at a flatter angle is not asked of a reconstruction
_SAMPLE_SPACING = 2.0  # of the points asked for, GSD
_MOST_JUDGED = 2_000_000  # points of a cloud whose accuracy is measured
_CHUNK = 500_000


class Truth:
    """A surface of triangles in world coordinates, with the GSD of the photographs in the same
    unit.

    Args:
        vertices: (vertices, 3) float64.
        triangles: (triangles, 3) int32, indices of vertices, counter-clockwise from outside.
        gsd: ground sampling distance.
    """

    def __init__(self, vertices: Floats, triangles: NDArray[np.int32], gsd: float) -> None:
        self.surface = _core.Surface(
            np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(triangles, np.int32)
        )
        self.gsd = gsd

    def write(self, path: Path) -> None:
        with written_whole(path) as temporary, temporary.open("wb") as file:
            np.savez(
                file,
                vertices=self.surface.vertices,
                triangles=self.surface.triangles,
                gsd=np.array(self.gsd),
            )

    @classmethod
    def read(cls, path: Path) -> Truth:
        """Raises InputError where there is no readable ground truth at `path`."""
        try:
            with np.load(path) as file:
                return cls(file["vertices"], file["triangles"], float(file["gsd"]))
        except (OSError, ValueError, KeyError) as error:
            raise InputError(
                f"{path} is not the ground truth of a synthetic scene ({error}): "
                "render the scene again"
            ) from None

    def depth_map(self, camera: Any, cam_from_world: Any) -> NDArray[np.float32]:
        """Exact z-depths at the pixel centres of a PINHOLE camera: (height, width), 0 beyond the
        scene.

        Args:
            camera: a pycolmap.Camera of model PINHOLE or SIMPLE_PINHOLE; any principal point.
            cam_from_world: a pycolmap.Rigid3d.
        """
        world_from_cam = cam_from_world.inverse()
        rotation = world_from_cam.rotation.matrix()
        calibration = camera.calibration_matrix()
        x = (np.arange(camera.width) + 0.5 - calibration[0, 2]) / calibration[0, 0]
        y = (np.arange(camera.height) + 0.5 - calibration[1, 2]) / calibration[1, 1]
        depth = np.zeros((camera.height, camera.width), np.float32)
        band = max(1, _CHUNK // camera.width)
        for row in range(0, camera.height, band):
            rays = np.stack(
                [*np.meshgrid(x, y[row : row + band]), np.ones_like(depth[row : row + band])],
                axis=-1,
            )
            # The rays have z = 1 in the camera frame, so that the way along a ray is the z-depth.
            way = self.surface.cast(
                world_from_cam.translation, rays.reshape(-1, 3) @ rotation.T
            ).reshape(-1, camera.width)
            depth[row : row + band] = np.where(np.isfinite(way), way, 0)
        return depth

    def distances(self, points: Floats, limit: float) -> Floats:
        """Distance of each point (points, 3) to the surface; infinity where it is above `limit`."""
        return self.surface.distances(np.ascontiguousarray(points, np.float64), limit)


@dataclass(frozen=True)
class Evaluation:
    """Quality of a point cloud: shares (0 .. 1) for each threshold, in GSD.

    accuracy: share of the cloud's points within the threshold of the true surface.
    completeness: share of the true surface within the threshold of a point of the cloud.
    f1: their harmonic mean.
    """

    thresholds: tuple[float, ...]
    accuracy: tuple[float, ...]
    completeness: tuple[float, ...]
    f1: tuple[float, ...]
    gsd: float
    cloud_points: int
    surface_points: int

    def as_json(self) -> dict[str, Any]:
        return asdict(self)

    def __str__(self) -> str:
        lines = ["within       accuracy  completeness     F1"]
        for row in zip(self.thresholds, self.accuracy, self.completeness, self.f1, strict=True):
            lines.append(f"{row[0]:4g} GSD     {row[1]:8.1%}  {row[2]:12.1%}  {row[3]:5.3f}")
        return "\n".join(lines)


def evaluate_cloud(
    truth: Truth, model: Any, cloud: Path, thresholds: Sequence[float] = (1, 2, 5)
) -> Evaluation:
    """Judges a cloud in the world frame of `truth` where at least three photographs look.

    Accuracy counts the points that at least three photographs have in their frame; completeness
    asks for the places of the surface that at least three photographs see, at no more than 75
    degrees from the surface's normal. Of a cloud above two million points every n-th is judged for
    accuracy; all count for completeness.

    Args:
        model: pycolmap.Reconstruction with the exact cameras.
        cloud: a binary PLY.

    Raises:
        InputError: the cloud cannot be read, or a threshold is not above 0.
    """
    if not thresholds or min(thresholds) <= 0:
        raise InputError("the thresholds of an evaluation must be above 0")
    limit = max(thresholds) * truth.gsd
    vertices = read_vertices(cloud)
    points = np.concatenate([np.empty((0, 3)), *_finite_chunks(vertices)])
    stride = max(1, -(-len(points) // _MOST_JUDGED))
    judged = points[::stride]
    judged = np.ascontiguousarray(judged[_frames(model, judged) >= _LEAST_VIEWS])
    asked = places_to_find(truth, model)
    to_surface = truth.distances(judged, limit)
    to_cloud = (
        _core.nearest_distances(asked, points, limit)
        if len(points)
        else np.full(len(asked), np.inf)
    )
    accuracy = [_share(to_surface <= t * truth.gsd) for t in thresholds]
    completeness = [_share(to_cloud <= t * truth.gsd) for t in thresholds]
    return Evaluation(
        tuple(float(t) for t in thresholds),
        tuple(accuracy),
        tuple(completeness),
        tuple(
            2 * a * c / (a + c) if a + c > 0 else 0.0
            for a, c in zip(accuracy, completeness, strict=True)
        ),
        truth.gsd,
        len(judged),
        len(asked),
    )


def _share(good: NDArray[np.bool_]) -> float:
    return float(np.mean(good)) if len(good) else 0.0


def _finite_chunks(vertices: NDArray[Any]) -> Iterator[Floats]:
    for begin in range(0, len(vertices), _CHUNK):
        part = vertices[begin : begin + _CHUNK]
        points = np.stack([part["x"], part["y"], part["z"]], axis=1).astype(np.float64)
        yield points[np.isfinite(points).all(axis=1)]


def _in_frame(image: Any, points: Floats) -> NDArray[np.bool_]:
    """Which points (points, 3) lie before the camera and project into its image."""
    in_camera: Floats = image.cam_from_world() * points
    inside: NDArray[np.bool_] = in_camera[:, 2] > 0
    # Far outside the image a lens polynomial may fold back: only rays near the frame are projected.
    camera = image.camera
    reach = 1.5 * np.hypot(camera.width, camera.height) / camera.focal_length_x
    inside[inside] &= np.linalg.norm(in_camera[inside, :2] / in_camera[inside, 2:], axis=1) < reach
    pixels: Floats = camera.img_from_cam(in_camera[inside])
    inside[inside] = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
    return inside


def _frames(model: Any, points: Floats) -> NDArray[np.int32]:
    """In how many photographs' frames each point lies."""
    count = np.zeros(len(points), np.int32)
    for image in model.images.values():
        for begin in range(0, len(points), _CHUNK):
            count[begin : begin + _CHUNK] += _in_frame(image, points[begin : begin + _CHUNK])
    return count


def places_to_find(truth: Truth, model: Any) -> Floats:
    """Points of the surface, evenly spread, that at least three photographs see."""
    vertices = truth.surface.vertices
    spacing = _SAMPLE_SPACING * truth.gsd
    minimum, maximum = _ground_area(model, vertices)
    points, normals = truth.surface.sample(spacing, 1, minimum, maximum)
    views = np.zeros(len(points), np.int32)
    for image in model.images.values():
        views[visible(truth, image, points, normals)] += 1
    return np.ascontiguousarray(points[views >= _LEAST_VIEWS])


def _ground_area(model: Any, vertices: Floats) -> tuple[Floats, Floats]:
    """Minimum and maximum (x, y) that any photograph can see: its border on the lowest level."""
    places = []
    for image in model.images.values():
        camera = image.camera
        x, y = np.linspace(0, camera.width, 9), np.linspace(0, camera.height, 9)
        pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        rays = np.column_stack([camera.cam_from_img(pixels), np.ones(len(pixels))])
        world_from_cam = image.cam_from_world().inverse()
        rays = rays @ world_from_cam.rotation.matrix().T
        centre = world_from_cam.translation
        down = rays[:, 2] < 0
        way = (vertices[:, 2].min() - centre[2]) / rays[down, 2]
        places.append(centre[:2] + way[:, None] * rays[down, :2])
        places.append(centre[None, :2])
    all_places = np.concatenate(places)
    return all_places.min(axis=0), all_places.max(axis=0)


def visible(
    truth: Truth, image: Any, points: Floats, normals: Floats | None = None
) -> NDArray[np.intp]:
    """Indices of the surface points (points, 3) that a photograph of a pycolmap model truly sees.

    With `normals` (points, 3), only those seen at no more than 75 degrees from the normal.
    """
    candidates = np.flatnonzero(_in_frame(image, points))
    centre: Floats = image.projection_center()
    if normals is not None:
        towards = centre - points[candidates]
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        slant = np.einsum("ij,ij->i", towards, normals[candidates])
        candidates = candidates[slant > _STEEPEST]
    free = truth.surface.sees(centre, np.ascontiguousarray(points[candidates]), 1e-3 * truth.gsd)
    seen: NDArray[np.intp] = candidates[free]
    return seen
