"""Stereo: a depth and a normal for every pixel of every sub-image.

A list of passes (`sirpy.stereo_backend`), each over all photographs at one level of the pyramid; a pass starts from
what the one before has written. A sub-image is estimated with a halo, against windows of native images assembled
across the borders of the grid, and all that is given is a field over the native image, so a border costs nothing.

Each unit of a pass reads files, writes files, and knows of no other.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, fields, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sirpy.depth_search import searched_around, searched_everywhere
from sirpy.errors import BudgetError
from sirpy.files import fingerprint
from sirpy.filtering import Estimate, FilterOptions, Reason, filter_depths
from sirpy.judging import Judge
from sirpy.memory import give_back
from sirpy.native_images import NativeImage, SubImage
from sirpy.native_scene import read_native_scene
from sirpy.photograph_detail import stored_detail
from sirpy.progress import Progress
from sirpy.rectangle import Rectangle
from sirpy.settling import is_supported
from sirpy.stereo_backend import (
    DepthMap,
    DepthRange,
    OutOfDeviceMemory,
    Prior,
    Setup,
    StereoBackend,
    StereoOptions,
    View,
    backend_identity,
    check_depth_map,
    make_backends,
)
from sirpy.stereo_passes import (
    PassMaps,
    Unit,
    at_level,
    native_pixels,
    nothing_found,
    read_pixels,
    seeing_and_consistent,
    units,
    write_planes,
)
from sirpy.view_fields import FieldSource, ViewField
from sirpy.view_selection import Views, read_views
from sirpy.view_windows import source_windows, top_level
from sirpy.windows import read_map, read_mask_window, write_map
from sirpy.workspace import Workspace


def stereo_passes(
    coarsest: int, top: int, options: StereoOptions, scratch: Path | None
) -> list[StereoBackend]:
    """The passes of a backend; where the last does not look at the sources' depths, they are judged.

    Raises:
        InputError: there is no such backend, or it cannot work here.
    """
    found = make_backends(Setup(coarsest, options, scratch, top))
    return found if found[-1].is_last else [*found, Judge(options)]


def estimated_window(
    unit: Unit, of_pass: StereoBackend, halo: int, options: FilterOptions
) -> Rectangle:
    """What a pass estimates of a unit, pixels of its level: what it keeps, and of the halo as much as can
    have a say."""
    kept, reach = _kept(unit, of_pass), of_pass.margin
    if of_pass.is_last:  # what is filtered must know the islands that reach into what is kept
        reach += options.margin
    covered = at_level(unit.native.covered, of_pass.level)
    around = kept.padded(min(max(halo, of_pass.halo), reach))
    return around.intersection(covered).aligned(of_pass.step)


def _kept(unit: Unit, of_pass: StereoBackend) -> Rectangle:
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
    # What can be refused is refused before earlier maps are removed.
    top = top_level(((one.width, one.height) for one in workspace.natives), views.coarsest)
    passes = stereo_passes(views.coarsest, top, options, workspace.passes)
    what = {
        key: value for key, value in asdict(options).items() if key not in ("threads", "device")
    } | {"backend": backend_identity(options.backend)}
    workspace.begin_stage("stereo", fingerprint(workspace.fingerprint_of("views"), what))
    if not all(_are_there(workspace.stereo_maps(sub)) for _, sub in workspace.sub_images()):
        estimator = _Estimator(workspace, views, options)
        before: StereoBackend | None = None
        coarser: StereoBackend | None = None  # the last pass of the level above
        for of_pass in passes:
            if before and before.level > of_pass.level:
                coarser = before
            estimator.run(of_pass, before, coarser, progress)
            before = of_pass
    shutil.rmtree(workspace.passes, ignore_errors=True)


class _Estimator:
    """Runs passes over the units of a workspace."""

    def __init__(self, workspace: Workspace, views: Views, options: StereoOptions) -> None:
        self._workspace, self._views, self._options = workspace, views, options
        self._scene = read_native_scene(workspace)
        self._natives = {native.name: native for native in workspace.natives}
        self._covered = {native.name: native.covered for native in workspace.natives}
        self._fields: dict[tuple[str, bool], ViewField] = {}
        self._noise: dict[str, npt.NDArray[np.float32]] = {}
        self._whole: PassMaps | None = None  # what the last pass over whole photographs found
        self._coarser: PassMaps | None = None

    def run(
        self,
        of_pass: StereoBackend,
        before: StereoBackend | None,
        coarser: StereoBackend | None,
        progress: Progress,
    ) -> None:
        """Estimates all units that are not done yet; `before` is the pass that they start from, `coarser` the last
        of the next coarser level."""
        coarsest = self._views.coarsest
        maps = PassMaps(self._workspace, before, coarsest) if before else None
        self._coarser = PassMaps(self._workspace, coarser, coarsest) if coarser else None
        if before and before.level == coarsest:
            self._whole = maps
        everything = list(units(self._workspace.natives, of_pass.level, coarsest))
        todo = [unit for unit in everything if not _are_there(self._outputs(unit, of_pass))]
        if len(todo) < len(everything):
            done = len(everything) - len(todo)
            progress.note(f"{of_pass.title}: {done} of {len(everything)} are done already")
        noun = "photograph" if of_pass.level >= coarsest else "sub-image"
        with progress.stage(of_pass.title, len(todo), noun) as step:
            for unit, following in zip_longest(todo, todo[1:]):
                with self._prepared(following, of_pass, maps):
                    self._run_unit(unit, of_pass, maps, progress)
                give_back()
                step.advance()

    def _run_unit(
        self, unit: Unit, of_pass: StereoBackend, before: PassMaps | None, progress: Progress
    ) -> None:
        window = estimated_window(unit, of_pass, self._views.halo, self._options)
        found = self._estimate(unit, window, of_pass, before, progress)
        inside = window.intersection(at_level(unit.native.covered, of_pass.level))
        if inside != window:  # a window of whole steps may reach beyond the photograph
            window, found = inside, _joined(inside, [inside], [window], [found])
        if of_pass.is_last and unit.sub_image is not None:
            self._finish(unit, unit.sub_image, of_pass, window, found)
        else:
            (path,) = self._outputs(unit, of_pass)
            write_planes(path, found, of_pass.planes, unit.kept.slices_in(window))

    def _outputs(self, unit: Unit, of_pass: StereoBackend) -> tuple[Path, ...]:
        """The files of a unit: it is done when they are there."""
        if of_pass.is_last and unit.sub_image is not None:
            return self._workspace.stereo_maps(unit.sub_image)
        return (self._workspace.pass_map(unit.name, of_pass.name),)

    def _estimate(
        self,
        unit: Unit,
        window: Rectangle,
        of_pass: StereoBackend,
        before: PassMaps | None,
        progress: Progress,
    ) -> DepthMap:
        """What the pass finds in a window of a unit; in two halves where its device is too small."""
        native = unit.native
        if not self._views.fields[native.name].sources:
            return nothing_found(window)
        try:
            found = of_pass.estimate(
                *self._given(native, window, of_pass, before),
                self._depth_range(native, window, of_pass.level),
                Prior(self._sparse_points(native), before, self._coarser),
            )
            check_depth_map(found, window, of_pass)
            return found
        except OutOfDeviceMemory:
            pass  # what the error still holds on the device is free after this block
        # Parts overlap by the halo, so what a pixel is given stays what it was.
        halves = window.halves(of_pass.step)
        halo = max(self._views.halo, of_pass.halo)
        around = [half.padded(halo).aligned(of_pass.step).intersection(window) for half in halves]
        if max(one.area for one in around) >= window.area:
            raise BudgetError(
                f"{of_pass.device} has too little memory for {window.width}x{window.height} "
                "pixels: free some of it"
                + (", or run on the processor (--device cpu)" if of_pass.device != "cpu" else "")
            )
        progress.note(
            f"{of_pass.title}: {unit.name} needs more memory than {of_pass.device} has: "
            f"{window.width}x{window.height} pixels are estimated in two parts"
        )
        parts = [self._estimate(unit, one, of_pass, before, progress) for one in around]
        return _joined(window, halves, around, parts)

    def _given(
        self,
        native: NativeImage,
        window: Rectangle,
        of_pass: StereoBackend,
        before: PassMaps | None,
    ) -> tuple[View, list[View]]:
        """The window of the reference and those of its sources; pixels are read when they are used."""
        level = of_pass.level
        field = self._field(native, level)
        windows = source_windows(
            self._scene,
            field,
            native_pixels(window, level, native.rectangle),
            level=level,
            covered=self._covered,
        )
        depths = before if of_pass.kind == "geometric" else None
        sources = [
            self._source(field.sources[index], index, found, of_pass, depths)
            for index, found in windows.items()
        ]
        noise = self._noise_of(native, level)
        view = replace(self._view(native, window, level), noise=noise)
        return view, [one for one in sources if one is not None]

    def _noise_of(self, native: NativeImage, level: int) -> npt.NDArray[np.float32]:
        """(16,), by brightness."""
        if native.name not in self._noise:
            self._noise[native.name] = stored_detail(self._workspace, native).sure_noise
        of_level: npt.NDArray[np.float32] = self._noise[native.name][level]
        return of_level

    def _depth_range(self, native: NativeImage, window: Rectangle, level: int) -> DepthRange:
        covered = native_pixels(window, level, native.rectangle)
        return DepthRange(self._field(native, level), covered)

    def _field(self, native: NativeImage, level: int) -> ViewField:
        """Where a level searches: everywhere, or around what the passes over whole photographs have found."""
        whole = level >= self._views.coarsest
        key = native.name, whole
        if key not in self._fields:
            field, seen = self._views.fields[native.name], self._scene.observations[native.name]
            if whole:
                limits = self._options.min_depth, self._options.max_depth
                field = searched_everywhere(field, seen, limits)
            elif self._whole is not None and self._whole.has("counts"):
                extent = at_level(native.rectangle, self._whole.level)
                counts = self._whole.read(native.name, extent, "counts")
                cost = self._whole.read(native.name, extent, "cost")
                seeing, agreeing = seeing_and_consistent(counts)
                sure = is_supported(agreeing, seeing, cost, self._options)
                depth = self._whole.read(native.name, extent, "depth")
                field = searched_around(field, depth, sure, self._whole.level)
            self._fields[key] = field
        return self._fields[key]

    @contextmanager
    def _prepared(
        self, unit: Unit | None, of_pass: StereoBackend, before: PassMaps | None
    ) -> Iterator[None]:
        """While its block runs, what the next unit needs is read."""
        if (
            unit is None
            or not of_pass.reads_ahead
            or not self._views.fields[unit.native.name].sources
        ):
            yield
            return
        window = estimated_window(unit, of_pass, self._views.halo, self._options)
        with ThreadPoolExecutor(1) as reader:
            ahead = reader.submit(
                of_pass.prepare, *self._given(unit.native, window, of_pass, before)
            )
            yield
            ahead.result()

    def _finish(
        self,
        unit: Unit,
        sub_image: SubImage,
        of_pass: StereoBackend,
        window: Rectangle,
        found: DepthMap,
    ) -> None:
        """The last pass: its maps are filtered and stand in COLMAP's folders; missing pixels are 0."""
        workspace = self._workspace
        camera = self._scene.cameras[unit.native.name]
        offered = self._views.fields[unit.native.name].num_sources(window)
        estimate = Estimate(**{one.name: getattr(found, one.name) for one in fields(Estimate)})
        assert found.level is not None  # as check_depth_map has seen
        reason, confidence = filter_depths(
            estimate,
            camera.intrinsics,
            window,
            read_mask_window(workspace, unit.native.name, window),
            self._options,
            of_pass.confidence,
        )
        reason = np.where(offered == 0, np.uint8(Reason.NO_SOURCES), reason)
        kept = _kept(unit, of_pass).slices_in(window)
        missing = reason[kept] != 0
        write_map(workspace.reason_map(sub_image), reason[kept].astype(np.float32))
        write_map(workspace.confidence_map(sub_image), confidence[kept])
        sigma = np.where(missing, np.float32(0), estimate.sigma[kept])
        write_map(workspace.sigma_map(sub_image), sigma)
        write_map(workspace.level_map(sub_image), found.level[kept].astype(np.float32))
        normal = np.where(missing, np.float32(0), estimate.normal[(slice(None), *kept)])
        write_map(workspace.normal_map(sub_image, "geometric"), normal)
        depth = np.where(missing, np.float32(0), estimate.depth[kept])
        write_map(workspace.depth_map(sub_image, "geometric"), depth)

    def _view(
        self,
        native: NativeImage,
        window: Rectangle,
        level: int,
        index: int = -1,
        depth: npt.NDArray[np.float32] | None = None,
        sigma: npt.NDArray[np.float32] | None = None,
    ) -> View:
        def read(rectangle: Rectangle, pixels: Literal["grey", "color"]) -> npt.NDArray[np.uint8]:
            return read_pixels(self._workspace, native, rectangle, level, pixels)

        extent = at_level(native.covered, level)
        camera = self._scene.cameras[native.name]
        return View(camera, window, level, extent, read, index, depth, sigma)

    def _source(
        self,
        source: FieldSource,
        index: int,
        window: Rectangle,  # native pixels
        of_pass: StereoBackend,
        depths: PassMaps | None,
    ) -> View | None:
        native = self._natives[source.name]
        level = of_pass.level + source.level
        # A window of whole pixels of a coarser level may begin beside what is cut.
        inside = at_level(window, level).intersection(at_level(native.covered, level))
        if not inside.area:
            return None
        rectangle = inside.aligned(of_pass.step)
        depth = sigma = None
        if depths:
            depth = depths.read_coarser(native, rectangle, source.level)
            if depths.has("sigma"):
                sigma = depths.read_coarser(native, rectangle, source.level, "sigma")
        return self._view(native, rectangle, level, index, depth, sigma)

    def _sparse_points(self, native: NativeImage) -> npt.NDArray[np.float64]:
        seen = self._scene.observations[native.name]
        return np.ascontiguousarray(np.column_stack([seen.pixel, seen.depth]))


def _joined(
    window: Rectangle, tiles: list[Rectangle], around: list[Rectangle], parts: list[DepthMap]
) -> DepthMap:
    """The map of a window that has the given tiles, from the maps of rectangles around these."""
    found: dict[str, npt.NDArray[Any]] = {}
    for tile, rectangle, part in zip(tiles, around, parts, strict=True):
        for one in fields(DepthMap):
            if (plane := getattr(part, one.name)) is not None:
                shape = *plane.shape[:-2], window.height, window.width
                whole = found.setdefault(one.name, np.empty(shape, plane.dtype))
                whole[(..., *tile.slices_in(window))] = plane[(..., *tile.slices_in(rectangle))]
    return DepthMap(**found)


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
