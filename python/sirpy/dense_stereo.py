"""Stereo: a depth and a normal for every pixel of every sub-image.

Two passes of PatchMatch (cpp/src/patch_match_sir.h): the photometric pass of all sub-images, then the geometric
pass, in which the photometric depths of the sources have their say. A sub-image is matched with a halo, against
windows of native images assembled across the borders of the grid, so a border costs nothing.

Each sub-image is one unit of work: it reads files, writes files, and knows of no other.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from typing import Literal

import numpy as np
import numpy.typing as npt

from sirpy import _core
from sirpy.files import fingerprint
from sirpy.filtering import (
    ByteMap,
    Estimate,
    FilterOptions,
    FloatMap,
    Reason,
    check_bounds,
    filter_depths,
    patch_variance,
)
from sirpy.native_images import NativeImage, SubImage
from sirpy.native_scene import NativeScene, read_native_scene
from sirpy.progress import Progress
from sirpy.rectangle import Rectangle
from sirpy.view_selection import SubImageViews, read_views
from sirpy.windows import read_map, read_map_window, read_mask_window, read_window, write_map
from sirpy.workspace import Pass, Workspace


@dataclass(frozen=True)
class StereoOptions(FilterOptions):
    """Options of `stereo`; those of the estimator carry the names and defaults of the C++ core."""

    top_views: int = 4  # sources that a pixel is matched against, at most
    native_iterations: int = 1  # sweeps at native resolution, photometric pass
    geometric_iterations: int = 2  # sweeps of the geometric pass
    seed: int = 0
    threads: int = 0  # 0: one for each core

    def __post_init__(self) -> None:
        super().__post_init__()
        bounds = {
            "top_views": (1, 16),
            "native_iterations": (1, 100),
            "geometric_iterations": (1, 100),
            "threads": (0, 1024),
        }
        check_bounds(self, bounds)


@dataclass(frozen=True)
class DepthMap:
    """Maps of a sub-image (height x width): depth, normal (3 planes), reason why there is none, and
    after the last pass how sure it is.
    """

    depth: FloatMap
    normal: FloatMap
    reason: ByteMap
    confidence: FloatMap | None = None


def stereo(
    workspace: Workspace,
    *,
    options: StereoOptions | None = None,
    progress: Progress | None = None,
) -> None:
    """Estimates the maps of all sub-images that are not there yet; writes them in COLMAP's format.

    stereo/depth_maps, normal_maps: NAME.photometric.bin and NAME.geometric.bin; stereo/reason_maps
    (`Reason`) and confidence_maps: NAME.bin. Needs `views`.

    Raises:
        InputError: the workspace is not ready, or an option is out of range.
    """
    options = options or StereoOptions()
    progress = progress or Progress()
    views = read_views(workspace)
    what = {key: value for key, value in asdict(options).items() if key != "threads"}
    workspace.begin_stage("stereo", fingerprint(workspace.fingerprint_of("views"), what))
    scene = read_native_scene(workspace)
    natives = {native.name: native for native in workspace.natives}
    of_passes: dict[Pass, Callable[..., DepthMap]] = {
        "photometric": _photometric,
        "geometric": _geometric,
    }
    everything = list(workspace.sub_images())
    for of_pass, estimate in of_passes.items():
        todo = [unit for unit in everything if not _is_done(workspace, unit[1], of_pass)]
        if len(todo) < len(everything):
            done = len(everything) - len(todo)
            progress.note(f"stereo, {of_pass}: {done} sub-images are done already")
        with progress.stage(f"stereo, {of_pass}", len(todo), "sub-image") as step:
            for native, sub_image in todo:
                problem = _Problem(
                    workspace, natives, scene, native, views.sub_images[sub_image.name], options
                )
                maps = estimate(problem) if problem.views.sources else _nothing(problem)
                _write(workspace, sub_image, of_pass, maps, problem.views.window)
                step.advance()


@dataclass(frozen=True)
class _Problem:
    workspace: Workspace
    natives: dict[str, NativeImage]
    scene: NativeScene
    native: NativeImage
    views: SubImageViews
    options: StereoOptions

    def window(
        self,
        name: str,
        rectangle: Rectangle,
        *,
        with_depth: bool = False,
        with_normal: bool = False,
    ) -> _core.ViewWindow:
        """A window of a native image with its camera, and what the photometric pass found in it."""
        native, camera = self.natives[name], self.scene.cameras[name]

        def read(kind: Literal["depth", "normal"]) -> FloatMap:
            return read_map_window(self.workspace, native, rectangle, kind, "photometric")

        return _core.ViewWindow(
            intrinsics=camera.intrinsics,
            cam_from_world=camera.cam_from_world,
            x0=rectangle.x0,
            y0=rectangle.y0,
            grey=read_window(self.workspace, native.name, rectangle),
            depth=read("depth") if with_depth else None,
            normal=read("normal") if with_normal else None,
        )

    def core_options(self, of_pass: Pass) -> _core.PatchMatchOptions:
        core = _core.PatchMatchOptions()
        known = set(dir(core))
        for field in fields(self.options):
            if field.name in known:
                setattr(core, field.name, getattr(self.options, field.name))
        core.min_depth, core.max_depth = self.views.min_depth, self.views.max_depth
        # The random numbers of an image depend on its name, not on which others there are.
        core.seed = zlib.crc32(f"{self.options.seed} {of_pass} {self.native.name}".encode())
        return core

    def sparse_points(self) -> npt.NDArray[np.float64]:
        seen = self.scene.observations[self.native.name]
        return np.ascontiguousarray(np.column_stack([seen.pixel, seen.depth]))


def _photometric(problem: _Problem) -> DepthMap:
    views = problem.views
    depth, normal, _, num_seeing, _ = _core.patch_match(
        problem.window(problem.native.name, views.window),
        [problem.window(source.name, source.window) for source in views.sources],
        problem.sparse_points(),
        problem.core_options("photometric"),
    )
    return DepthMap(depth, normal, np.where(num_seeing == 0, Reason.NOT_SEEN, 0).astype(np.uint8))


def _geometric(problem: _Problem) -> DepthMap:
    views, options = problem.views, problem.options
    maps = _core.patch_match(
        problem.window(problem.native.name, views.window, with_depth=True, with_normal=True),
        [problem.window(source.name, source.window, with_depth=True) for source in views.sources],
        np.empty((0, 3)),
        problem.core_options("geometric"),
    )
    grey = read_window(problem.workspace, problem.native.name, views.window)
    estimate = Estimate(*maps, patch_variance(grey))
    reason, confidence = filter_depths(
        estimate,
        problem.scene.cameras[problem.native.name].intrinsics,
        views.window,
        read_mask_window(problem.workspace, problem.native.name, views.window),
        len(views.sources),
        options,
    )
    return DepthMap(estimate.depth, estimate.normal, reason, confidence)


def _nothing(problem: _Problem) -> DepthMap:
    shape = (problem.views.window.height, problem.views.window.width)
    return DepthMap(
        np.zeros(shape, np.float32),
        np.zeros((3, *shape), np.float32),
        np.full(shape, Reason.NO_SOURCES, np.uint8),
        np.zeros(shape, np.float32),
    )


def _is_done(workspace: Workspace, sub_image: SubImage, of_pass: Pass) -> bool:
    # The depth map is written last.
    return workspace.depth_map(sub_image, of_pass).exists()


def _write(
    workspace: Workspace, sub_image: SubImage, of_pass: Pass, maps: DepthMap, window: Rectangle
) -> None:
    """Cuts the halo off and writes the maps of what the sub-image stores; missing pixels are 0."""
    rows, columns = sub_image.stored.slices_in(window)
    reason = maps.reason[rows, columns]
    missing = reason != 0
    depth = np.where(missing, np.float32(0), maps.depth[rows, columns])
    normal = np.where(missing, np.float32(0), maps.normal[:, rows, columns])
    if of_pass == "geometric":
        write_map(workspace.reason_map(sub_image), reason.astype(np.float32))
        if maps.confidence is not None:
            write_map(workspace.confidence_map(sub_image), maps.confidence[rows, columns])
    write_map(workspace.normal_map(sub_image, of_pass), normal)
    write_map(workspace.depth_map(sub_image, of_pass), depth)


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


def _name(reason: Reason) -> str:
    return str(reason.name).lower()
