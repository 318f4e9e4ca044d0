"""A sparse model as arrays: what recapture and view selection work on.

Positions are in pixels, the centre of the top-left pixel at (0.5, 0.5). Only keypoints that see a
3D point are here: the others serve no later stage.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from sirpy import _core
from sirpy.errors import InputError
from sirpy.model_files import check_not_empty, find_model, is_binary, read_model

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PosedImage:
    """`pose` is cam_from_world as COLMAP stores it: quaternion w, x, y, z, then translation."""

    image_id: int
    camera_id: int
    name: str
    pose: tuple[float, ...]

    @property
    def cam_from_world(self) -> Floats:
        """(3, 4)."""
        w, x, y, z, *translation = self.pose
        rotation = pycolmap.Rotation3d(np.array([x, y, z, w]))
        rotation.normalize()
        return np.array(pycolmap.Rigid3d(rotation, np.array(translation)).matrix(), order="C")


@dataclass(frozen=True)
class SparseModel:
    """Cameras by id; images, points and observations in the order of the files.

    Image `images[i]` has the observations `seen(i)`: pixels `xy[seen(i)]` (m, 2) of the points with
    the indices `point[seen(i)]` (m,).
    """

    cameras: dict[int, pycolmap.Camera]
    images: tuple[PosedImage, ...]
    point_ids: NDArray[np.uint64]  # (n,)
    points: Floats  # (n, 3), world
    colors: NDArray[np.uint8]  # (n, 3)
    errors: Floats  # (n,) mean reprojection errors in pixels; -1 where COLMAP does not know it
    starts: NDArray[np.int64]  # (len(images) + 1,)
    xy: Floats  # (sum of m, 2)
    point: NDArray[np.int32]  # (sum of m,)

    def seen(self, index: int) -> slice:
        """The observations of `images[index]`."""
        return slice(int(self.starts[index]), int(self.starts[index + 1]))

    def camera_of(self, image: PosedImage) -> pycolmap.Camera:
        return self.cameras[image.camera_id]

    def taking(self, indices: Sequence[int]) -> SparseModel:
        """The model of `images[i] for i in indices`, with their cameras and the points they see."""
        images = tuple(self.images[i] for i in indices)
        used = {image.camera_id for image in images}
        counts = np.diff(self.starts)[list(indices)]
        of_images = [np.arange(self.starts[i], self.starts[i + 1]) for i in indices]
        rows = np.concatenate([np.empty(0, np.int64), *of_images])
        return replace(
            self,
            cameras={i: camera for i, camera in self.cameras.items() if i in used},
            images=images,
            starts=np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]),
            xy=self.xy[rows],
            point=self.point[rows],
        ).with_seen_points()

    def with_seen_points(self) -> SparseModel:
        """This model without the points that no image sees."""
        seen = np.zeros(len(self.point_ids), bool)
        seen[self.point] = True
        index = np.cumsum(seen, dtype=np.int32) - np.int32(1)
        return replace(
            self,
            point_ids=self.point_ids[seen],
            points=self.points[seen],
            colors=self.colors[seen],
            errors=self.errors[seen],
            point=index[self.point],
        )

    def to_core(self) -> _core.Model:
        """As the C++ core takes it."""
        return (
            [
                (
                    i,
                    int(camera.model),
                    camera.width,
                    camera.height,
                    [float(p) for p in camera.params],
                )
                for i, camera in self.cameras.items()
            ],
            [(image.image_id, image.camera_id, image.name, image.pose) for image in self.images],
            self.point_ids,
            self.points,
            self.colors,
            self.errors,
            self.starts,
            self.xy,
            self.point,
        )

    @staticmethod
    def from_core(model: _core.Model) -> SparseModel:
        """What the C++ core gave."""
        cameras, images, point_ids, points, colors, errors, starts, xy, point = model
        return SparseModel(
            {
                camera_id: pycolmap.Camera(
                    camera_id=camera_id,
                    model=pycolmap.CameraModelId(number),
                    width=width,
                    height=height,
                    params=parameters,
                )
                for camera_id, number, width, height, parameters in cameras
            },
            tuple(PosedImage(i, c, name, tuple(pose)) for i, c, name, pose in images),
            point_ids,
            points,
            colors,
            errors,
            starts,
            xy,
            point,
        )


def read_arrays(
    source: Path | str | pycolmap.Reconstruction, *, may_be_empty: bool = False
) -> SparseModel:
    """Reads a COLMAP model: its folder as `read_model` takes it, or one that is in memory.

    Text, and models in memory, take the way through a temporary binary copy.

    Raises:
        InputError: there is no model, it is damaged, or (unless it may be empty) has no images or
            no 3D points.
    """
    if isinstance(source, pycolmap.Reconstruction):
        return _through_a_copy(source, "the model in memory")
    folder = find_model(Path(source))
    if is_binary(folder):
        model = SparseModel.from_core(_core.read_model(folder))
    else:
        model = _through_a_copy(read_model(folder), f"the sparse model in {folder}")
    if not may_be_empty:
        check_not_empty(folder, len(model.images), len(model.points))
    return model


def write_model(model: SparseModel, folder: Path) -> None:
    """Writes a binary COLMAP model as a whole: `folder` holds all of it, or what it held before.

    COLMAP 3.8 reads cameras, images and points3D, and passes over the rigs and frames of 4.x.

    Raises:
        OutputError: the folder cannot be written, holds anything but a model, or is the current one.
    """
    _core.write_model(model.to_core(), folder)


def _through_a_copy(model: pycolmap.Reconstruction, what: str) -> SparseModel:
    with tempfile.TemporaryDirectory(prefix="sirpy-") as folder:
        try:
            model.write_binary(folder)
            return SparseModel.from_core(_core.read_model(Path(folder)))
        except (InputError, OSError, ValueError, RuntimeError) as error:
            raise InputError(
                f"{what} cannot be used, as its copy in the temporary folder says ({error}): "
                "mend the model, or free some space there"
            ) from None
