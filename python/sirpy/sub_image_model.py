"""COLMAP models of what was cut: the whole undistorted images, and the sub-images.

Both hold the observations of 3D points only: keypoints without a point serve no later stage. Every
step is linear in the number of observations.
"""

from __future__ import annotations

import os
import shutil
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from sirpy.errors import OutputError
from sirpy.lens import UndistortOptions, moved_between, undistorted_camera
from sirpy.workspace import NativeImage


@dataclass(frozen=True)
class _Observations:
    """Of one image: positions (n, 2) in pixels, and the ids (n,) of the 3D points seen there."""

    xy: NDArray[np.float64]
    point_ids: NDArray[np.uint64]


def undistorted_model(
    model: pycolmap.Reconstruction,
    options: UndistortOptions = UndistortOptions(),
    names: Iterable[str] | None = None,
) -> pycolmap.Reconstruction:
    """The model of the undistorted native images, with the ids of `model` and PINHOLE cameras.

    Args:
        names: the images to keep; all that have a pose when None.

    Raises:
        InputError: a camera cannot be undistorted.
    """
    kept = None if names is None else set(names)
    undistorted = pycolmap.Reconstruction()
    observations = {}
    seen = _observations(model)
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        if kept is not None and image.name not in kept:
            continue
        camera = model.camera(image.camera_id)
        if not undistorted.exists_camera(camera.camera_id):
            undistorted.add_camera_with_trivial_rig(undistorted_camera(camera, options))
        of_image = seen[image_id]
        xy = moved_between(camera, undistorted.camera(camera.camera_id), of_image.xy)
        # A keypoint that the lens model cannot undistort has no place in a pinhole image.
        finite = np.isfinite(xy).all(axis=1)
        observations[image_id] = _Observations(xy[finite], of_image.point_ids[finite])
        _add_image(undistorted, image, image.name, camera.camera_id, image_id, xy[finite])
    _add_points(undistorted, model, observations)
    return undistorted


def sub_image_model(
    native: pycolmap.Reconstruction, natives: Iterable[NativeImage]
) -> pycolmap.Reconstruction:
    """The model of the sub-images: one PINHOLE camera and one image each, ids from 1 in their
    order.

    sub_from_native shifts by whole pixels: the principal point is (cx - x0, cy - y0) of the stored
    rectangle, and so are the observations inside it. With overlap one native observation is in
    several sub-images.
    """
    model = pycolmap.Reconstruction()
    image_ids = {native.image(i).name: i for i in native.reg_image_ids()}
    seen = _observations(native)
    observations = {}
    sub_id = 0
    for native_image in natives:
        image = native.image(image_ids[native_image.name])
        camera = native.camera(image.camera_id)
        fx, fy, cx, cy = camera.params
        of_image = seen[image.image_id]
        for sub in native_image.sub_images:
            sub_id += 1
            stored = sub.stored
            origin = np.array([stored.x0, stored.y0], float)
            xy = of_image.xy - origin
            inside = ((xy >= 0) & (xy < [stored.width, stored.height])).all(axis=1)
            observations[sub_id] = _Observations(xy[inside], of_image.point_ids[inside])
            model.add_camera_with_trivial_rig(
                pycolmap.Camera(
                    model="PINHOLE",
                    width=stored.width,
                    height=stored.height,
                    params=[fx, fy, cx - stored.x0, cy - stored.y0],
                    camera_id=sub_id,
                )
            )
            _add_image(model, image, sub.name, sub_id, sub_id, xy[inside])
    _add_points(model, native, observations)
    return model


def _observations(model: pycolmap.Reconstruction) -> dict[int, _Observations]:
    """The observations of every image of `model`, in order of the ids of the points."""
    indices = defaultdict[int, list[int]](list)
    point_ids = defaultdict[int, list[int]](list)
    for point_id in sorted(model.point3D_ids()):
        for element in model.point3D(point_id).track.elements:
            indices[element.image_id].append(element.point2D_idx)
            point_ids[element.image_id].append(point_id)
    # A pinhole of unit focal length reads all positions at once: its rays are the pixels.
    reader = pycolmap.Camera(model="PINHOLE", width=1, height=1, params=[1, 1, 0, 0])
    observations = {}
    for image_id in model.images:
        points2d = model.image(image_id).points2D
        xy = reader.cam_from_img(points2d) if len(points2d) else np.empty((0, 2))
        chosen = np.array(indices[image_id], np.int64)
        observations[image_id] = _Observations(
            xy[chosen].reshape(-1, 2), np.array(point_ids[image_id], np.uint64)
        )
    return observations


def _add_image(
    model: pycolmap.Reconstruction,
    posed: pycolmap.Image,
    name: str,
    camera_id: int,
    image_id: int,
    xy: NDArray[np.float64],
) -> None:
    image = pycolmap.Image(name=name, keypoints=xy, camera_id=camera_id, image_id=image_id)
    model.add_image_with_trivial_frame(image, posed.cam_from_world())


def _add_points(
    model: pycolmap.Reconstruction,
    source: pycolmap.Reconstruction,
    observations: dict[int, _Observations],
) -> None:
    """Adds the points of `source` that `observations` (by image id) still see, with their
    tracks."""
    tracks = defaultdict[int, pycolmap.Track](pycolmap.Track)
    for image_id, of_image in observations.items():
        for index, point_id in enumerate(of_image.point_ids.tolist()):
            tracks[point_id].add_element(image_id, index)
    for point_id in sorted(tracks):
        point = source.point3D(point_id)
        model.add_point3D_with_id(
            point_id,
            pycolmap.Point3D(
                xyz=point.xyz, color=point.color, error=point.error, track=tracks[point_id]
            ),
        )


def write_model(model: pycolmap.Reconstruction, folder: Path) -> None:
    """Writes a binary COLMAP model as a whole: `folder` holds all of it, or what it held before.

    COLMAP 3.8 reads cameras, images and points3D, and passes over the rigs and frames of 4.x.

    Raises:
        OutputError: the folder cannot be written.
    """
    temporary = folder.with_name(f".{folder.name}.{os.getpid()}.tmp")
    try:
        temporary.mkdir(parents=True)
        model.write_binary(temporary)
        shutil.rmtree(folder, ignore_errors=True)
        temporary.rename(folder)
    except (OSError, ValueError, RuntimeError) as error:
        raise OutputError(
            f"cannot write the model {folder}: {error}; free some space or choose another output "
            "folder, then run the same command again"
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
