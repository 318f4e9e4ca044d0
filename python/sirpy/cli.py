"""The command line: each command is the Python function of the same name, with the same options."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from sirpy import (
    evaluation_cli,
    features_cli,
    georeference_cli,
    mesh_cli,
    rasters_cli,
    sfm_cli,
    tiles3d_cli,
    weights_cli,
)
from sirpy.engine_options import CopyPolicy, Engine, MvsnetDepths
from sirpy.errors import InputError, SirpyError
from sirpy.left_out import report_left_out

if TYPE_CHECKING:
    from sirpy.pipeline import Reconstruction
    from sirpy.rectangle import Grid

app = typer.Typer(
    name="sirpy",
    help="Dense 3D reconstruction at native resolution from photographs of any size.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    # --cluster_size as COLMAP would write it, or --cluster-size.
    context_settings={"token_normalize_func": lambda token: token.replace("_", "-")},
)
app.add_typer(evaluation_cli.app, name="evaluate")
app.add_typer(weights_cli.app, name="weights")

Images = Annotated[Path, typer.Argument(help="Folder of photographs.", show_default=False)]
Output = Annotated[Path, typer.Option("--output", "-o", help="Folder of the workspace.")]
WorkspaceFolder = Annotated[
    Path, typer.Argument(help="Folder of the workspace.", show_default=False)
]
Model = Annotated[
    Path | None,
    typer.Option(help="COLMAP model of the photographs, in native pixels; made if not given."),
]
Memory = Annotated[str, typer.Option(help="What the whole process tree may take: 8GB, 500MB.")]
Columns = Annotated[int | None, typer.Option(help="Columns of sub-images; chosen if not given.")]
Rows = Annotated[int | None, typer.Option(help="Rows of sub-images; chosen if not given.")]
ColumnCuts = Annotated[
    str | None,
    typer.Option(help="Instead of --columns: where they begin, native pixels: 900,2000."),
]
RowCuts = Annotated[
    str | None, typer.Option(help="Instead of --rows: where they begin, native pixels: 900,2000.")
]
Overlap = Annotated[int, typer.Option(help="Extra pixels around each sub-image.")]
Roi = Annotated[
    str | None,
    typer.Option(
        help="X0,Y0,WIDTH,HEIGHT of the undistorted photographs, pixels: only this is cut."
    ),
]
RoiList = Annotated[
    Path | None,
    typer.Option(help="File of lines NAME X0,Y0,WIDTH,HEIGHT: the same for single photographs."),
]
Area = Annotated[
    Path | None,
    typer.Option(help="GeoJSON polygons on the ground: only sub-images that see them are cut."),
]
AreaCrs = Annotated[
    str | None,
    typer.Option(help="CRS of --area, e.g. EPSG:25832; what the file says if not given."),
]
ModelCrs = Annotated[
    str | None,
    typer.Option(help="CRS that the model lies in; without it --area has the model's coordinates."),
]
Masks = Annotated[
    Path | None, typer.Option(help="Folder of masks NAME.png, black where not to be used.")
]
NumSources = Annotated[int, typer.Option(help="Photographs that each is matched against, at most.")]
Stereo = Annotated[
    str, typer.Option(help="patch_match, patchmatchnet, or the backend of a package.")
]
Device = Annotated[
    str, typer.Option(help="Of networks: auto (a GPU where there is one), cpu, cuda.")
]
MinDepth = Annotated[
    float | None, typer.Option(help="Nearest depth of the scene, unit of the model.")
]
MaxDepth = Annotated[float | None, typer.Option(help="Farthest depth of the scene.")]
Products = Annotated[
    str,
    typer.Option(help="Made of the points: some of cloud,dsm,ortho,mesh,tiles3d."),
]
Threads = Annotated[int, typer.Option(help="0: one for each core.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress, only results and errors.")]

_MEMORY, _STEREO = "8GB", "patch_match"


@app.command()
def reconstruct(
    context: typer.Context,
    images: Images,
    output: Output,
    model: Model = None,
    no_native: sfm_cli.NoNative = False,
    camera_model: sfm_cli.CameraModel = "OPENCV",
    camera_per: sfm_cli.CameraPer = "auto",
    memory: Memory = _MEMORY,
    columns: Columns = None,
    rows: Rows = None,
    column_cuts: ColumnCuts = None,
    row_cuts: RowCuts = None,
    roi: Roi = None,
    roi_list: RoiList = None,
    area: Area = None,
    area_crs: AreaCrs = None,
    model_crs: ModelCrs = None,
    masks: Masks = None,
    num_sources: NumSources = 8,
    stereo: Stereo = _STEREO,
    device: Device = "auto",
    min_depth: MinDepth = None,
    max_depth: MaxDepth = None,
    products: Products = "",
    threads: Threads = 0,
    quiet: Quiet = False,
) -> None:
    """Photographs to a dense cloud: every stage, in the memory that you allow."""
    from sirpy.layout import read_region
    from sirpy.memory import parse_memory
    from sirpy.pipeline import reconstruct as run
    from sirpy.progress import make_progress
    from sirpy.sfm_options import SfmOptions
    from sirpy.stereo_backend import StereoOptions

    given = _given(context, "no_native", "camera_model", "camera_per")
    if model is not None and given:
        raise InputError(
            f"{given[0]} is about cameras that are made of the photographs, and --model gives them: "
            "give one of the two"
        )
    result = run(
        images,
        output,
        model=model,
        sfm_options=SfmOptions(camera_model=camera_model, camera_per=cast(Any, camera_per)),
        native=not no_native,
        memory=parse_memory(memory),
        grid=_grid(columns, rows, column_cuts, row_cuts),
        region=read_region(roi, roi_list, area, area_crs, model_crs if area else None),
        masks=masks,
        model_crs=model_crs,
        num_sources=num_sources,
        stereo_options=StereoOptions(
            backend=stereo,
            device=device,
            min_depth=min_depth,
            max_depth=max_depth,
            threads=threads,
        ),
        products=[name.strip() for name in products.split(",")] if products else [],
        threads=threads,
        progress=make_progress(quiet),
    )
    _print_result(result, memory)
    report_left_out(result.left_out, failed=result.failed)


@app.command()
def plan(
    model: Annotated[Path, typer.Argument(help="COLMAP model, in native pixels.")],
    memory: Memory = _MEMORY,
    images: Annotated[
        Path | None,
        typer.Option(help="Folder of the photographs: what reading them needs, what they resolve."),
    ] = None,
    columns: Columns = None,
    rows: Rows = None,
    column_cuts: ColumnCuts = None,
    row_cuts: RowCuts = None,
    overlap: Overlap = 0,
    roi: Roi = None,
    roi_list: RoiList = None,
    area: Area = None,
    area_crs: AreaCrs = None,
    model_crs: ModelCrs = None,
    num_sources: NumSources = 8,
    stereo: Stereo = _STEREO,
    device: Device = "auto",
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """The grid for a memory budget; what will be written, and what each stage will need."""
    from dataclasses import asdict

    from sirpy.layout import read_region
    from sirpy.memory import parse_memory
    from sirpy.plan_table import print_plan
    from sirpy.planning import plan as run
    from sirpy.stereo_backend import StereoOptions

    found = run(
        model,
        memory=parse_memory(memory),
        grid=_grid(columns, rows, column_cuts, row_cuts),
        overlap=overlap,
        region=read_region(roi, roi_list, area, area_crs, model_crs),
        images=images,
        num_sources=num_sources,
        stereo=StereoOptions(backend=stereo, device=device),
        detail=True,
    )
    if as_json:
        print(json.dumps({**asdict(found), "predicted_peak": found.predicted_peak}))
        return
    print_plan(found, parse_memory(memory))


@app.command()
def cut(
    images: Images,
    output: Output,
    model: Annotated[Path, typer.Option(help="COLMAP model of the photographs, in native pixels.")],
    memory: Memory = _MEMORY,
    columns: Columns = None,
    rows: Rows = None,
    column_cuts: ColumnCuts = None,
    row_cuts: RowCuts = None,
    overlap: Overlap = 0,
    roi: Roi = None,
    roi_list: RoiList = None,
    area: Area = None,
    area_crs: AreaCrs = None,
    model_crs: ModelCrs = None,
    same_size: Annotated[
        int,
        typer.Option(help="One size for all, a multiple of so many pixels, by more overlap."),
    ] = 0,
    min_points: Annotated[
        int, typer.Option(help="Leave out sub-images that see fewer sparse points.")
    ] = 0,
    masks: Masks = None,
    bands: Annotated[str, typer.Option(help="color; all keeps alpha and infrared.")] = "color",
    interpolation: Annotated[
        str, typer.Option(help="nearest, bilinear (as COLMAP), bicubic or lanczos.")
    ] = "bilinear",
    format: Annotated[
        str | None, typer.Option(help="jpg, png or tif; JPEG stays JPEG if not given.")
    ] = None,
    jpeg_quality: Annotated[int, typer.Option(help="1 to 100.")] = 95,
    jpeg_chroma: Annotated[str, typer.Option(help="444, 422 or 420.")] = "444",
    stereo: Stereo = _STEREO,
    device: Device = "auto",
    quiet: Quiet = False,
) -> None:
    """Recapture: undistorts the photographs and cuts them into sub-images with their own cameras."""
    from sirpy.cut_tasks import PixelOptions
    from sirpy.cutting import cut as run
    from sirpy.layout import read_region
    from sirpy.memory import parse_memory
    from sirpy.photographs import Encoding
    from sirpy.progress import make_progress
    from sirpy.stereo_backend import StereoOptions

    workspace = run(
        images,
        model,
        output,
        grid=_grid(columns, rows, column_cuts, row_cuts),
        memory=parse_memory(memory),
        stereo=StereoOptions(backend=stereo, device=device),
        overlap=overlap,
        region=read_region(roi, roi_list, area, area_crs, model_crs),
        same_size=same_size,
        min_points=min_points,
        masks=masks,
        # The option classes check the words.
        pixels=PixelOptions(
            cast(Any, bands),
            cast(Any, interpolation),
            cast(Any, format),
            Encoding(jpeg_quality, cast(Any, jpeg_chroma)),
        ),
        progress=make_progress(quiet),
    )
    print(f"sub-images: {workspace.images}")
    report_left_out(workspace.left_out)


@app.command()
def views(
    workspace: WorkspaceFolder,
    num_sources: NumSources = 8,
    halo: Annotated[int, typer.Option(help="Pixels estimated around each sub-image.")] = 16,
    quiet: Quiet = False,
) -> None:
    """View selection: sources, depth range and windows of each sub-image."""
    from sirpy.progress import make_progress
    from sirpy.view_selection import views as run
    from sirpy.workspace import Workspace

    folder = Workspace(workspace)
    run(folder, num_sources=num_sources, halo=halo, progress=make_progress(quiet))
    print(f"views: {folder.views}")


@app.command()
def clusters(
    workspace: WorkspaceFolder,
    cluster_size: Annotated[int, typer.Option(help="Sub-images of a cluster, at most.")] = 20,
) -> None:
    """Groups of overlapping sub-images that can be reconstructed one by one."""
    from sirpy.clustering import clusters as run
    from sirpy.progress import make_progress
    from sirpy.workspace import Workspace

    folder = Workspace(workspace)
    found = run(folder, cluster_size=cluster_size, progress=make_progress(quiet=False))
    print(f"clusters: {folder.clusters} ({len(found)} of at most {cluster_size} sub-images)")
    if folder.pmvs.exists():
        print(f"{folder.pmvs} has no groups of them yet: run `sirpy export {workspace} PMVS`")


@app.command()
def export(
    workspace: WorkspaceFolder,
    engine: Annotated[Engine, typer.Argument(help="What shall read it.", show_default=False)],
    num_sources: Annotated[int, typer.Option(help="Sub-images matched against, at most.")] = 20,
    min_points: Annotated[
        int, typer.Option(help="COLMAP: sub-images with fewer points get a depth range.")
    ] = 1,
    mvsnet_depths: Annotated[
        MvsnetDepths, typer.Option(help="range: PatchmatchNet; interval: MVSNet, CasMVSNet.")
    ] = "range",
    copy_policy: Annotated[
        CopyPolicy, typer.Option(help="How numbered images are made of the sub-images.")
    ] = "hard-link",
    quiet: Quiet = False,
) -> None:
    """The sub-images for another engine: COLMAP, PMVS, CMP-MVS, MVSNet and its relatives."""
    from sirpy.exporting import export as run
    from sirpy.progress import make_progress
    from sirpy.workspace import Workspace

    folder = Workspace(workspace)
    run(
        folder,
        engine,
        num_sources=num_sources,
        min_points=min_points,
        mvsnet_depths=mvsnet_depths,
        copy_policy=copy_policy,
        progress=make_progress(quiet),
    )
    print(f"{engine}: {folder.folder}")


@app.command()
def stereo(
    context: typer.Context,
    workspace: WorkspaceFolder,
    stereo: Stereo = _STEREO,
    device: Device = "auto",
    max_cost: Annotated[float, typer.Option(help="1 - NCC above which there is no depth.")] = 0.8,
    min_consistent: Annotated[int, typer.Option(help="Sources that must agree.")] = 2,
    min_confidence: Annotated[
        float, typer.Option(help="Probability to be right below which there is no depth.")
    ] = 0.7,
    min_depth: MinDepth = None,
    max_depth: MaxDepth = None,
    explain: Annotated[
        str | None,
        typer.Option(help="Estimate nothing: draw what was found in this (sub-)image, and why."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="PNG of --explain; in the workspace.")
    ] = None,
    threads: Threads = 0,
    quiet: Quiet = False,
) -> None:
    """Depth and normal maps of all sub-images that have none yet; or a picture of them."""
    from sirpy.dense_stereo import stereo as run
    from sirpy.explaining import explain as draw
    from sirpy.progress import make_progress
    from sirpy.stereo_backend import StereoOptions
    from sirpy.workspace import Workspace

    folder = Workspace(workspace)
    if explain is not None:
        if given := _given(
            context,
            "stereo",
            "device",
            "max_cost",
            "min_consistent",
            "min_confidence",
            "min_depth",
            "max_depth",
            "threads",
        ):
            raise InputError(
                f"{given[0]} belongs to the estimate, and --explain draws the one that is there: give "
                "one of the two"
            )
        print(f"picture: {draw(folder, explain, output)}")
        return
    if output is not None:
        raise InputError("--output belongs to --explain: the maps are written into the workspace")
    options = StereoOptions(
        backend=stereo,
        device=device,
        max_cost=max_cost,
        min_consistent=min_consistent,
        min_confidence=min_confidence,
        min_depth=min_depth,
        max_depth=max_depth,
        threads=threads,
    )
    run(folder, options=options, progress=make_progress(quiet))
    print(f"maps: {folder.stereo}")


@app.command()
def fuse(
    workspace: WorkspaceFolder,
    min_consistent: Annotated[int, typer.Option(help="Sources that must agree.")] = 2,
    consistency: Annotated[
        float, typer.Option(help="Pixels that agreeing depths differ by.")
    ] = 1.0,
    keep_duplicates: Annotated[
        bool, typer.Option(help="Every view emits the surface, not only the one that sees it best.")
    ] = False,
    thin: Annotated[
        bool,
        typer.Option(help="Where coarser pixels gave the depth: one point for each of them."),
    ] = False,
    format: Annotated[
        str | None,
        typer.Option(help="Besides fused.ply, in the CRS: laz (with its CRS) or ply."),
    ] = None,
    tiles: Annotated[
        str | None,
        typer.Option(help="With --format: one file for each tile, 100 (a length) or quadkey:19."),
    ] = None,
    spacing: Annotated[
        float | None,
        typer.Option(help="With --format: only the best point of each cube of this side."),
    ] = None,
    threads: Threads = 0,
    quiet: Quiet = False,
) -> None:
    """The depth maps as one cloud; those of a dense workspace that COLMAP made, too."""
    from sirpy.cloud_files import check_export, export_cloud
    from sirpy.colmap_dense import open_workspace
    from sirpy.fusion import FusionOptions
    from sirpy.fusion import fuse as run
    from sirpy.progress import make_progress

    options = FusionOptions(
        min_consistent=min_consistent,
        consistency=consistency,
        keep_duplicates=keep_duplicates,
        thin=thin,
        threads=threads,
    )
    if format is None and (tiles or spacing is not None):
        raise InputError("--tiles and --spacing belong to --format: give --format laz or ply too")
    folder, progress = open_workspace(workspace), make_progress(quiet)
    if format is not None:
        check_export(folder, format, tiles, spacing)
    made = run(folder, options=options, progress=progress)
    print(f"cloud: {folder.fused} ({made.points:,} points)")
    if format is not None:
        files = export_cloud(
            folder, format=cast(Any, format), tiles=tiles, spacing=spacing, progress=progress
        )
        for path in files[:1]:  # none without points
            print(f"{format}: {path.parent if tiles else path}")
    report_left_out(made.left_out, "depth maps")


@app.command()
def report(workspace: WorkspaceFolder) -> None:
    """The report of a reconstruction as one page."""
    from sirpy.colmap_dense import open_workspace
    from sirpy.html_report import report as run

    print(f"report: {run(open_workspace(workspace))}")


@app.command()
def demo(
    output: Output = Path("demo"),
    memory: Memory = _MEMORY,
    quiet: Quiet = False,
) -> None:
    """A synthetic aerial scene: rendered, reconstructed and judged by its exact ground truth."""
    from sirpy.demo import demo as run
    from sirpy.memory import parse_memory
    from sirpy.progress import make_progress

    made = run(output, memory=parse_memory(memory), progress=make_progress(quiet))
    print(made.evaluation)
    _print_result(made.reconstruction, memory)


sfm_cli.register(app)
features_cli.register(app)
georeference_cli.register(app)
app.add_typer(rasters_cli.app)
mesh_cli.register(app)
tiles3d_cli.register(app)


def _print_result(result: Reconstruction, memory: str) -> None:
    from sirpy.memory import gigabytes

    print(f"cloud:   {result.workspace.fused} ({result.points:,} points)")
    for name, path in result.products.items():
        print(f"{name + ':':<8} {path}")
    print(f"report:  {result.workspace.report}")
    if result.workspace.cloud_picture.exists():
        print(f"picture: {result.workspace.cloud_picture}")
    if result.peak_bytes is not None:
        print(f"memory:  {gigabytes(result.peak_bytes)} at the peak, of {memory}")


def _given(context: typer.Context, *parameters: str) -> list[str]:
    """The options among these that the user gave, as they are written."""
    by_user = (
        name
        for name in parameters
        if (source := context.get_parameter_source(name)) and source.name == "COMMANDLINE"
    )
    return [f"--{name.replace('_', '-')}" for name in by_user]


def _grid(
    columns: int | None, rows: int | None, column_cuts: str | None, row_cuts: str | None
) -> Grid | None:
    from sirpy.layout import parse_cuts
    from sirpy.rectangle import Grid

    xs, ys = parse_cuts(column_cuts, "--column-cuts"), parse_cuts(row_cuts, "--row-cuts")
    if xs or ys:
        return Grid.with_cuts(xs, ys, columns=columns, rows=rows)
    if columns is None and rows is None:
        return None
    if columns is None or rows is None:
        raise InputError("--columns and --rows belong together: give both or neither")
    return Grid(columns, rows)


def main() -> None:
    try:
        app()
    except SirpyError as error:
        print(f"sirpy: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
