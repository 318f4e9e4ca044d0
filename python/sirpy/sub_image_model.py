"""COLMAP models of what was cut: the whole undistorted images, and the sub-images.

Every step is linear in the number of observations.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from sirpy import _core
from sirpy.lens import UndistortOptions, moved_between, undistorted_camera
from sirpy.model_arrays import SparseModel
from sirpy.native_images import NativeImage


def undistorted_model(
    model: SparseModel,
    options: UndistortOptions = UndistortOptions(),
    names: Iterable[str] | None = None,
) -> SparseModel:
    """The model of the undistorted native images, with the ids of `model` and PINHOLE cameras.

    Images are in the order of their ids; points that none of them sees are left out.

    Args:
        names: the images to keep; all when None.

    Raises:
        InputError: a camera cannot be undistorted.
    """
    kept = {image.name for image in model.images} if names is None else set(names)
    order = sorted(
        (i for i, image in enumerate(model.images) if image.name in kept),
        key=lambda i: model.images[i].image_id,
    )
    used = sorted({model.images[i].camera_id for i in order})
    cameras = {i: undistorted_camera(model.cameras[i], options) for i in used}
    xy, point = [np.empty((0, 2))], [np.empty(0, np.int32)]
    for i in order:
        camera_id, seen = model.images[i].camera_id, model.seen(i)
        moved = moved_between(model.cameras[camera_id], cameras[camera_id], model.xy[seen])
        # A keypoint that the lens model cannot undistort has no place in a pinhole image.
        finite = np.isfinite(moved).all(axis=1)
        xy.append(moved[finite])
        point.append(model.point[seen][finite])
    return replace(
        model,
        cameras=cameras,
        images=tuple(model.images[i] for i in order),
        starts=np.cumsum([len(of_image) for of_image in point], dtype=np.int64),
        xy=np.concatenate(xy),
        point=np.concatenate(point),
    ).with_seen_points()


def sub_image_model(native: SparseModel, natives: Iterable[NativeImage]) -> SparseModel:
    """The model of the sub-images: one PINHOLE camera and one image each, ids from 1 in their
    order.

    sub_from_native shifts by whole pixels: the principal point is (cx - x0, cy - y0) of the stored
    rectangle, and so are the observations inside it. With overlap one native observation is in
    several sub-images; points that none of them sees are left out.

    Args:
        native: of the undistorted images (see `undistorted_model`).
    """
    index = {image.name: i for i, image in enumerate(native.images)}
    sub_images = [
        (sub.name, index[image.name], stored.x0, stored.y0, stored.width, stored.height)
        for image in natives
        for sub in image.sub_images
        for stored in [sub.stored]
    ]
    return SparseModel.from_core(_core.sub_image_model(native.to_core(), sub_images))
