"""Recapture: photographs of a sparse model are undistorted and cut into sub-images, with their
models."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path, PurePosixPath

import pycolmap

from sirpy.engine_options import ImageFormat
from sirpy.errors import InputError
from sirpy.files import file_identity, fingerprint
from sirpy.lens import Undistortion, UndistortOptions, undistorted_camera, undistortion
from sirpy.model_files import model_identity, read_model
from sirpy.native_scene import NativeScene, native_scene
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
from sirpy.view_selection import points_seen
from sirpy.workspace import LeftOut, NativeImage, SubImage, Workspace, check_writable

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
    same_size: int = 0,
    min_points: int = 0,
    format: ImageFormat | None = None,
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
        same_size: with n > 0 the files have one size, a multiple of n pixels, by more overlap; as
            far as the photographs are large enough.
        min_points: sub-images that see fewer sparse points are left out, said by `progress.note`.
        format: of the sub-images; None keeps JPEG and PNG, and makes PNG of everything else.
        jpeg_quality: 1 to 100.

    Raises:
        InputError: nothing was written: no usable photograph, a size that differs from its
        camera's, a
            grid larger than an image, an unsafe name, a bad option.
        OutputError: the output folder cannot be written.
    """
    images, output = Path(images), Path(output)
    _check_options(overlap, same_size, min_points, format, jpeg_quality)
    check_folders(images, output)
    if not isinstance(model, pycolmap.Reconstruction):
        identity = model_identity(Path(model))
        model = read_model(model)
    elif identity is None:
        raise ValueError("a model that was read already needs an identity")
    if grid is None:
        grid = plan(native_scene(undistorted_model(model, undistort)), memory=memory).grid
    tasks, left_out = _check_inputs(images, model, grid, overlap, format, undistort)
    if same_size:
        natives = of_one_size([task.native for task in tasks], same_size)
        tasks = [replace(task, native=native) for task, native in zip(tasks, natives, strict=True)]
    if min_points:
        scene = native_scene(undistorted_model(model, undistort))
        tasks = _with_points(tasks, scene, min_points, progress)
    workspace = Workspace(output)
    _check_apart(images, workspace)
    check_writable(output)
    begun = workspace.begin_stage(
        "cut",
        fingerprint(
            _VERSION,
            identity,
            [(task.native.name, file_identity(task.photograph.path)) for task in tasks],
            [out.name for out in left_out],
            [grid.columns, grid.rows, overlap, same_size, min_points, format, jpeg_quality],
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


def of_one_size(natives: list[NativeImage], multiple: int) -> list[NativeImage]:
    """The native images with stored rectangles of one size, a multiple of `multiple` pixels.

    The smallest such size that holds every stored rectangle; where a native image is smaller, its side.
    """
    stored = [sub.stored for native in natives for sub in native.sub_images]
    width = -(-max(one.width for one in stored) // multiple) * multiple
    height = -(-max(one.height for one in stored) // multiple) * multiple
    return [
        replace(
            native,
            sub_images=tuple(
                replace(sub, stored=sub.stored.grown(width, height, native.rectangle))
                for sub in native.sub_images
            ),
        )
        for native in natives
    ]


def _with_points(
    tasks: list[_Task], scene: NativeScene, min_points: int, progress: Progress
) -> list[_Task]:
    """The tasks without the sub-images that see fewer sparse points."""
    kept, dropped = [], []
    for task in tasks:
        native = task.native
        seen = [points_seen(scene, native.name, sub.stored) for sub in native.sub_images]
        dropped += [
            sub.name for sub, n in zip(native.sub_images, seen, strict=True) if n < min_points
        ]
        subs = tuple(sub for sub, n in zip(native.sub_images, seen, strict=True) if n >= min_points)
        if subs:
            kept.append(replace(task, native=replace(native, sub_images=subs)))
    if not kept:
        raise InputError(
            f"no sub-image sees {min_points} sparse points: ask for fewer, or for larger sub-images"
        )
    if dropped:
        progress.note(
            f"{len(dropped)} sub-images see fewer than {min_points} sparse points and are left out "
            f"({', '.join(dropped[:3])}{' ...' if len(dropped) > 3 else ''})"
        )
    return kept


def _check_options(
    overlap: int, same_size: int, min_points: int, format: str | None, jpeg_quality: int
) -> None:
    if overlap < 0:
        raise InputError(f"overlap = {overlap} is not possible: it must be at least 0 pixels")
    if same_size < 0:
        raise InputError(f"same_size = {same_size} is not possible: it must be at least 0 pixels")
    if min_points < 0:
        raise InputError(f"min_points = {min_points} is not possible: it must be at least 0")
    if format not in (None, "jpg", "png"):
        raise InputError(f"format = {format!r} is not possible: it must be 'jpg' or 'png'")
    if not 1 <= jpeg_quality <= 100:
        raise InputError(f"jpeg_quality = {jpeg_quality} is not possible: it must be 1 to 100")


def _check_inputs(
    images: Path,
    model: pycolmap.Reconstruction,
    grid: Grid,
    overlap: int,
    format: ImageFormat | None,
    undistort: UndistortOptions,
) -> tuple[list[_Task], list[LeftOut]]:
    """What is to be done, in order of names, and the photographs that cannot be opened."""
    posed = sorted((model.image(i) for i in model.reg_image_ids()), key=lambda image: image.name)
    if not posed:
        raise InputError("the model has no image with a pose: solve the cameras again")
    if not images.is_dir():
        raise InputError(f"there is no folder {images}: give the folder that holds the photographs")
    names = [image.name for image in posed]
    check_names(names)
    stems = _stems(names)
    targets = {
        camera_id: undistorted_camera(model.camera(camera_id), undistort)
        for camera_id in sorted({image.camera_id for image in posed})
    }
    tasks, left_out = [], []
    for image in posed:
        camera = model.camera(image.camera_id)
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
        target = targets[image.camera_id]
        extension = format or ("jpg" if photograph.format == "JPEG" else "png")
        native = _native_image(image.name, stems[image.name], extension, target, grid, overlap)
        tasks.append(_Task(photograph, camera, native))
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


def _native_image(
    name: str, stem: str, extension: str, camera: pycolmap.Camera, grid: Grid, overlap: int
) -> NativeImage:
    native = NativeImage(name, camera.width, camera.height, ())
    row_digits = max(2, len(str(grid.rows - 1)))
    column_digits = max(2, len(str(grid.columns - 1)))
    sub_images = tuple(
        SubImage(
            f"{stem}_r{row:0{row_digits}}_c{column:0{column_digits}}.{extension}",
            row,
            column,
            core,
            core.padded(overlap).intersection(native.rectangle),
        )
        for row, column, core in grid.cores(camera.width, camera.height)
    )
    return NativeImage(name, camera.width, camera.height, sub_images)


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
