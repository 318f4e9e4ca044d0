"""The whole pipeline: photographs -> sparse model -> refinement -> plan -> recapture -> view selection
-> stereo -> fusion."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sirpy.crs import ground_crs
from sirpy.cutting import cut
from sirpy.deliverables import check_products, make_product
from sirpy.dense_stereo import stereo
from sirpy.errors import SirpyError
from sirpy.files import write_json
from sirpy.fusion import FusionOptions, fuse
from sirpy.georeference import settle_frame
from sirpy.html_report import report
from sirpy.layout import Region
from sirpy.model_arrays import read_arrays
from sirpy.model_files import model_identity
from sirpy.native_images import LeftOut
from sirpy.native_scene import native_scene
from sirpy.photographs import check_folders, check_masks, find_photographs
from sirpy.planning import Plan, plan
from sirpy.progress import LoggedProgress, Progress
from sirpy.rectangle import Grid
from sirpy.resources import Meter
from sirpy.sfm import predicted_refinement_peak, refine_cameras
from sirpy.sfm_options import SfmOptions
from sirpy.sparse_model import predicted_sparse_peak, sparse
from sirpy.stereo_backend import StereoOptions, check_backend
from sirpy.sub_image_model import undistorted_model
from sirpy.view_selection import check_num_sources, views
from sirpy.workspace import Workspace, check_writable

DEFAULT_MEMORY = 8_000_000_000  # bytes


@dataclass(frozen=True)
class Reconstruction:
    """What `reconstruct` made."""

    workspace: Workspace
    plan: Plan
    points: int
    left_out: list[LeftOut]
    peak_bytes: int | None  # measured, of the whole process tree; None where it cannot be
    products: dict[str, Path]  # what was asked for, by name
    failed: list[LeftOut]  # products that could not be made, and why


def reconstruct(
    images: Path | str,
    output: Path | str,
    *,
    model: Path | str | None = None,
    sfm_options: SfmOptions = SfmOptions(),
    native: bool = True,
    memory: int = DEFAULT_MEMORY,
    grid: Grid | None = None,
    region: Region = Region(),
    masks: Path | str | None = None,
    num_sources: int = 8,
    stereo_options: StereoOptions | None = None,
    fusion_options: FusionOptions | None = None,
    products: Sequence[str] = (),
    model_crs: str | None = None,
    threads: int = 0,
    progress: Progress | None = None,
) -> Reconstruction:
    """A dense cloud of the photographs in `images` at native resolution: OUTPUT/fused.ply, report.html.

    A run that was killed is continued by the same call.

    Args:
        images: folder of photographs.
        output: folder of the workspace.
        model: COLMAP model of the photographs in native pixels; made from the photographs if None.
        sfm_options: how it is made then.
        native: refine the model that is made at native resolution.
        memory: bytes that the whole process tree may take.
        grid: of sub-images; chosen for `memory` if None.
        region: what of the photographs is used; all of it by default.
        masks: folder of masks NAME.png, black where a photograph is to give no points.
        num_sources: photographs that each is matched against, at most.
        products: of deliverables.PRODUCTS, made of the points in the frame of the georeference; of GPS in
            EXIF where there is none yet.
        model_crs: the CRS that the model lies in, of the products then.
        threads: 0 for one on each core.

    Raises:
        SirpyError: the user's data or options are at fault; the message says how to mend it.
    """
    images, output = Path(images), Path(output)
    model = None if model is None else Path(model)
    # All that can be refused is refused before anything is written.
    stereo_options = stereo_options or StereoOptions(threads=threads)
    fusion_options = fusion_options or FusionOptions(threads=threads)
    check_num_sources(num_sources)
    check_backend(stereo_options)
    check_products(products)
    if model_crs is not None:
        ground_crs(model_crs, "--model_crs")
    names = find_photographs(images)
    check_folders(images, output)
    check_masks(masks)
    workspace = Workspace(output)
    workspace.check_apart(
        "cut" if model else "sparse", images, model, None if masks is None else Path(masks)
    )
    check_writable(output)
    progress = LoggedProgress(progress or Progress(), workspace.log)
    log = _RunLog(memory)
    left_out: list[LeftOut] = []
    if model is None:
        threads_used = threads or os.cpu_count() or 1
        with log.stage(workspace, "sparse", len(names), "photograph"):
            made = sparse(
                images,
                output,
                options=sfm_options,
                memory=memory,
                threads=threads_used,
                progress=progress,
            )
        log.predicted["sparse"] = predicted_sparse_peak(
            images, threads_used, memory, max_size=sfm_options.max_image_size
        )
        oriented = len(made.components[0])
        units = oriented if native else 0
        with log.stage(workspace, "refine", units, "photograph", begun=workspace.is_refined):
            solution = refine_cameras(
                *(images, workspace, made.left_out, made.components),
                native=native,
                memory=memory,
                threads=threads_used,
                progress=progress,
            )
        if native:
            log.predicted["refine"] = predicted_refinement_peak(workspace)
        model, left_out = solution.model, solution.left_out
    solved = read_arrays(model)
    chosen = plan(
        native_scene(undistorted_model(solved)),
        memory=memory,
        grid=grid,
        region=region,
        images=images,
        num_sources=num_sources,
        stereo=stereo_options,
    )
    log.predicted.update(chosen.predicted_peak)
    progress.note(f"plan: {chosen.grid} sub-images of each photograph")

    with log.stage(workspace, "cut", len(solved.images), "photograph"):
        workspace = cut(
            images,
            solved,
            output,
            identity=model_identity(model),
            grid=chosen.grid,
            region=region,
            masks=masks,
            progress=progress,
        )
    del solved
    count = len(list(workspace.sub_images()))
    with log.stage(workspace, "views", count, "sub-image"):
        views(workspace, num_sources=num_sources, progress=progress)
    with log.stage(workspace, "stereo", count, "sub-image"):
        stereo(workspace, options=stereo_options, progress=progress)
    with log.stage(workspace, "fuse", count, "sub-image"):
        fused = fuse(workspace, options=fusion_options, progress=progress)
    finished, failed = _make_products(
        workspace, images, products, model_crs, memory, threads, log, progress
    )
    left_out = sorted([*left_out, *workspace.left_out, *fused.left_out], key=lambda out: out.name)
    log.write(workspace, chosen, fused.points, left_out, stereo_options.backend, progress.notes)
    report(workspace)
    return Reconstruction(workspace, chosen, fused.points, left_out, log.peak, finished, failed)


def _make_products(
    workspace: Workspace,
    images: Path,
    names: Sequence[str],
    model_crs: str | None,
    memory: int,
    threads: int,
    log: _RunLog,
    progress: Progress,
) -> tuple[dict[str, Path], list[LeftOut]]:
    """One that fails does not keep the others from being made."""
    made: dict[str, Path] = {}
    failed: list[LeftOut] = []
    if names:
        try:
            settle_frame(workspace, images, model_crs=model_crs, progress=progress)
        except SirpyError as error:
            return made, [LeftOut(name, str(error)) for name in names]
    for name in names:
        try:
            with log.stage(workspace, name, 1, "product"):
                made[name] = make_product(
                    workspace, name, memory=memory, threads=threads, progress=progress
                )
        except SirpyError as error:
            progress.note(f"{name}: {error}")
            failed.append(LeftOut(name, str(error)))
    return made, failed


@dataclass
class _RunLog:
    """What the stages cost; becomes run.json."""

    memory: int
    stages: list[dict[str, Any]] = field(default_factory=list)
    predicted: dict[str, int] = field(default_factory=dict)

    @contextmanager
    def stage(
        self, workspace: Workspace, name: str, units: int, unit: str, *, begun: bool = True
    ) -> Iterator[None]:
        """Measures a stage; without `begun` nothing of it can be there already."""
        before = workspace.fingerprint_of(name) if begun else ""
        with Meter() as meter:
            yield
        self.stages.append(
            {
                "name": name,
                "units": units,
                "unit": unit,
                "wall_s": meter.wall_s,
                "cpu_s": meter.cpu_s,
                "measured_peak": meter.peak_bytes,
                # Some or all of it was there already; the costs are those of this run.
                "reused": before != "" and before == workspace.fingerprint_of(name),
            }
        )

    @property
    def peak(self) -> int | None:
        known = [s["measured_peak"] for s in self.stages if s["measured_peak"] is not None]
        return max(known) if known else None

    def write(
        self,
        workspace: Workspace,
        chosen: Plan,
        points: int,
        left_out: list[LeftOut],
        stereo: str,
        notes: list[str],
    ) -> None:
        write_json(
            workspace.run,
            {
                "version": 1,
                "memory": self.memory,
                "grid": str(chosen.grid),
                "stereo": stereo,
                "notes": notes,
                "points": points,
                "stages": [
                    {**stage, "predicted_peak": self.predicted.get(stage["name"])}
                    for stage in self.stages
                ],
                "left_out": [{"name": out.name, "reason": out.reason} for out in left_out],
            },
        )
