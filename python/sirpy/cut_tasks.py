"""What is to be cut: each photograph of a model with its camera and mask, and the sub-images that it gives."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Literal, get_args

import pycolmap

from sirpy.area import AreaFilter
from sirpy.errors import InputError, first_few
from sirpy.layout import Layout
from sirpy.lens import UndistortOptions, undistorted_camera
from sirpy.model_arrays import SparseModel
from sirpy.native_images import LeftOut, NativeImage
from sirpy.native_scene import NativeScene
from sirpy.photographs import (
    Bands,
    Encoding,
    Interpolation,
    Photograph,
    check_choice,
    check_masks,
    check_names,
    open_photograph,
)
from sirpy.progress import Progress

Format = Literal["jpg", "png", "tif"]


@dataclass(frozen=True)
class PixelOptions:
    """How pixels are read, resampled and written."""

    bands: Bands = "color"
    """"color": grey or RGB; "all": alpha and infrared too."""
    interpolation: Interpolation = "bilinear"
    """Between the pixels of a photograph; without lens distortion nothing is resampled."""
    format: Format | None = None
    """Of the sub-images; None keeps JPEG, and makes PNG of everything else, TIFF where PNG cannot
    hold the bands. 16 bit stays 16 bit, but in a JPEG, where the photograph's white becomes 255."""
    encoding: Encoding = field(default_factory=Encoding)

    def __post_init__(self) -> None:
        check_choice("bands", self.bands, get_args(Bands))
        check_choice("interpolation", self.interpolation, get_args(Interpolation))
        if self.format is not None:
            check_choice("format", self.format, get_args(Format))

    def extension(self, photograph: Photograph) -> str:
        """Of the sub-images of a photograph. Raises InputError where `format` cannot hold it."""
        possible = {
            "jpg": photograph.channels in (1, 3),
            "png": photograph.channels in (1, 3) or (photograph.channels <= 4 and photograph.alpha),
            "tif": True,
        }
        if self.format is None:
            if photograph.format == "JPEG":
                return "jpg"
            return "png" if possible["png"] else "tif"
        if not possible[self.format]:
            raise InputError(
                f"{photograph.path} has {photograph.channels} channels, which a {self.format} cannot "
                "hold: choose tif, or leave --bands all out"
            )
        return self.format


@dataclass(frozen=True)
class CutTask:
    """One photograph, its camera in the model, its mask, and how its undistorted image is cut."""

    photograph: Photograph
    camera: pycolmap.Camera
    native: NativeImage
    mask: Photograph | None

    @property
    def loses_bits(self) -> bool:
        """16 bits become 8: a JPEG has no more."""
        return self.photograph.bits > 8 and self.native.sub_images[0].name.endswith(".jpg")


@dataclass(frozen=True)
class CutInputs:
    """Where photographs and masks are, and how they are read."""

    images: Path
    masks: Path | None
    pixels: PixelOptions

    def __post_init__(self) -> None:
        if not self.images.is_dir():
            raise InputError(
                f"there is no folder {self.images}: give the folder that holds the photographs"
            )
        check_masks(self.masks)

    def photograph(self, name: str, camera: pycolmap.Camera) -> Photograph:
        """Raises InputError when it cannot be used with its camera."""
        return self._of_size(open_photograph(self.images / name, self.pixels.bands), camera)

    def mask(self, name: str, camera: pycolmap.Camera) -> Photograph | None:
        """None where the photograph has no mask; raises InputError as `photograph`."""
        if self.masks is None:
            return None
        # COLMAP appends .png to the name; of a PNG the mask may have the name itself.
        candidates = [f"{name}.png", *([name] if name.lower().endswith(".png") else [])]
        for candidate in candidates:
            if (self.masks / candidate).exists():
                return self._of_size(open_photograph(self.masks / candidate), camera)
        return None

    @staticmethod
    def _of_size(photograph: Photograph, camera: pycolmap.Camera) -> Photograph:
        if (photograph.width, photograph.height) != (camera.width, camera.height):
            raise InputError(
                f"{photograph.path} has {photograph.width}x{photograph.height} pixels, but its "
                f"camera {camera.camera_id} in the model {camera.width}x{camera.height}: give the "
                "photographs that the model was solved with, or solve it again"
            )
        return photograph


def cut_tasks(
    inputs: CutInputs,
    model: SparseModel,
    layout: Layout,
    scene: NativeScene | None,
    undistort: UndistortOptions,
    progress: Progress,
) -> tuple[list[CutTask], list[LeftOut]]:
    """What is to be done, in order of names, and the photographs that cannot be used.

    Where the region of the layout has an area, only sub-images that see it in `scene`.

    Raises:
        InputError: no photograph can be used or sees the area, a name is unsafe or given twice, or the
            layout does not fit an image.
    """
    area = layout.region.area
    seeing = AreaFilter(area, scene) if area is not None and scene is not None else None
    posed = sorted(model.images, key=lambda image: image.name)
    if not posed:
        raise InputError("the model has no image with a pose: solve the cameras again")
    names = [image.name for image in posed]
    check_names(names)
    layout.check_names(names)
    stems = _stems(names)
    targets = {
        camera_id: undistorted_camera(model.cameras[camera_id], undistort)
        for camera_id in sorted({image.camera_id for image in posed})
    }
    tasks, left_out = [], []
    for image in posed:
        camera, target = model.camera_of(image), targets[image.camera_id]
        native = layout.native_image(image.name, (target.width, target.height))
        if seeing is not None:
            native = seeing(native)
            if not native.sub_images:
                continue
        try:
            photograph = inputs.photograph(image.name, camera)
            mask = inputs.mask(image.name, camera)
        except InputError as error:
            left_out.append(LeftOut(image.name, str(error)))
            continue
        native = layout.named(native, stems[image.name], inputs.pixels.extension(photograph))
        tasks.append(CutTask(photograph, camera, replace(native, masked=mask is not None), mask))
    if seeing is not None and not tasks and not left_out:
        raise seeing.nothing_left()
    if not tasks:
        raise nothing_left(left_out)
    if inputs.masks is not None:
        _report_masks(tasks, inputs.masks, progress)
    if seeing is not None:
        count = sum(len(task.native.sub_images) for task in tasks)
        progress.note(f"area: {len(tasks)} photographs see it, in {count} sub-images")
    return tasks, left_out


def _report_masks(tasks: list[CutTask], masks: Path, progress: Progress) -> None:
    """Raises InputError where no photograph has a mask; a misspelt name would go unseen."""
    without = [task.native.name for task in tasks if task.mask is None]
    if len(without) == len(tasks):
        raise InputError(
            f"none of the photographs has a mask in {masks}: name them like {without[0]}.png"
        )
    if without:
        progress.note(
            f"{len(without)} of {len(tasks)} photographs have no mask in {masks}: {first_few(without)}"
        )
    for task in tasks:
        if task.mask is not None and task.mask.note:
            progress.note(f"mask {task.mask.note}")


def of_natives(tasks: list[CutTask], natives: list[NativeImage]) -> list[CutTask]:
    """The tasks of `natives`, cut as those say."""
    by_name = {native.name: native for native in natives}
    return [
        replace(task, native=by_name[task.native.name])
        for task in tasks
        if task.native.name in by_name
    ]


def nothing_left(left_out: list[LeftOut]) -> InputError:
    """What to say when no photograph at all can be used."""
    return InputError(
        f"none of the {len(left_out)} photographs of the model can be used; the first one: "
        f"{left_out[0].reason}"
    )


def _stems(names: list[str]) -> dict[str, str]:
    """The start of the sub-images' names: without extension, unless two photographs differ in it
    only."""
    stems = {name: str(PurePosixPath(name).with_suffix("")) for name in names}
    count = Counter(stems.values())
    stems = {name: stem if count[stem] == 1 else name for name, stem in stems.items()}
    first: dict[str, str] = {}
    for name, stem in stems.items():
        other = first.setdefault(stem, name)
        if other != name:
            raise InputError(
                f"the sub-images of {other} and {name} would have the same names: rename one of "
                "them"
            )
    return stems
