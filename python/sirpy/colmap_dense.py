"""A dense workspace that COLMAP made, as if it were one of ours: every image is one sub-image of itself."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

from sirpy.errors import InputError
from sirpy.model_arrays import read_arrays
from sirpy.native_images import LeftOut, NativeImage, SubImage
from sirpy.rectangle import Rectangle
from sirpy.workspace import Workspace

_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")


def open_workspace(folder: Path | str) -> Workspace:
    """The workspace in a folder, ours or COLMAP's (images/, sparse/, stereo/depth_maps/)."""
    workspace = Workspace(folder)
    if not workspace.index.exists() and workspace.stereo_folder("depth_maps").is_dir():
        return ColmapDense(folder)
    return workspace


class ColmapDense(Workspace):
    """Images, PINHOLE cameras and maps of one name and size; sources are chosen when they are asked for."""

    @property
    def native_model(self) -> Path:
        return self.sparse

    @property
    def has_views(self) -> bool:
        return False

    @cached_property
    def _index(self) -> tuple[tuple[NativeImage, ...], tuple[LeftOut, ...]]:
        model = read_arrays(self.sparse)
        natives = []
        for image in sorted(model.images, key=lambda image: image.name):
            camera = model.camera_of(image)
            if camera.model.name not in _PINHOLES:
                raise InputError(
                    f"the camera of {image.name} in {self.sparse} is {camera.model.name}: depth maps need "
                    "undistorted images; run COLMAP's image_undistorter"
                )
            whole = Rectangle(0, 0, camera.width, camera.height)
            sub_image = SubImage(image.name, 0, 0, whole, whole)
            natives.append(NativeImage(image.name, camera.width, camera.height, (sub_image,)))
        return tuple(natives), ()
