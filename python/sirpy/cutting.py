"""Recapture: photographs of a sparse model are undistorted and cut into sub-images, with their
models."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Literal, get_args

import pycolmap

from sirpy import _core
from sirpy.area import AreaFilter
from sirpy.errors import InputError
from sirpy.files import file_identity, fingerprint
from sirpy.layout import Layout, Region
from sirpy.lens import Undistortion, UndistortOptions, undistorted_camera, undistortion
from sirpy.model_arrays import SparseModel, read_arrays, write_model
from sirpy.model_files import model_identity
from sirpy.native_scene import native_scene
from sirpy.photographs import (
    Bands,
    Encoding,
    Interpolation,
    Photograph,
    check_folders,
    check_names,
    open_photograph,
    recapture_to_files,
    white_level,
)
from sirpy.planning import plan
from sirpy.progress import Progress
from sirpy.rectangle import Grid
from sirpy.sub_image_model import sub_image_model, undistorted_model
from sirpy.sub_image_sets import of_one_size, with_points
from sirpy.workspace import LeftOut, NativeImage, Workspace, check_writable

Format = Literal["jpg", "png", "tif"]

# To be raised when the same inputs and options begin to give other files.
_VERSION = 2


@dataclass(frozen=True)
class PixelOptions:
    """How pixels are read, resampled and written."""

    bands: Bands = "color"
    """"color": grey or RGB; "all": alpha and infrared too."""
    interpolation: Interpolation = "bilinear"
    """Between the pixels of a photograph; without lens distortion nothing is resampled."""
    format: Format | None = None
    """Of the sub-images; None keeps JPEG, and makes PNG of everything else, TIFF where PNG cannot
    hold the bands. 16 bit stays 16 bit."""
    encoding: Encoding = field(default_factory=Encoding)

    def __post_init__(self) -> None:
        for name, value, choices in (
            ("bands", self.bands, get_args(Bands)),
            ("interpolation", self.interpolation, get_args(Interpolation)),
            ("format", self.format, (None, *get_args(Format))),
        ):
            if value not in choices:
                known = ", ".join(str(choice) for choice in choices if choice)
                raise InputError(f"{name} = {value!r} is not possible: it must be one of {known}")

    def extension(self, photograph: Photograph) -> str:
        """Of the sub-images of a photograph. Raises InputError where `format` cannot hold it."""
        possible = {
            "jpg": photograph.bits == 8 and photograph.channels in (1, 3),
            "png": photograph.channels in (1, 3) or (photograph.channels <= 4 and photograph.alpha),
            "tif": True,
        }
        if self.format is None:
            if photograph.format == "JPEG":
                return "jpg"
            return "png" if possible["png"] else "tif"
        if not possible[self.format]:
            bits, channels = photograph.bits, photograph.channels
            raise InputError(
                f"{photograph.path} has {channels} channels of {bits} bits, which a {self.format} "
                "cannot hold: choose tif, leave the format out, or convert it to 8-bit RGB"
            )
        return self.format


@dataclass(frozen=True)
class _Task:
    """One photograph, its camera in the model, its mask, and how its undistorted image is cut."""

    photograph: Photograph
    camera: pycolmap.Camera
    native: NativeImage
    mask: Photograph | None


def cut(
    images: Path | str,
    model: Path | str | pycolmap.Reconstruction | SparseModel,
    output: Path | str,
    *,
    grid: Grid | None = None,
    memory: int | None = None,
    identity: str | None = None,
    overlap: int = 0,
    region: Region = Region(),
    same_size: int = 0,
    min_points: int = 0,
    masks: Path | str | None = None,
    pixels: PixelOptions = PixelOptions(),
    undistort: UndistortOptions = UndistortOptions(),
    progress: Progress = Progress(),
) -> Workspace:
    """Undistorts the photographs of `model`, cuts them into sub-images and writes the workspace.

    A photograph that is missing or damaged is left out of the images and the models, and reported
    by `progress.note` and `Workspace.left_out`. A run that was killed is continued by the same
    call.

    Args:
        images: folder that the names of the model are relative to.
        model: COLMAP model of the photographs, in native pixels: its folder, or read already.
        output: folder of the workspace.
        grid: columns x rows of sub-images of each photograph; the coarsest for `memory` if None.
        memory: bytes that all later stages may take; None for no bound.
        identity: tells whether a model that was read already is the same as in an earlier run.
        overlap: extra pixels on each side of a sub-image.
        region: what of the photographs is cut; all of it by default.
        same_size: with n > 0 the files have one size, a multiple of n pixels, by more overlap; as
            far as the photographs are large enough.
        min_points: sub-images that see fewer sparse points are left out, said by `progress.note`.
        masks: folder of masks, black where a photograph is not to be used: NAME.png for the
            photograph NAME, as COLMAP names them. They are undistorted and cut with it.

    Raises:
        InputError: nothing was written: no usable photograph, a grid larger than an image, a
            region outside an image, an unsafe name, a bad option.
        OutputError: the output folder cannot be written.
    """
    images, output = Path(images), Path(output)
    if same_size < 0:
        raise InputError(f"same_size = {same_size} is not possible: it must be at least 0 pixels")
    if min_points < 0:
        raise InputError(f"min_points = {min_points} is not possible: it must be at least 0")
    check_folders(images, output)
    if isinstance(model, (str, Path)):
        identity = model_identity(Path(model))
    elif identity is None:
        raise ValueError("a model that was read already needs an identity")
    if not isinstance(model, SparseModel):
        model = read_arrays(model)
    seeing = None
    if grid is None or region.area is not None:
        scene = native_scene(undistorted_model(model, undistort))
        if region.area is not None:
            seeing = AreaFilter(region.area, scene)
        if grid is None:
            grid = plan(scene, memory=memory, overlap=overlap, region=region, images=images).grid
        del scene
    inputs = _Inputs(images, None if masks is None else Path(masks), pixels)
    layout = Layout(grid, overlap, region)
    tasks, left_out = _check_inputs(inputs, model, layout, seeing, undistort)
    del seeing
    if region.area is not None:
        count = sum(len(task.native.sub_images) for task in tasks)
        progress.note(f"area: {len(tasks)} photographs see it, in {count} sub-images")
    if same_size:
        tasks = _of_natives(tasks, of_one_size([task.native for task in tasks], same_size))
    if min_points:
        scene = native_scene(undistorted_model(model, undistort))
        kept, dropped = with_points([task.native for task in tasks], scene, min_points)
        del scene
        tasks = _of_natives(tasks, kept)
        if dropped:
            progress.note(
                f"{len(dropped)} sub-images see fewer than {min_points} sparse points and are left "
                f"out ({', '.join(dropped[:3])}{' ...' if len(dropped) > 3 else ''})"
            )
    workspace = Workspace(output)
    _check_apart(images, workspace)
    check_writable(output)
    begun = workspace.begin_stage(
        "cut",
        fingerprint(
            _VERSION,
            identity,
            [(asdict(task.native), file_identity(task.photograph.path)) for task in tasks],
            [task.mask and file_identity(task.mask.path) for task in tasks],
            [out.name for out in left_out],
            asdict(pixels),
            asdict(undistort),
        ),
    )
    if begun and _is_complete(workspace):
        progress.note(f"cut: {len(workspace.natives)} photographs are cut already")
        return workspace
    for out in left_out:
        progress.note(f"{out.name} is left out: {out.reason}")
    natives, damaged = _cut_photographs(tasks, workspace, pixels, undistort, progress)
    left_out = sorted(left_out + damaged, key=lambda out: out.name)
    if not natives:
        raise _nothing_left(left_out)
    native_model = undistorted_model(model, undistort, [native.name for native in natives])
    write_model(native_model, workspace.native_model)
    write_model(sub_image_model(native_model, natives), workspace.sparse)
    workspace.write_index(natives, left_out)
    return workspace


@dataclass(frozen=True)
class _Inputs:
    """Where photographs and masks are, and how they are read."""

    images: Path
    masks: Path | None
    pixels: PixelOptions

    def __post_init__(self) -> None:
        if not self.images.is_dir():
            raise InputError(
                f"there is no folder {self.images}: give the folder that holds the photographs"
            )
        if self.masks is not None and not self.masks.is_dir():
            raise InputError(
                f"there is no folder {self.masks}: give the folder that holds the masks"
            )

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


def _of_natives(tasks: list[_Task], natives: list[NativeImage]) -> list[_Task]:
    """The tasks of `natives`, cut as those say."""
    by_name = {native.name: native for native in natives}
    return [
        replace(task, native=by_name[task.native.name])
        for task in tasks
        if task.native.name in by_name
    ]


def _check_inputs(
    inputs: _Inputs,
    model: SparseModel,
    layout: Layout,
    seeing: AreaFilter | None,
    undistort: UndistortOptions,
) -> tuple[list[_Task], list[LeftOut]]:
    """What is to be done, in order of names, and the photographs that cannot be used.

    `seeing` takes away the sub-images that do not see the area of the layout's region, if it has one.
    """
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
        tasks.append(_Task(photograph, camera, replace(native, masked=mask is not None), mask))
    if seeing is not None and not tasks and not left_out:
        raise seeing.nothing_left()
    if not tasks:
        raise _nothing_left(left_out)
    return tasks, left_out


def _nothing_left(left_out: list[LeftOut]) -> InputError:
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


def _check_apart(images: Path, workspace: Workspace) -> None:
    """Photographs must not lie where the sub-images go: those are removed when options change."""
    source, target = images.resolve(), workspace.images.resolve()
    if source.is_relative_to(target) or target == source:
        raise InputError(
            f"the photographs in {images} lie where the sub-images would be written: choose "
            "another output folder"
        )


def _is_complete(workspace: Workspace) -> bool:
    """The index is written last, so it says that everything was whole; has anyone removed a file
    since?"""
    if not workspace.index.exists():
        return False
    return all(path.exists() for one in workspace.natives for path in _paths(one, workspace))


def _cut_photographs(
    tasks: list[_Task],
    workspace: Workspace,
    pixels: PixelOptions,
    undistort: UndistortOptions,
    progress: Progress,
) -> tuple[list[NativeImage], list[LeftOut]]:
    """The natives that were cut, now or by an earlier run, and the photographs that are damaged."""
    natives, damaged = [], []
    lens: tuple[int, Undistortion] | None = None
    with progress.stage("cut", len(tasks), "photograph") as steps:
        for task in tasks:
            try:
                if not all(path.exists() for path in _paths(task.native, workspace)):
                    # Neighbours mostly share a camera; keeping one lens bounds the memory.
                    if lens is None or lens[0] != task.camera.camera_id:
                        lens = task.camera.camera_id, undistortion(task.camera, undistort)
                    _cut_photograph(task, workspace, pixels, lens[1].lens, progress)
                natives.append(replace(task.native, white=white_level(task.photograph)))
            except InputError as error:
                for path in _paths(task.native, workspace):
                    path.unlink(missing_ok=True)
                damaged.append(LeftOut(task.native.name, str(error)))
                progress.note(f"{task.native.name} is left out: {error}")
            steps.advance()
    return natives, damaged


def _paths(native: NativeImage, workspace: Workspace) -> list[Path]:
    """The files that are cut of a native image."""
    paths = [workspace.image(sub) for sub in native.sub_images]
    return paths + [workspace.mask(sub) for sub in native.sub_images if native.masked]


def _cut_photograph(
    task: _Task,
    workspace: Workspace,
    pixels: PixelOptions,
    lens: _core.LensMap | None,
    progress: Progress,
) -> None:
    if task.photograph.note:
        progress.note(task.photograph.note)
    native = task.native
    size = native.width, native.height
    recapture_to_files(
        task.photograph,
        lens,
        size,
        [(workspace.image(sub), sub.stored) for sub in native.sub_images],
        interpolation=pixels.interpolation,
        encoding=pixels.encoding,
    )
    if task.mask is not None:
        masks = [(workspace.mask(sub), sub.stored) for sub in native.sub_images]
        recapture_to_files(task.mask, lens, size, masks, interpolation="nearest")
