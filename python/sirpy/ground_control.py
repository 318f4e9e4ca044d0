"""Ground control: surveyed points, their marks in photographs, and where the model has these points.

Marks are pixels of the photographs as they were taken, distorted, the centre of the top-left pixel at (0.5, 0.5).
A point is where the rays of its marks meet, by least squares in pixels; its covariance follows, so that a height
from rays that are nearly parallel counts for as little as it is worth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pycolmap

from sirpy.camera_positions import Photographs
from sirpy.errors import InputError, first_few
from sirpy.model_arrays import SparseModel
from sirpy.places import Places, read_places
from sirpy.point_tables import Row, Table, read_table
from sirpy.progress import Progress

Floats = npt.NDArray[np.float64]

_ID = ("id", "point", "point_id", "gcp", "name", "label")
_IMAGE = ("image", "photo", "photograph", "filename", "file", "image_name")
_COLUMN, _ROW = ("x", "u", "column", "col", "px"), ("y", "v", "row", "py")
_SIGMA = ("sigma", "accuracy")
_SIGMAS = (("sigma_x", "sigmax", "sx"), ("sigma_y", "sigmay", "sy"), ("sigma_z", "sigmaz", "sz"))
_CHECK, _YES, _NO = ("check",), ("1", "yes", "true", "check"), ("", "0", "no", "false", "control")

_ROUNDS = 20  # of Gauss-Newton
_GATE = 5.0  # sigma of a mark
_LEAST_GATE, _LEAST_SIGMA = 3.0, 0.3  # pixels
_MEDIAN_OF_SIGMA = 1.177  # the median length of a vector in 2D whose components have a sigma of 1
_NARROWEST = 1e-3  # radians between rays: narrower ones do not tell where they meet


@dataclass(frozen=True, eq=False)
class ControlPoints:
    """`sigmas` (n, 3) in metres or the unit of the places, 0 where nothing is said; `check` (n,): only compared."""

    places: Places
    sigmas: Floats
    check: npt.NDArray[np.bool_]

    def taking(self, rows: Sequence[int]) -> ControlPoints:
        """Some of them."""
        names = tuple(self.places.names[row] for row in rows)
        places = Places(names, self.places.xyz[rows], self.places.crs)
        return ControlPoints(places, self.sigmas[rows], self.check[rows])


@dataclass(frozen=True, eq=False)
class Mark:
    """Where a photograph, `images[image]` of the model, shows a point; pixels."""

    point: str
    image: int
    xy: Floats


@dataclass(frozen=True, eq=False)
class ModelPoint:
    """A point (3,) of the model with its covariance (3, 3), from these marks; the others did not fit, by so many
    pixels."""

    xyz: Floats
    covariance: Floats
    marks: tuple[Mark, ...]
    left_out: tuple[tuple[Mark, float], ...]


def read_control_points(path: Path, crs: str | None, check: Sequence[str] = ()) -> ControlPoints:
    """The points of a table: id, coordinates as `read_places` takes them, if wanted sigma or sigma_x,
    sigma_y, sigma_z, and check.

    Args:
        check: ids of more points that are only compared.

    Raises:
        InputError: it cannot be read as such.
    """
    table = read_table(path)
    table.need(_ID)
    rows = list(table.by_name(_ID))
    places = read_places(table, rows, crs)
    unknown = sorted(set(check) - set(places.names))
    if unknown:
        raise InputError(
            f"{path} has no point {first_few(unknown)}, which --check names: give its ids"
        )
    return ControlPoints(
        places,
        np.array([_sigmas(row, table) for _, row in rows]),
        np.array([name in check or _is_check(row) for name, row in rows], bool),
    )


def read_marks(
    path: Path, model: SparseModel, points: ControlPoints, progress: Progress
) -> list[Mark]:
    """The marks of a table: image, id of the point, x, y in pixels of the photograph.

    Those in photographs that the model does not have are passed over, with a note.

    Raises:
        InputError: it cannot be read, a point is unknown, marked twice in a photograph, or the mark lies
            outside it; or no photograph is of the model.
    """
    table = read_table(path)
    table.need(_IMAGE, _ID, _COLUMN, _ROW)
    photographs = Photographs(image.name for image in model.images)
    index = {image.name: number for number, image in enumerate(model.images)}
    marks: dict[tuple[str, int], Mark] = {}
    strange: dict[str, None] = {}
    for row in table.rows:
        called, point = row.text(_IMAGE), row.text(_ID)
        xy = np.array([row.number(_COLUMN), row.number(_ROW)])
        if point not in points.places.names:
            raise InputError(
                f"{row.where} marks the point {point}, whose coordinates are not given: add it to the control "
                "points, or remove the line"
            )
        name = photographs.find(called, row.where)
        if name is None:
            strange[called] = None
            continue
        camera = model.camera_of(model.images[index[name]])
        if not ((xy >= 0) & (xy <= [camera.width, camera.height])).all():
            raise InputError(
                f"{row.where} marks ({xy[0]:g}, {xy[1]:g}) in {name}, which has {camera.width}x{camera.height} "
                "pixels: give pixels of the photograph as it was taken"
            )
        if (point, index[name]) in marks:
            raise InputError(f"{row.where} marks {point} in {name} again: keep one of the marks")
        marks[point, index[name]] = Mark(point, index[name], xy)
    if strange:
        progress.note(
            f"marks in {len(strange)} photographs that the model does not have are not used: "
            f"{first_few(list(strange))}"
        )
    if not marks:
        raise InputError(
            f"{path} has no mark in a photograph of the model: write the photographs' names"
        )
    return list(marks.values())


def intersect(model: SparseModel, marks: Sequence[Mark]) -> dict[str, ModelPoint]:
    """The points, by id, where the rays of their marks meet; those are missing whose do not, or are one.

    A mark that does not fit at least two others of its point is left out: further off than five sigma of what
    all marks together show, and than three pixels.
    """
    by_point: dict[str, list[Mark]] = {}
    for mark in marks:
        by_point.setdefault(mark.point, []).append(mark)
    found = {name: met for name, some in by_point.items() if (met := _meet(model, some, 1.0))}
    sigma = _mark_sigma(model, found)
    gate = max(_GATE * sigma, _LEAST_GATE)
    checked = {name: _without_bad_marks(model, point, gate, sigma) for name, point in found.items()}
    return {name: point for name, point in checked.items() if point is not None}


def distances(model: SparseModel, xyz: Floats, marks: Sequence[Mark]) -> Floats:
    """(m,) pixels between the marks and where their photographs see a point (3,) of the model; infinite behind
    a camera."""
    away = np.full(len(marks), np.inf)
    for number, mark in enumerate(marks):
        image = model.images[mark.image]
        in_camera = image.cam_from_world @ [*xyz, 1]
        if in_camera[2] > 0:
            seen = model.camera_of(image).img_from_cam(in_camera[None])
            away[number] = np.linalg.norm(np.asarray(seen)[0] - mark.xy)
    return away


def _meet(model: SparseModel, marks: Sequence[Mark], sigma: float) -> ModelPoint | None:
    """Where the rays of marks meet, each good to sigma pixels; None where they do not tell."""
    poses = np.array([model.images[mark.image].cam_from_world for mark in marks])
    cameras = [model.camera_of(model.images[mark.image]) for mark in marks]
    rays = np.array([_ray(camera, mark.xy) for camera, mark in zip(cameras, marks, strict=True)])
    if len(marks) < 2 or not np.isfinite(rays).all():
        return None
    focal = np.array([camera.mean_focal_length() for camera in cameras])
    centres = -np.einsum("nji,nj->ni", poses[:, :, :3], poses[:, :, 3])
    world = np.einsum("nji,nj->ni", poses[:, :, :3], np.column_stack([rays, np.ones(len(rays))]))
    world /= np.linalg.norm(world, axis=1, keepdims=True)
    if np.linalg.norm(np.cross(world[:, None], world[None]), axis=2).max() < _NARROWEST:
        return None
    across = np.eye(3) - world[:, :, None] * world[:, None, :]
    xyz = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, centres))
    for _ in range(_ROUNDS):
        in_camera = np.einsum("nij,j->ni", poses[:, :, :3], xyz) + poses[:, :, 3]
        depth = in_camera[:, 2]
        if (depth <= 0).any():
            return None
        ahead = in_camera[:, :2] / depth[:, None]
        jacobian = (poses[:, :2, :3] - ahead[:, :, None] * poses[:, 2:, :3]) * (
            focal / depth / sigma
        )[:, None, None]
        residual = (ahead - rays) * (focal / sigma)[:, None]
        normal = np.einsum("nki,nkj->ij", jacobian, jacobian)
        step = np.linalg.solve(normal, -np.einsum("nki,nk->i", jacobian, residual))
        xyz = xyz + step
        if np.linalg.norm(step) <= 1e-12 * depth.max():
            break
    return ModelPoint(xyz, np.linalg.inv(normal), tuple(marks), ())


def _ray(camera: pycolmap.Camera, xy: Floats) -> Floats:
    """x and y at depth 1 of a pixel; not finite where the camera has no such ray."""
    ray: Floats = np.asarray(camera.cam_from_img(xy[None]), np.float64)[0]
    return ray


def _mark_sigma(model: SparseModel, points: dict[str, ModelPoint]) -> float:
    """Of one coordinate of a mark, in pixels, from how well the rays meet."""
    away = [distances(model, point.xyz, point.marks) for point in points.values()]
    if not away:
        return _LEAST_SIGMA
    lengths = np.concatenate(away)
    free = (2 * len(lengths) - 3 * len(points)) / (2 * len(lengths))
    sigma = float(np.median(lengths)) / _MEDIAN_OF_SIGMA / np.sqrt(free)
    return max(float(sigma), _LEAST_SIGMA)


def _without_bad_marks(
    model: SparseModel, point: ModelPoint, gate: float, sigma: float
) -> ModelPoint | None:
    marks = list(point.marks)
    left_out: list[tuple[Mark, float]] = []
    while True:
        met = _meet(model, marks, sigma)
        if met is None:
            return None
        if distances(model, met.xyz, marks).max() <= gate or len(marks) < 3:
            return ModelPoint(met.xyz, met.covariance, tuple(marks), tuple(left_out))
        # The one without which the others fit best.
        rest = [[mark for mark in marks if mark is not one] for one in marks]
        tried = [_meet(model, some, sigma) for some in rest]
        worst = [
            np.inf if one is None else distances(model, one.xyz, some).max()
            for one, some in zip(tried, rest, strict=True)
        ]
        which = int(np.argmin(worst))
        without = tried[which]
        if without is None:
            return None
        left_out.append((marks[which], float(distances(model, without.xyz, [marks[which]])[0])))
        marks = rest[which]


def _sigmas(row: Row, table: Table) -> tuple[float, float, float]:
    """0 where the table does not say."""

    def of(names: Sequence[str]) -> float:
        value = row.number(names) if any(name in table.headers for name in names) else 0.0
        if value < 0:
            raise InputError(f"{row.where} has a sigma of {value:g}: it must not be negative")
        return value

    each = of(_SIGMA)
    x, y, z = (of((*names,)) or each for names in _SIGMAS)
    return x, y, z


def _is_check(row: Row) -> bool:
    text = row.text(_CHECK).lower()
    if text not in (*_YES, *_NO):
        raise InputError(f"{row.where} has {text!r} for check: write yes or no")
    return text in _YES
