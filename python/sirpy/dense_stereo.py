"""Stereo: a depth and a normal for every pixel of every sub-image.

Passes of PatchMatch (cpp/src/patch_match_sir.h) from coarse to native: whole photographs decimated, then sub-images
at finer and finer levels, each pass from the planes of the one before; in the geometric passes the depths that the
sources have found have their say. A sub-image is matched with a halo, against windows of native images assembled
across the borders of the grid, and all that is given is a field over the native image, so a border costs nothing.

Each unit of a pass reads files, writes files, and knows of no other.
"""

from __future__ import annotations

import shutil
import zlib
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sirpy import _core
from sirpy.files import fingerprint
from sirpy.filtering import Estimate, FilterOptions, Reason, check_bounds, filter_depths
from sirpy.native_images import NativeImage, SubImage
from sirpy.native_scene import read_native_scene
from sirpy.progress import Progress
from sirpy.rectangle import Rectangle
from sirpy.stereo_passes import (
    PassMaps,
    StereoPass,
    Unit,
    at_level,
    native_pixels,
    nothing_found,
    read_grey,
    units,
    write_planes,
)
from sirpy.view_fields import FieldSource
from sirpy.view_selection import Views, read_views
from sirpy.view_windows import source_windows
from sirpy.windows import read_map, read_mask_window, write_map
from sirpy.workspace import Workspace

_LEAST_SIDE = 2  # pixels of a source's window: what is narrower holds no patch


@dataclass(frozen=True)
class StereoOptions(FilterOptions):
    """Options of `stereo`; those of the estimator carry the names and defaults of the C++ core."""

    top_views: int = 4  # sources that a pixel is matched against, at most
    native_iterations: int = 3  # sweeps at native resolution, photometric pass
    geometric_iterations: int = 1  # sweeps of the geometric pass there
    seed: int = 0
    threads: int = 0  # 0: one for each core

    def __post_init__(self) -> None:
        super().__post_init__()
        bounds = {
            "top_views": (1, 32),
            "native_iterations": (1, 100),
            "geometric_iterations": (1, 100),
            "threads": (0, 1024),
        }
        check_bounds(self, bounds)


def passes(coarsest: int, options: StereoOptions) -> list[StereoPass]:
    """Coarse to native. What the whole photograph tells is made sure of by its sources at once; the
    levels between halve the pixel."""
    return [
        StereoPass(coarsest, "photometric", 4, largest_step=8),
        StereoPass(coarsest, "geometric", 2, complete=True),
        *(StereoPass(level, "photometric", 2) for level in range(coarsest - 1, 0, -1)),
        StereoPass(0, "photometric", options.native_iterations, offers=5),
        StereoPass(0, "geometric", options.geometric_iterations, offers=5),
    ]


def estimated_window(
    unit: Unit, of_pass: StereoPass, halo: int, options: FilterOptions
) -> Rectangle:
    """What a pass estimates of a unit, pixels of its level: what it keeps, and of the halo as much as can
    have a say."""
    kept, reach = _kept(unit, of_pass), of_pass.margin
    if of_pass.is_last:  # what is filtered must know the islands that reach into what is kept
        reach += options.margin
    covered = at_level(unit.native.covered, of_pass.level)
    return kept.padded(min(halo, reach)).intersection(covered)


def _kept(unit: Unit, of_pass: StereoPass) -> Rectangle:
    """The maps that are left at the end hold all that a sub-image stores."""
    return unit.sub_image.stored if of_pass.is_last and unit.sub_image else unit.kept


def stereo(
    workspace: Workspace,
    *,
    options: StereoOptions | None = None,
    progress: Progress | None = None,
) -> None:
    """Estimates the maps of all sub-images that are not there yet; writes them in COLMAP's format.

    stereo/depth_maps, normal_maps: NAME.geometric.bin; stereo/reason_maps (`Reason`) and
    confidence_maps: NAME.bin. The maps of the passes before lie in stereo/passes while they are
    needed. Needs `views`.

    Raises:
        InputError: the workspace is not ready, or an option is out of range.
    """
    options = options or StereoOptions()
    progress = progress or Progress()
    views = read_views(workspace)
    what = {key: value for key, value in asdict(options).items() if key != "threads"}
    workspace.begin_stage("stereo", fingerprint(workspace.fingerprint_of("views"), what))
    if not all(_are_there(workspace.stereo_maps(sub)) for _, sub in workspace.sub_images()):
        estimator = _Estimator(workspace, views, options)
        before = None
        for of_pass in passes(views.coarsest, options):
            estimator.run(of_pass, before, progress)
            before = of_pass
    shutil.rmtree(workspace.passes, ignore_errors=True)


class _Estimator:
    """Runs passes over the units of a workspace."""

    def __init__(self, workspace: Workspace, views: Views, options: StereoOptions) -> None:
        self._workspace, self._views, self._options = workspace, views, options
        self._scene = read_native_scene(workspace)
        self._natives = {native.name: native for native in workspace.natives}
        self._covered = {native.name: native.covered for native in workspace.natives}

    def run(self, of_pass: StereoPass, before: StereoPass | None, progress: Progress) -> None:
        """Estimates all units that are not done yet; `before` is the pass that they start from."""
        coarsest = self._views.coarsest
        maps = PassMaps(self._workspace, before, coarsest) if before else None
        everything = list(units(self._workspace.natives, of_pass.level, coarsest))
        todo = [unit for unit in everything if not _are_there(self._outputs(unit, of_pass))]
        if len(todo) < len(everything):
            done = len(everything) - len(todo)
            progress.note(f"{of_pass.title}: {done} of {len(everything)} are done already")
        noun = "photograph" if of_pass.level == coarsest else "sub-image"
        with progress.stage(of_pass.title, len(todo), noun) as step:
            for unit in todo:
                if of_pass.is_last and unit.sub_image is not None:
                    self._finish(unit, unit.sub_image, of_pass, maps)
                else:
                    self._prepare(unit, of_pass, maps)
                step.advance()

    def _outputs(self, unit: Unit, of_pass: StereoPass) -> tuple[Path, ...]:
        """The files of a unit: it is done when they are there."""
        if of_pass.is_last and unit.sub_image is not None:
            return self._workspace.stereo_maps(unit.sub_image)
        return (self._workspace.pass_map(unit.name, of_pass.name),)

    def _estimate(
        self, unit: Unit, of_pass: StereoPass, before: PassMaps | None
    ) -> tuple[Rectangle, dict[str, npt.NDArray[Any]]]:
        """The window of a unit, and what the pass finds in it; with sources also the grey levels there."""
        native, level = unit.native, of_pass.level
        window = estimated_window(unit, of_pass, self._views.halo, self._options)
        field = self._views.fields[native.name]
        if not field.sources:
            return window, nothing_found(window)
        windows = source_windows(
            self._scene,
            field,
            native_pixels(window, level, native.rectangle),
            level=level,
            covered=self._covered,
        )
        depths = before if of_pass.kind == "geometric" else None
        start = before.start(native.name, window, level) if before else None
        grey = read_grey(self._workspace, native, window, level)
        found = _core.patch_match(
            reference=self._view(native, window, level, grey),
            sources=[
                self._source(source, windows.get(index), level, depths)
                for index, source in enumerate(field.sources)
            ],
            block_side=field.side,
            allowed=field.allowed,
            min_depth=field.min_depth,
            max_depth=field.max_depth,
            points=self._sparse_points(native) if start is None else np.empty((0, 3)),
            start=start,
            options=self._core_options(of_pass, native),
        )
        return window, {**found, "grey": grey}

    def _prepare(self, unit: Unit, of_pass: StereoPass, before: PassMaps | None) -> None:
        """A pass that another starts from. Nothing of it is held when the next unit begins."""
        window, found = self._estimate(unit, of_pass, before)
        if of_pass.complete:
            self._complete(unit.native, window, of_pass.level, found)
        (path,) = self._outputs(unit, of_pass)
        write_planes(path, found, _kept(unit, of_pass).slices_in(window))

    def _complete(
        self,
        native: NativeImage,
        window: Rectangle,
        level: int,
        found: dict[str, npt.NDArray[Any]],
    ) -> None:
        """Gives weak texture in `found` the planes around it (cpp/src/patch_match/planar_completion.h)."""
        camera = self._scene.cameras[native.name]
        sources = self._views.fields[native.name].sources
        if not sources:
            return
        centres = np.stack([self._scene.cameras[source.name].centre for source in sources])
        options = _core.PlanarCompletionOptions()
        options.threads = self._options.threads
        found["depth"], found["normal"], _ = _core.complete_planes(
            level=level,
            x0=window.x0,
            y0=window.y0,
            intrinsics=camera.intrinsics,
            grey=found["grey"],
            depth=found["depth"],
            normal=found["normal"],
            views=found["views"],
            texture=found["texture"],
            num_consistent=found["num_consistent"],
            source_centres=camera.in_camera(centres),
            options=options,
        )

    def _finish(
        self, unit: Unit, sub_image: SubImage, of_pass: StereoPass, before: PassMaps | None
    ) -> None:
        """The last pass: its maps are filtered and stand in COLMAP's folders; missing pixels are 0."""
        workspace = self._workspace
        window, found = self._estimate(unit, of_pass, before)
        camera = self._scene.cameras[unit.native.name]
        offered = self._views.fields[unit.native.name].num_sources(window)
        reason, confidence = filter_depths(
            Estimate(**{one.name: found[one.name] for one in fields(Estimate)}),
            camera.intrinsics,
            window,
            read_mask_window(workspace, unit.native.name, window),
            offered,
            self._options,
        )
        reason = np.where(offered == 0, np.uint8(Reason.NO_SOURCES), reason)
        kept = _kept(unit, of_pass).slices_in(window)
        missing = reason[kept] != 0
        write_map(workspace.reason_map(sub_image), reason[kept].astype(np.float32))
        write_map(workspace.confidence_map(sub_image), confidence[kept])
        normal = np.where(missing, np.float32(0), found["normal"][(slice(None), *kept)])
        write_map(workspace.normal_map(sub_image, "geometric"), normal)
        depth = np.where(missing, np.float32(0), found["depth"][kept])
        write_map(workspace.depth_map(sub_image, "geometric"), depth)

    def _view(
        self,
        native: NativeImage,
        rectangle: Rectangle,
        level: int,
        grey: npt.NDArray[np.uint8],
        inverse_depth: npt.NDArray[np.float32] | None = None,
    ) -> _core.ViewWindow:
        camera = self._scene.cameras[native.name]
        return _core.ViewWindow(
            intrinsics=camera.intrinsics,
            cam_from_world=camera.cam_from_world,
            level=level,
            x0=rectangle.x0,
            y0=rectangle.y0,
            grey=grey,
            inverse_depth=inverse_depth,
        )

    def _source(
        self,
        source: FieldSource,
        window: Rectangle | None,  # native pixels; None: nothing of it is needed
        level: int,
        depths: PassMaps | None,
    ) -> _core.ViewWindow | None:
        if window is None:
            return None
        native = self._natives[source.name]
        rectangle = at_level(window, level + source.level)
        if min(rectangle.width, rectangle.height) < _LEAST_SIDE:
            return None
        inverse = None
        if depths is not None:
            inverse = depths.read_coarser(native, rectangle, source.level)
            np.divide(1, inverse, out=inverse, where=inverse > 0)
        level += source.level
        grey = read_grey(self._workspace, native, rectangle, level)
        return self._view(native, rectangle, level, grey, inverse)

    def _core_options(self, of_pass: StereoPass, native: NativeImage) -> _core.PatchMatchOptions:
        core = _core.PatchMatchOptions()
        core.iterations = of_pass.iterations
        core.offers = of_pass.offers
        core.largest_step = of_pass.largest_step
        core.top_views = self._options.top_views
        core.threads = self._options.threads
        # The random numbers of an image depend on its name, not on which others there are.
        core.seed = zlib.crc32(f"{self._options.seed} {of_pass.name} {native.name}".encode())
        return core

    def _sparse_points(self, native: NativeImage) -> npt.NDArray[np.float64]:
        seen = self._scene.observations[native.name]
        return np.ascontiguousarray(np.column_stack([seen.pixel, seen.depth]))


def count_reasons(workspace: Workspace) -> dict[str, dict[str, int]]:
    """Pixels of each native image by what became of them: "valid" and the names of `Reason`.

    A pixel with several reasons counts under the first of them, so the counts add up to the image.
    """
    counts: dict[str, dict[str, int]] = {}
    for native, sub_image in workspace.sub_images():
        reason = read_map(workspace.reason_map(sub_image)).astype(np.uint8)
        left = reason[sub_image.core.slices_in(sub_image.stored)]
        count = counts.setdefault(native.name, {"valid": 0} | {_name(one): 0 for one in Reason})
        count["valid"] += int((left == 0).sum())
        for one in Reason:
            hit = (left & one) != 0
            count[_name(one)] += int(hit.sum())
            left = left[~hit]
    return counts


def _are_there(paths: tuple[Path, ...]) -> bool:
    return all(path.exists() for path in paths)


def _name(reason: Reason) -> str:
    return str(reason.name).lower()
