"""Recapture: photographs of a sparse model are undistorted and cut into sub-images, with their
models."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import pycolmap

from sirpy import _core
from sirpy.cut_tasks import (
    CutInputs,
    CutTask,
    PixelOptions,
    cut_tasks,
    nothing_left,
    of_natives,
)
from sirpy.errors import InputError, first_few
from sirpy.files import file_identity, fingerprint
from sirpy.layout import Layout, Region
from sirpy.left_out import leave_out
from sirpy.lens import Undistortion, UndistortOptions, undistortion
from sirpy.model_arrays import SparseModel, read_arrays, write_model
from sirpy.model_files import find_model, model_identity
from sirpy.native_images import LeftOut, NativeImage
from sirpy.native_scene import NativeScene, native_scene
from sirpy.photographs import check_folders, recapture_to_files, white_level
from sirpy.planning import plan
from sirpy.progress import Progress
from sirpy.rectangle import Grid
from sirpy.stereo_backend import StereoOptions
from sirpy.sub_image_model import sub_image_model, undistorted_model
from sirpy.sub_image_sets import of_one_size, with_points
from sirpy.workspace import Workspace, check_writable

# To be raised when the same inputs and options begin to give other files.
_VERSION = 2


def cut(
    images: Path | str,
    model: Path | str | pycolmap.Reconstruction | SparseModel,
    output: Path | str,
    *,
    grid: Grid | None = None,
    memory: int | None = None,
    stereo: StereoOptions = StereoOptions(),
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
        stereo: the stereo that the grid is chosen for, as in `plan`.
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
    model_folder = find_model(Path(model)) if isinstance(model, (str, Path)) else None
    if model_folder is not None:
        identity = model_identity(model_folder)
    elif identity is None:
        raise ValueError("a model that was read already needs an identity")
    if not isinstance(model, SparseModel):
        model = read_arrays(model)
    workspace = Workspace(output)
    workspace.check_apart("cut", images, model_folder, None if masks is None else Path(masks))
    inputs = CutInputs(images, None if masks is None else Path(masks), pixels)
    layout = Layout(grid or Grid(1, 1), overlap, region)
    scene = None
    if grid is None or region.area is not None or min_points > 0:
        scene = native_scene(undistorted_model(model, undistort))
    if scene is not None and grid is None:
        found = plan(
            scene, memory=memory, overlap=overlap, region=region, images=images, stereo=stereo
        )
        layout = replace(layout, grid=found.grid)
    tasks, left_out = cut_tasks(inputs, model, layout, scene, undistort, progress)
    if same_size:
        tasks = of_natives(tasks, of_one_size([task.native for task in tasks], same_size))
    if scene is not None and min_points > 0:
        tasks = _with_points(tasks, scene, min_points, progress)
    scene = None  # large, and not needed any more
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
        raise nothing_left(left_out)
    native_model = undistorted_model(model, undistort, [native.name for native in natives])
    write_model(native_model, workspace.native_model)
    write_model(sub_image_model(native_model, natives), workspace.sparse)
    workspace.write_index(natives, left_out)
    return workspace


def _with_points(
    tasks: list[CutTask], scene: NativeScene, min_points: int, progress: Progress
) -> list[CutTask]:
    """Without the sub-images that see fewer sparse points, which are reported."""
    kept, dropped = with_points([task.native for task in tasks], scene, min_points)
    if dropped:
        progress.note(
            f"{len(dropped)} sub-images see fewer than {min_points} sparse points and are left "
            f"out ({first_few(dropped)})"
        )
    return of_natives(tasks, kept)


def _is_complete(workspace: Workspace) -> bool:
    """The index is written last, so it says that everything was whole; has anyone removed a file
    since?"""
    models = (workspace.index, workspace.native_model, workspace.sparse)
    if not all(path.exists() for path in models):
        return False
    return all(path.exists() for one in workspace.natives for path in _paths(one, workspace))


def _cut_photographs(
    tasks: list[CutTask],
    workspace: Workspace,
    pixels: PixelOptions,
    undistort: UndistortOptions,
    progress: Progress,
) -> tuple[list[NativeImage], list[LeftOut]]:
    """The natives that were cut, now or by an earlier run, and the photographs that are damaged."""
    natives: list[NativeImage] = []
    damaged: list[LeftOut] = []
    lens: tuple[int, Undistortion] | None = None
    with progress.stage("cut", len(tasks), "photograph") as steps:
        for task in tasks:
            try:
                if not all(path.exists() for path in _paths(task.native, workspace)):
                    # Neighbours mostly share a camera; keeping one lens bounds the memory.
                    if lens is None or lens[0] != task.camera.camera_id:
                        lens = task.camera.camera_id, undistortion(task.camera, undistort)
                    _cut_photograph(task, workspace, pixels, lens[1].lens, progress)
                natives.append(_with_white(task))
            except InputError as error:
                for path in _paths(task.native, workspace):
                    path.unlink(missing_ok=True)
                leave_out(task.native.name, str(error), damaged, progress)
            steps.advance()
    return natives, damaged


def _with_white(task: CutTask) -> NativeImage:
    """Its native image; where 16 bits are kept, with their white."""
    return replace(task.native, white=255 if task.loses_bits else white_level(task.photograph))


def _paths(native: NativeImage, workspace: Workspace) -> list[Path]:
    """The files that are cut of a native image."""
    paths = [workspace.image(sub) for sub in native.sub_images]
    return paths + [workspace.mask(sub) for sub in native.sub_images if native.masked]


def _cut_photograph(
    task: CutTask,
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
        white=white_level(task.photograph) if task.loses_bits else 0,
    )
    if task.mask is not None:
        masks = [(workspace.mask(sub), sub.stored) for sub in native.sub_images]
        recapture_to_files(task.mask, lens, size, masks, interpolation="nearest")
