"""Which way is up in a model, and its frame while nobody has said where on the Earth it lies."""

from __future__ import annotations

import math

import numpy as np

from sirpy.frame import Floats, Frame
from sirpy.native_scene import NativeScene

_LEVEL = 0.26  # sine of 15 degrees: how far from level cameras are held, rms
_UPRIGHT = 0.6  # cosine of 53 degrees
_HEADINGS = (
    0.1  # mean square of the second direction of the images' rows: they show the horizon's plane
)
_CLEARLY_LEVEL = 0.02  # mean square of the third
_SLOPE = math.cos(math.radians(15))  # up to which the ground itself says which way is up
_ONE_SIDE = 0.9  # share of the cameras
_ROUNDS = 10
_OUTLIER = 3.0  # times the median distance from the plane, divided by that of a sigma
_MEDIAN_OF_SIGMA = 0.6745
_GROUND = 25  # percentile of the heights: below roofs and trees, above stray points


def local_frame(scene: NativeScene) -> tuple[Frame, str]:
    """A frame without a CRS in the unit of the model, z up; and in words what it is.

    A model whose z is up already, as that of every model that comes from a survey, is left as it is to the
    last digit: its cameras look down or are held upright (53 degrees), with the rows or columns of their
    images level (15 degrees). Any other model, such as one from structure from motion alone, is turned so that
    `up_direction` is z and its x axis seen from above stays, and shifted in z alone: the ground, a quarter of
    the way up through the heights of the sparse points, is at 0.
    """
    if is_z_up(scene):
        return Frame(), "the frame of the products is that of the model, whose z is up already"
    up = up_direction(scene)
    axis = np.eye(3)[0 if abs(up[0]) < 0.9 else 1]
    x = axis - (axis @ up) * up
    x /= np.linalg.norm(x)
    rotation = np.array([x, np.cross(up, x), up])
    ground = float(np.percentile(scene.points @ up, _GROUND)) if len(scene.points) else 0.0
    return (
        Frame(None, 1.0, rotation, np.array([0.0, 0.0, -ground])),
        "the products are in a local frame: z up, the ground at 0, lengths in the unit of the model",
    )


def is_z_up(scene: NativeScene) -> bool:
    """Whether the model's z axis is up, as far as its cameras tell."""
    _, right, down, forward = _cameras(scene)
    level = np.minimum(np.abs(right[:, 2]), np.abs(down[:, 2]))
    upright = np.maximum(-forward[:, 2], -down[:, 2])
    return bool(np.sqrt((level**2).mean()) < _LEVEL and upright.mean() > _UPRIGHT)


def up_direction(scene: NativeScene) -> Floats:
    """The unit vector (3,) of the model that is up.

    It is square to the plane of the sparse points, on the side of the cameras. Where the rows of level images
    say that this plane is a slope of more than 15 degrees, or a wall, what is square to them is up; where
    there are cameras on both sides of the plane, too. A wall seen by one row of cameras is taken for ground.
    """
    centres, right, down, forward = _cameras(scene)
    shares, axes = np.linalg.eigh(right.T @ right / len(right))
    # Of a camera that looks down, is held upright, or anything between, this has an upward part.
    upwards = -(down + forward).mean(axis=0)
    level = axes[:, 0] if axes[:, 0] @ upwards >= 0 else -axes[:, 0]
    if len(scene.points) < 3:
        return level
    middle, normal = _plane(scene.points)
    above = (centres - middle) @ normal
    if (above > 0).mean() < 0.5:
        above, normal = -above, -normal
    clear = shares[1] > _HEADINGS and shares[0] < _CLEARLY_LEVEL
    steep = clear and normal @ level < _SLOPE
    return level if steep or (above > 0).mean() < _ONE_SIDE else normal


def mean_upward(scene: NativeScene) -> Floats:
    """A vector (3,) of the model with an upward part, unless the cameras look at the sky or stand on their
    heads."""
    _, _, down, forward = _cameras(scene)
    upwards: Floats = -(down + forward).mean(axis=0)
    return upwards


def _cameras(scene: NativeScene) -> tuple[Floats, Floats, Floats, Floats]:
    """Centres, and the axes right, down and forward of the images in the model, (n, 3) each."""
    cameras = list(scene.cameras.values())
    axes = np.array([camera.cam_from_world[:, :3] for camera in cameras])
    return np.array([camera.centre for camera in cameras]), axes[:, 0], axes[:, 1], axes[:, 2]


def _plane(points: Floats) -> tuple[Floats, Floats]:
    """A point of the plane and its normal, without the points that lie far from it."""
    kept = points
    for _ in range(_ROUNDS):
        middle = np.median(kept, axis=0)
        covariance = np.cov((kept - middle).T)
        normal = np.linalg.eigh(covariance)[1][:, 0]
        away = np.abs((points - middle) @ normal)
        near = points[away <= _OUTLIER * np.median(away) / _MEDIAN_OF_SIGMA]
        if len(near) < 3 or len(near) == len(kept):
            break
        kept = near
    return middle, normal
