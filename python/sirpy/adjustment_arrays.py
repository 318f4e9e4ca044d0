"""A sparse model as the arrays of unknowns and observations that bundle adjustment works on.

A pose is a row (quaternion x, y, z, w, centre x, y, z) and takes a point X to R (X - centre); the
origin of the arrays is the mean of the cameras' centres, so that coordinates of a projected CRS keep their digits.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pycolmap
from numpy.typing import NDArray

from sirpy.errors import InputError

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]
Position = tuple[Floats, Floats]  # (3,) and the (3,) standard deviations

# Of a covariance, in units of its trace squared: about its least variance over its largest.
_LEAST_DETERMINANT = 1e-12


@dataclass(frozen=True)
class Unknowns:
    """Poses, lenses and points.

    Attributes:
        parameters: of each camera.
        frames: (n, 7), rig_from_world.
        sensors: (m, 7), sensor_from_rig of the sensors that are not their rig's reference.
        points: (p, 3), world.
    """

    parameters: tuple[Floats, ...]
    frames: Floats
    sensors: Floats
    points: Floats


@dataclass(frozen=True)
class Network:
    """What sees what: the images, points and observations of points that are seen at least twice.

    Attributes:
        cameras, frame_ids, sensors, image_ids, point_ids: what the indices stand for; a sensor is named
            by its camera.
        origin: (3,), of the unknowns in the model's frame.
        images: (i, 3), indices of camera, frame and sensor; sensor -1 for the reference of a rig.
        image, point: (o,), indices of each observation; points ascend.
        keypoint: (o,), index among the points2D of the image.
        xy: (o, 2), px.
        whitening: (o, 2, 2), W: of W^T W, the inverse of the covariance.
        positions: by index of the image, relative to the origin.
    """

    cameras: tuple[pycolmap.Camera, ...]
    frame_ids: tuple[int, ...]
    sensors: tuple[int, ...]
    image_ids: tuple[int, ...]
    point_ids: NDArray[np.uint64]
    origin: Floats
    images: Indices
    image: Indices
    point: Indices
    keypoint: NDArray[np.int64]
    xy: Floats
    whitening: Floats
    positions: dict[int, Position]

    def whitened(self, residuals: Floats) -> Floats:
        """(o, 2), without unit, of residuals (o, 2) in px."""
        whitened: Floats = np.einsum("nij,nj->ni", self.whitening, residuals)
        return whitened

    def centres(self, unknowns: Unknowns) -> Floats:
        """(i, 3), of the images."""
        centres: Floats = unknowns.frames[self.images[:, 1], 4:].copy()
        for row in np.flatnonzero(self.images[:, 2] >= 0):
            _, frame, sensor = self.images[row]
            inside = unknowns.sensors[sensor, 4:]
            centres[row] += _rotation(unknowns.frames[frame]).inverse() * inside
        return centres


def read_network(
    model: pycolmap.Reconstruction,
    covariances: Mapping[int, Floats],
    positions: Mapping[str, tuple[Floats, Floats]],
) -> tuple[Network, Unknowns]:
    """The arrays of a model.

    Args:
        covariances: (num_points2D, 2, 2) by image id, px^2.
        positions: of cameras by the names of their images: where in the model's frame, and the
            standard deviations of that.

    Raises:
        InputError: a covariance is missing or is none, a position is of no image of the model, or no
            point is seen twice.
    """
    image, point_id, keypoint, xy = _observations(model)
    _, index, counts = np.unique(point_id, return_inverse=True, return_counts=True)
    seen = counts[index] >= 2
    if not seen.any():
        raise InputError(
            "the sparse model has no point that is seen twice: there is nothing to adjust"
        )
    order = np.flatnonzero(seen)[np.argsort(index[seen], kind="stable")]
    point_ids, point = np.unique(point_id[order], return_inverse=True)
    image, keypoint, xy = image[order], keypoint[order], xy[order]
    image_ids = tuple(int(i) for i in np.unique(image))
    images = [model.image(i) for i in image_ids]
    camera_ids = sorted({one.camera_id for one in images})
    frame_ids = sorted({one.frame_id for one in images})
    sensors = sorted({one.camera_id for one in images if not one.is_ref_in_frame()})
    rows = [
        (
            camera_ids.index(one.camera_id),
            frame_ids.index(one.frame_id),
            -1 if one.is_ref_in_frame() else sensors.index(one.camera_id),
        )
        for one in images
    ]
    origin = np.mean([one.projection_center() for one in images], axis=0)
    image_index = np.searchsorted(image_ids, image).astype(np.int32)
    network = Network(
        cameras=tuple(model.camera(i) for i in camera_ids),
        frame_ids=tuple(frame_ids),
        sensors=tuple(sensors),
        image_ids=image_ids,
        point_ids=point_ids,
        origin=origin,
        images=np.array(rows, np.int32),
        image=image_index,
        point=point.astype(np.int32),
        keypoint=keypoint,
        xy=xy,
        whitening=_whitening(images, image_index, keypoint, covariances),
        positions=_positions(images, positions, origin),
    )
    points = np.array([model.point3D(i).xyz for i in point_ids.tolist()])
    unknowns = Unknowns(
        parameters=tuple(np.array(one.params) for one in network.cameras),
        frames=_poses((model.frame(i).rig_from_world for i in frame_ids), origin),
        sensors=_poses((_sensor_from_rig(model, i) for i in sensors), np.zeros(3)),
        points=points - origin,
    )
    return network, unknowns


def with_unknowns(
    model: pycolmap.Reconstruction, network: Network, unknowns: Unknowns
) -> pycolmap.Reconstruction:
    """A copy of the model with these lenses, poses and points.

    Frames without observations stay; points that are seen less than twice are not in it.
    """
    adjusted = pycolmap.Reconstruction(model)
    for camera, parameters in zip(network.cameras, unknowns.parameters, strict=True):
        adjusted.camera(camera.camera_id).params = parameters.tolist()
    for frame_id, pose in zip(network.frame_ids, unknowns.frames, strict=True):
        adjusted.frame(frame_id).rig_from_world = _rigid(pose, network.origin)
    for camera_id, pose in zip(network.sensors, unknowns.sensors, strict=True):
        sensor = adjusted.camera(camera_id).sensor_id
        _rig_of(adjusted, camera_id).set_sensor_from_rig(sensor, _rigid(pose, np.zeros(3)))
    kept = network.point_ids.tolist()
    for point_id, xyz in zip(kept, unknowns.points + network.origin, strict=True):
        adjusted.point3D(point_id).xyz = xyz
    for point_id in sorted(set(adjusted.point3D_ids()) - set(kept)):
        adjusted.delete_point3D(point_id)
    adjusted.update_point_3d_errors()
    return adjusted


def moved_back(network: Network, moved: Unknowns, unknowns: Unknowns) -> Unknowns:
    """`moved` after the similarity that takes it nearest to `unknowns`: by the centres of the images and the
    directions of the frames, which hold the turn about the line of a single strip."""
    old, new = network.centres(unknowns), network.centres(moved)
    old_mean, new_mean = old.mean(axis=0), new.mean(axis=0)
    old_size, new_size = np.linalg.norm(old - old_mean), np.linalg.norm(new - new_mean)
    turned = np.zeros((3, 3))
    for before, after in zip(unknowns.frames, moved.frames, strict=True):
        turned += _rotation(before).matrix().T @ _rotation(after).matrix() / len(moved.frames)
    scale = 1.0
    if old_size > 0 and new_size > 0:
        scale = float(old_size / new_size)
        turned += (old - old_mean).T @ (new - new_mean) / (old_size * new_size)
    left, _, right = np.linalg.svd(turned)
    rotation = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    shift = old_mean - scale * rotation @ new_mean
    frames = moved.frames.copy()
    back = pycolmap.Rotation3d(rotation).inverse()
    for frame in frames:
        frame[:4] = (_rotation(frame) * back).quat
    frames[:, 4:] = scale * frames[:, 4:] @ rotation.T + shift
    sensors = moved.sensors * [1, 1, 1, 1, scale, scale, scale]
    points = scale * moved.points @ rotation.T + shift
    return replace(moved, frames=frames, sensors=sensors, points=points)


def _observations(
    model: pycolmap.Reconstruction,
) -> tuple[NDArray[np.int64], NDArray[np.uint64], NDArray[np.int64], Floats]:
    """(id of the image, id of the point, index of the keypoint, xy) of each observation."""
    images, points, keypoints, xy = [], [], [], []
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        seen = image.get_observation_points2D()
        images.append(np.full(len(seen), image_id, np.int64))
        points.append(np.array([one.point3D_id for one in seen], np.uint64))
        keypoints.append(np.array(image.get_observation_point2D_idxs(), np.int64))
        xy.append(np.array([one.xy for one in seen], np.float64).reshape(-1, 2))
    if not images:
        raise InputError("the sparse model has no image with a pose: there is nothing to adjust")
    return tuple(np.concatenate(one) for one in (images, points, keypoints, xy))  # type: ignore[return-value]


def _whitening(
    images: list[pycolmap.Image],
    image: Indices,
    keypoint: NDArray[np.int64],
    covariances: Mapping[int, Floats],
) -> Floats:
    """(o, 2, 2), the inverse of the lower Cholesky factor of each covariance."""
    given = np.empty((len(image), 2, 2))
    for index, one in enumerate(images):
        of_image = covariances.get(one.image_id)
        if of_image is None or of_image.shape != (one.num_points2D(), 2, 2):
            raise InputError(
                f"the covariances of {one.name} are not one 2x2 matrix for each of its "
                f"{one.num_points2D()} keypoints: give them as ({one.num_points2D()}, 2, 2)"
            )
        mine = image == index
        given[mine] = of_image[keypoint[mine]]
    symmetric = np.abs(given[:, 0, 1] - given[:, 1, 0]) <= 1e-6 * np.abs(given).max(axis=(1, 2))
    determinant = given[:, 0, 0] * given[:, 1, 1] - given[:, 0, 1] * given[:, 1, 0]
    trace = given[:, 0, 0] + given[:, 1, 1]
    # Written so that NaN is not sound. A smaller determinant is that of rounding.
    sound = symmetric & (trace > 0) & (determinant > _LEAST_DETERMINANT * trace**2)
    sound &= np.isfinite(determinant)
    if not sound.all():
        first = int(np.flatnonzero(~sound)[0])
        raise InputError(
            f"keypoint {keypoint[first]} of {images[image[first]].name} has a covariance that is "
            "not symmetric and positive definite: leave out that observation, or mend it"
        )
    whitening: Floats = np.linalg.inv(np.linalg.cholesky(given))
    return whitening


def _positions(
    images: list[pycolmap.Image], positions: Mapping[str, tuple[Floats, Floats]], origin: Floats
) -> dict[int, Position]:
    indices = {one.name: index for index, one in enumerate(images)}
    found = {}
    for name, (xyz, sigma) in positions.items():
        if name not in indices:
            raise InputError(
                f"a position is given for {name}, which is no image of the model that sees a point "
                "seen twice: leave it out"
            )
        if not (
            np.isfinite(xyz).all() and np.isfinite(sigma).all() and (np.array(sigma) > 0).all()
        ):
            raise InputError(
                f"the position of {name} or its standard deviation is not a number above 0: mend it"
            )
        found[indices[name]] = (np.asarray(xyz) - origin, np.asarray(sigma, np.float64))
    return found


def _rig_of(model: pycolmap.Reconstruction, camera_id: int) -> pycolmap.Rig:
    sensor = model.camera(camera_id).sensor_id
    rigs: list[pycolmap.Rig] = [rig for rig in model.rigs.values() if rig.has_sensor(sensor)]
    return rigs[0]


def _sensor_from_rig(model: pycolmap.Reconstruction, camera_id: int) -> pycolmap.Rigid3d | None:
    return _rig_of(model, camera_id).sensor_from_rig(model.camera(camera_id).sensor_id)


def _rotation(pose: Floats) -> pycolmap.Rotation3d:
    return pycolmap.Rotation3d(pose[:4])


def _poses(rigids: Iterable[pycolmap.Rigid3d | None], origin: Floats) -> Floats:
    rows = [
        (*one.rotation.quat, *(one.tgt_origin_in_src() - origin))
        for one in rigids
        if one is not None  # never of an image with a pose
    ]
    return np.array(rows, np.float64).reshape(-1, 7)


def _rigid(pose: Floats, origin: Floats) -> pycolmap.Rigid3d:
    rotation = _rotation(pose)
    rotation.normalize()
    return pycolmap.Rigid3d(rotation, -(rotation * (pose[4:] + origin)))
