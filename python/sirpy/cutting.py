"""Recapture: photographs of a sparse model are undistorted and cut into sub-images, with their
models."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

import pycolmap

from sirpy.area import AreaFilter
from sirpy.errors import InputError
from sirpy.files import file_identity, fingerprint
from sirpy.layout import Layout, Region
from sirpy.lens import Undistortion, UndistortOptions, undistorted_camera, undistortion
from sirpy.model_files import model_identity, read_model
from sirpy.native_scene import native_scene
from sirpy.photographs import (
    Photograph,
    check_folders,
    check_names,
    open_photograph,
    recapture_photograph,
)
from sirpy.planning import plan
from sirpy.progress import Progress
from sirpy.rectangle import Grid
from sirpy.sub_image_model import sub_image_model, undistorted_model, write_model
from sirpy.workspace import LeftOut, NativeImage, Workspace, check_writable

Format = Literal["jpg", "png"]

# To be raised when the same inputs and options begin to give other files.
_VERSION = 2


@dataclass(frozen=True)
class _Task:
    """One photograph, its camera in the model, and how its undistorted image is cut."""

    photograph: Photograph
    camera: pycolmap.Camera
    native: NativeImage


def cut(
    images: Path | str,
    model: Path | str | pycolmap.Reconstruction,
    output: Path | str,
    *,
    grid: Grid | None = None,
    memory: int | None = None,
    identity: str | None = None,
    overlap: int = 0,
    region: Region = Region(),
    format: Format | None = None,
    jpeg_quality: int = 95,
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
        format: of the sub-images; None keeps JPEG and PNG, and makes PNG of everything else.
        jpeg_quality: 1 to 100.

    Raises:
        InputError: nothing was written: no usable photograph, a size that differs from its
        camera's, a
            grid larger than an image, an unsafe name, a bad option, a region outside an image.
        OutputError: the output folder cannot be written.
    """
    images, output = Path(images), Path(output)
    _check_options(format, jpeg_quality)
    check_folders(images, output)
    if not isinstance(model, pycolmap.Reconstruction):
        identity = model_identity(Path(model))
        model = read_model(model)
    elif identity is None:
        raise ValueError("a model that was read already needs an identity")
    seeing = None
    if grid is None or region.area is not None:
        scene = native_scene(undistorted_model(model, undistort))
        if region.area is not None:
            seeing = AreaFilter(region.area, scene)
        if grid is None:
            grid = plan(scene, memory=memory, overlap=overlap, region=region, images=images).grid
        del scene
    layout = Layout(grid, overlap, region)
    tasks, left_out = _check_inputs(images, model, layout, seeing, format, undistort)
    del seeing
    if region.area is not None:
        count = sum(len(task.native.sub_images) for task in tasks)
        progress.note(f"area: {len(tasks)} photographs see it, in {count} sub-images")
    workspace = Workspace(output)
    _check_apart(images, workspace)
    check_writable(output)
    begun = workspace.begin_stage(
        "cut",
        fingerprint(
            _VERSION,
            identity,
            [(asdict(task.native), file_identity(task.photograph.path)) for task in tasks],
            [out.name for out in left_out],
            [format, jpeg_quality],
            asdict(undistort),
        ),
    )
    if begun and _is_complete(workspace):
        progress.note(f"cut: {len(workspace.natives)} photographs are cut already")
        return workspace
    for out in left_out:
        progress.note(f"{out.name} is left out: {out.reason}")
    natives, damaged = _cut_photographs(tasks, workspace, jpeg_quality, undistort, progress)
    left_out = sorted(left_out + damaged, key=lambda out: out.name)
    if not natives:
        raise _nothing_left(left_out)
    native_model = undistorted_model(model, undistort, [native.name for native in natives])
    write_model(native_model, workspace.native_model)
    write_model(sub_image_model(native_model, natives), workspace.sparse)
    workspace.write_index(natives, left_out)
    return workspace


def _check_options(format: str | None, jpeg_quality: int) -> None:
    if format not in (None, "jpg", "png"):
        raise InputError(f"format = {format!r} is not possible: it must be 'jpg' or 'png'")
    if not 1 <= jpeg_quality <= 100:
        raise InputError(f"jpeg_quality = {jpeg_quality} is not possible: it must be 1 to 100")


def _check_inputs(
    images: Path,
    model: pycolmap.Reconstruction,
    layout: Layout,
    seeing: AreaFilter | None,
    format: Format | None,
    undistort: UndistortOptions,
) -> tuple[list[_Task], list[LeftOut]]:
    """What is to be done, in order of names, and the photographs that cannot be opened.

    `seeing` takes away the sub-images that do not see the area of the layout's region, if it has one.
    """
    posed = sorted((model.image(i) for i in model.reg_image_ids()), key=lambda image: image.name)
    if not posed:
        raise InputError("the model has no image with a pose: solve the cameras again")
    if not images.is_dir():
        raise InputError(f"there is no folder {images}: give the folder that holds the photographs")
    names = [image.name for image in posed]
    check_names(names)
    layout.check_names(names)
    stems = _stems(names)
    targets = {
        camera_id: undistorted_camera(model.camera(camera_id), undistort)
        for camera_id in sorted({image.camera_id for image in posed})
    }
    tasks, left_out = [], []
    for image in posed:
        camera, target = model.camera(image.camera_id), targets[image.camera_id]
        native = layout.native_image(image.name, (target.width, target.height))
        if seeing is not None:
            native = seeing(native)
            if not native.sub_images:
                continue
        try:
            photograph = open_photograph(images / image.name)
        except InputError as error:
            left_out.append(LeftOut(image.name, str(error)))
            continue
        if (photograph.width, photograph.height) != (camera.width, camera.height):
            raise InputError(
                f"photograph {photograph.path} has {photograph.width}x{photograph.height} pixels, "
                f"but its camera {camera.camera_id} in the model {camera.width}x{camera.height}: "
                "give the photographs that the model was solved with, or solve it again"
            )
        extension = format or ("jpg" if photograph.format == "JPEG" else "png")
        native = layout.named(native, stems[image.name], extension)
        tasks.append(_Task(photograph, camera, native))
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
    return all(workspace.image(sub).exists() for _, sub in workspace.sub_images())


def _cut_photographs(
    tasks: list[_Task],
    workspace: Workspace,
    jpeg_quality: int,
    undistort: UndistortOptions,
    progress: Progress,
) -> tuple[list[NativeImage], list[LeftOut]]:
    """The natives that were cut, now or by an earlier run, and the photographs that are damaged."""
    natives, damaged = [], []
    lens: tuple[int, Undistortion] | None = None
    with progress.stage("cut", len(tasks), "photograph") as steps:
        for task in tasks:
            if not all(workspace.image(sub).exists() for sub in task.native.sub_images):
                # Neighbours mostly share a camera; keeping one lens bounds the memory.
                if lens is None or lens[0] != task.camera.camera_id:
                    lens = task.camera.camera_id, undistortion(task.camera, undistort)
                try:
                    _cut_photograph(task, workspace, jpeg_quality, lens[1], progress)
                except InputError as error:
                    for sub in task.native.sub_images:
                        workspace.image(sub).unlink(missing_ok=True)
                    damaged.append(LeftOut(task.native.name, str(error)))
                    progress.note(f"{task.native.name} is left out: {error}")
                    steps.advance()
                    continue
            natives.append(task.native)
            steps.advance()
    return natives, damaged


def _cut_photograph(
    task: _Task,
    workspace: Workspace,
    jpeg_quality: int,
    how: Undistortion,
    progress: Progress,
) -> None:
    if task.photograph.note:
        progress.note(task.photograph.note)
    files = [
        (
            workspace.image(sub),
            sub.stored.x0,
            sub.stored.y0,
            sub.stored.width,
            sub.stored.height,
        )
        for sub in task.native.sub_images
    ]
    size = task.native.width, task.native.height
    recapture_photograph(task.photograph, how.lens, size, files, jpeg_quality)
