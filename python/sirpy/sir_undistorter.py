"""`colmap sir_undistorter`: COLMAP's image_undistorter with recapture, on COLMAP's own option
names.

The output is the workspace of COLMAP's dense stereo (images, sparse, stereo, run scripts), or what
another engine reads, with sub-images in place of photographs.
"""

from __future__ import annotations

import os
import sys
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from sirpy.errors import InputError, SirpyError
from sirpy.progress import Progress, make_progress
from sirpy.rectangle import Grid, Rectangle
from sirpy.undistorter_options import Options, parse

if TYPE_CHECKING:
    from sirpy.layout import Region
    from sirpy.lens import UndistortOptions
    from sirpy.model_arrays import SparseModel

_EXIT_USER_ERROR = 2


def main(arguments: list[str]) -> int:
    """Runs the command; the exit status: 0, or 2 after one sentence about what to mend."""
    try:
        options = parse(arguments)
        for note in options.notes:
            print(note, file=sys.stderr)
        sir_undistorter(options, make_progress(quiet=False))
    except SirpyError as error:
        print(f"colmap sir_undistorter: {error}", file=sys.stderr)
        return _EXIT_USER_ERROR
    return 0


def sir_undistorter(options: Options, progress: Progress) -> None:
    """Undistorts and cuts the photographs, and writes what the engine reads.

    Raises:
        InputError, OutputError, BudgetError: as `cutting.cut`, or no plan meets the memory.
    """
    if options.num_threads > 0:
        os.environ["OMP_NUM_THREADS"] = str(options.num_threads)  # read when the core is loaded
    from sirpy.clustering import clusters
    from sirpy.cut_tasks import PixelOptions
    from sirpy.cutting import cut
    from sirpy.exporting import export
    from sirpy.files import fingerprint
    from sirpy.layout import read_region
    from sirpy.lens import UndistortOptions
    from sirpy.model_arrays import read_arrays
    from sirpy.model_files import model_identity
    from sirpy.photographs import Encoding

    undistort = UndistortOptions(
        **{field.name: getattr(options, field.name) for field in fields(UndistortOptions)}
    )
    region = read_region(
        options.sub_image_roi,
        options.sub_image_roi_list,
        options.area,
        options.area_crs,
        options.model_crs,
    )
    names = _listed_names(options.image_list_path)
    model = read_arrays(options.input_path)
    if names is not None:
        model = _only_listed(model, names, options)
    workspace = cut(
        options.image_path,
        model,
        options.output_path,
        identity=fingerprint(model_identity(options.input_path), names),
        grid=_grid(options, model, undistort, region),
        overlap=options.sub_image_overlap,
        region=region,
        same_size=_size_multiple(options.output_type),
        min_points=options.min_points if options.few_points == "drop" else 0,
        masks=options.mask_path,
        pixels=PixelOptions(
            options.bands,
            options.interpolation,
            options.image_format,
            Encoding(options.jpeg_quality, options.jpeg_chroma),
        ),
        undistort=undistort,
        progress=progress,
    )
    if options.cluster_size is not None:
        clusters(workspace, cluster_size=options.cluster_size, progress=progress)
    else:
        workspace.remove_clusters()
    export(
        workspace,
        options.output_type,
        num_sources=options.num_patch_match_src_images,
        min_points=options.min_points,
        mvsnet_depths=options.mvsnet_depths,
        copy_policy=options.copy_policy or "hard-link",
        progress=progress,
    )
    if workspace.left_out:
        raise InputError(
            f"{workspace.folder} is made without {len(workspace.left_out)} of the photographs "
            f"({'; '.join(f'{out.name}: {out.reason}' for out in workspace.left_out[:3])})"
        )


def _size_multiple(output_type: str) -> int:
    """What sizes the engine takes sub-images in (see `cut`)."""
    from sirpy.mvsnet import SIZE_MULTIPLE

    return {"MVSNET": SIZE_MULTIPLE, "CMP-MVS": 1}.get(output_type, 0)


def _listed_names(path: Path | None) -> list[str] | None:
    if path is None:
        return None
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"the image list {path} cannot be read ({error})") from None
    names = sorted({line.strip() for line in lines} - {""})
    if not names:
        raise InputError(
            f"the image list {path} is empty: write one image name a line, or leave it out"
        )
    return names


def _only_listed(model: SparseModel, names: list[str], options: Options) -> SparseModel:
    """The model of the images that are listed."""
    index = {image.name: i for i, image in enumerate(model.images)}
    if missing := [name for name in names if name not in index]:
        raise InputError(
            f"{options.image_list_path} lists {missing[0]}, which is not in the model "
            f"{options.input_path}: give names as they are in the model"
        )
    return model.taking([index[name] for name in names])


def _grid(
    options: Options,
    model: SparseModel,
    undistort: UndistortOptions,
    region: Region,
) -> Grid:
    """The grid that the options ask for, of the three ways to choose it."""
    if options.memory is None and options.max_sub_image_size is None:
        from sirpy.layout import parse_cuts

        return Grid.with_cuts(
            parse_cuts(options.sub_image_column_cuts, "--sub_image_column_cuts"),
            parse_cuts(options.sub_image_row_cuts, "--sub_image_row_cuts"),
            columns=options.sub_image_columns,
            rows=options.sub_image_rows,
        )
    from sirpy.lens import undistorted_camera

    cameras = {i: undistorted_camera(camera, undistort) for i, camera in model.cameras.items()}
    overlap, multiple = options.sub_image_overlap, _size_multiple(options.output_type)
    sizes = []
    for image in model.images:
        whole = Rectangle(0, 0, cameras[image.camera_id].width, cameras[image.camera_id].height)
        roi = region.roi_of(image.name) or whole
        if multiple:  # the files grow beyond the region
            width, height = (-(-side // multiple) * multiple for side in (roi.width, roi.height))
            roi = roi.grown(width, height, whole)
        sizes.append((roi.width, roi.height))
    if options.memory is not None:
        from sirpy.memory import parse_memory
        from sirpy.planning import grid_for_memory

        budget = parse_memory(options.memory)
        return grid_for_memory(sizes, budget, overlap=overlap, multiple=multiple)
    assert options.max_sub_image_size is not None
    return grid_for_side(sizes, options.max_sub_image_size, overlap, multiple)


def grid_for_side(
    sizes: list[tuple[int, int]], longest_side: int, overlap: int, multiple: int = 0
) -> Grid:
    """The fewest sub-images whose files are at most `longest_side` pixels, overlap included.

    Args:
        sizes: (width, height) of the undistorted images in pixels.
        multiple: the files are grown to a multiple of so many pixels, if not 0.

    Raises:
        InputError: the overlap leaves no pixels, or no multiple is as small.
    """
    multiple = multiple or 1
    longest = longest_side // multiple * multiple
    if longest <= 2 * overlap:
        least = -(-(2 * overlap + 1) // multiple) * multiple
        why = f"nothing between overlaps of {overlap} pixels" if overlap else "no pixel"
        if multiple > 1:
            why += f" in sides that are a multiple of {multiple}"
        raise InputError(f"--max_sub_image_size {longest_side} leaves {why}: give at least {least}")
    core = longest - 2 * overlap
    columns = max(_parts(width, longest, core) for width, _ in sizes)
    rows = max(_parts(height, longest, core) for _, height in sizes)
    return Grid(columns, rows)


def _parts(side: int, longest: int, core: int) -> int:
    """One part has no neighbour, hence no overlap."""
    return 1 if side <= longest else -(-side // core)
