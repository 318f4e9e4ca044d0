"""Fusion: depth maps to one cloud, block by block, stateless (cpp/src/fusion.h).

Each sub-image gives the points of its core, in blocks of the native image; a block reads of its sources what its own
depths project to, and no more. The cloud is their concatenation in the order of the sub-images, the same whatever
the order or number of workers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sirpy import _core
from sirpy.cloud import POINT, Points, write_ply
from sirpy.depth_maps import DepthMaps
from sirpy.errors import InputError
from sirpy.files import fingerprint, read_json, write_json
from sirpy.frame import Frame
from sirpy.native_images import LeftOut, SubImage
from sirpy.native_scene import Floats, NativeCamera, NativeScene, read_native_scene
from sirpy.npy import written_npy
from sirpy.progress import Progress
from sirpy.rectangle import Grid, Rectangle
from sirpy.view_fields import ViewField, frustum_corners, projected_boxes
from sirpy.view_selection import Selected, selected_views
from sirpy.windows import FloatMap, read_window
from sirpy.workspace import Workspace

_BLOCK = 512  # pixels of a side, about: what is worked on at a time
_PART = 64  # pixels of a side: of a block, with a depth range of its own
_MOST_HELD = 8_000_000  # pixels of the windows of all sources, for a block
_REACH = 2  # pixels around a projection that interpolation needs


@dataclass(frozen=True)
class FusionOptions:
    """Options of `fuse`; they carry the names and defaults of the C++ core."""

    min_consistent: int = 2  # sources whose depth must agree
    consistency: float = 1.0  # pixels, forward-backward, or
    agreement: float = 1.0  # standard deviations, whichever is more
    keep_duplicates: bool = (
        False  # every view emits the surface, not only the one that sees it best
    )
    thin: bool = False  # depths of coarser levels give one point for each pixel of theirs
    threads: int = 0  # 0: one for each core

    def __post_init__(self) -> None:
        if not 1 <= self.min_consistent <= 16:
            raise InputError(
                f"--min-consistent {self.min_consistent} is not possible: choose 1 to 16"
            )
        if self.threads < 0:
            raise InputError(f"--threads {self.threads} is not possible: choose 0 or more")
        if not 0 < self.consistency < float("inf"):
            raise InputError(
                f"--consistency {self.consistency} is not possible: choose more than 0"
            )


@dataclass(frozen=True)
class Fused:
    """What `fuse` made: the number of points, and the sub-images without a sound depth map."""

    points: int
    left_out: tuple[LeftOut, ...]


def fuse(
    workspace: Workspace,
    *,
    options: FusionOptions | None = None,
    progress: Progress | None = None,
) -> Fused:
    """Fuses the depth maps into fused.ply.

    Sub-images whose depth map is missing or damaged are left out; points of others are confirmed without them.

    Raises:
        InputError: there is no depth map at all (run `stereo` first), another file is damaged, or an option is
            out of range.
    """
    options = options or FusionOptions()
    progress = progress or Progress()
    maps = DepthMaps(workspace)
    for out in maps.left_out:
        progress.note(f"left out: {out.name}: {out.reason}")
    for reason in maps.unused:
        progress.note(f"done without it: {reason}")
    what = {key: value for key, value in asdict(options).items() if key != "threads"}
    workspace.begin_stage("fuse", fingerprint(maps.identity(), what))
    units = [(native.name, sub) for native in maps.natives.values() for sub in native.sub_images]
    parts = [workspace.fused_part(sub) for _, sub in units]
    fusion = _Fusion(workspace, maps, options)
    with progress.stage("fuse", len(units), "sub-image") as step:
        for (name, sub_image), part in zip(units, parts, strict=True):
            if not part.exists():
                with written_npy(part, POINT) as write:
                    for points in fusion.points(name, sub_image):
                        write(points)
                if fusion.num_invalid:
                    progress.note(
                        f"{sub_image.name}: {fusion.num_invalid} pixels of its depth map hold neither a "
                        "depth nor 0: left out"
                    )
            step.advance()
    # Written last: without it there is no cloud to make products of.
    count = write_ply(workspace.fused, parts, Frame())
    write_json(workspace.fused_parts, [sub.name for _, sub in units])
    return Fused(count, tuple(maps.left_out))


def fused_parts(workspace: Workspace) -> list[Path]:
    """The points of the sub-images, (n,) of POINT each, in the model's frame.

    Raises:
        InputError: fusion is not complete.
    """
    again = "run `sirpy fuse` first"
    _ = workspace.natives  # is this a workspace?
    try:
        names = read_json(workspace.fused_parts, lambda names: {str(name) for name in names}, again)
    except FileNotFoundError:
        raise InputError(f"{workspace.folder} has no fused points: {again}") from None
    return [workspace.fused_part(sub) for _, sub in workspace.sub_images() if sub.name in names]


class _Fusion:
    """The points of single sub-images; `num_invalid` pixels of the last one had no sound depth."""

    def __init__(self, workspace: Workspace, maps: DepthMaps, options: FusionOptions) -> None:
        self._workspace, self._maps = workspace, maps
        self._scene: NativeScene = read_native_scene(workspace)
        self._views: Selected = selected_views(workspace, self._scene, maps.natives)
        self._options = _core.FusionOptions()
        for key, value in asdict(options).items():
            setattr(self._options, key, value)
        self.num_invalid = 0

    def points(self, name: str, sub_image: SubImage) -> Iterator[Points]:
        """Of the sub-image's core, block by block."""
        self.num_invalid = 0
        core = sub_image.core
        color = read_window(self._workspace, name, core, "color", again=False)
        columns, rows = (max(1, round(side / _BLOCK)) for side in (core.width, core.height))
        for _, _, block in Grid(columns, rows).tiles(core):
            yield from self._block(name, sub_image, block, color)

    def _block(
        self, name: str, sub_image: SubImage, block: Rectangle, color: npt.NDArray[np.uint8]
    ) -> Iterator[Points]:
        depth = self._maps.depth(name, block)
        if not depth.any():
            return
        camera, field = self._scene.cameras[name], self._field(name)
        windows = source_windows(self._scene.cameras, field, block, depth)
        held = sum(window.area for window in windows if window is not None)
        if held > _MOST_HELD and max(block.width, block.height) > _PART:
            # Stray depths: in smaller parts they need less. The points are the same.
            grid = Grid(1 + (block.width > _PART), 1 + (block.height > _PART))
            for _, _, part in grid.tiles(block):
                yield from self._block(name, sub_image, part, color)
            return
        points, (invalid, *_) = _core.fuse(
            self._depth_view(name, block, depth),
            self._maps.normal(name, sub_image, block, camera.intrinsics, self._options.threads),
            np.ascontiguousarray(color[block.slices_in(sub_image.core)]),
            self._maps.confidence(name, sub_image, block),
            self._maps.level(name, block),
            [
                self._depth_view(source.name, window, self._maps.depth(source.name, window))
                if window is not None
                else None
                for source, window in zip(field.sources, windows, strict=True)
            ],
            block_side=field.side,
            allowed=field.allowed,
            options=self._options,
        )
        self.num_invalid += invalid
        yield points.view(POINT)

    def _field(self, name: str) -> ViewField:
        """Without the sources of which no depth map is left: none of them can be asked to agree."""
        field = self._views.field(name)
        bits = [1 << i for i, one in enumerate(field.sources) if one.name in self._maps.natives]
        return replace(field, allowed=field.allowed & np.uint32(sum(bits)))

    def _depth_view(self, name: str, window: Rectangle, depth: FloatMap) -> _core.DepthView:
        camera = self._scene.cameras[name]
        return _core.DepthView(
            intrinsics=camera.intrinsics,
            cam_from_world=camera.cam_from_world,
            x0=window.x0,
            y0=window.y0,
            rank=self._views.rank[name],
            depth=depth,
            sigma=self._maps.sigma(name, window),
        )


def source_windows(
    cameras: Mapping[str, NativeCamera], field: ViewField, block: Rectangle, depth: FloatMap
) -> list[Rectangle | None]:
    """What of each source of `field` the depths (height, width) of a block project to; None where nothing."""
    parts, ranges = _depth_ranges(block, depth)
    allowed = np.bitwise_or.reduce(field.allowed[field.blocks(block)], axis=None)
    corners = frustum_corners(cameras[field.name], parts, ranges)
    windows: list[Rectangle | None] = []
    for index, source in enumerate(field.sources):
        window = None
        if parts and allowed >> np.uint32(index) & 1 and source.name in cameras:
            camera = cameras[source.name]
            boxes = projected_boxes(camera, corners)
            x0, y0 = np.floor(boxes[:, :2].min(axis=0)).astype(int) - _REACH
            x1, y1 = np.ceil(boxes[:, 2:].max(axis=0)).astype(int) + _REACH
            whole = Rectangle(0, 0, camera.width, camera.height)
            found = Rectangle.from_corners(int(x0), int(y0), int(x1), int(y1)).intersection(whole)
            window = found if found.area else None
        windows.append(window)
    return windows


def _depth_ranges(block: Rectangle, depth: FloatMap) -> tuple[list[Rectangle], Floats]:
    """Parts of a block that hold depths, and the nearest and farthest (n, 2) of each."""
    sound = (depth > 1e-30) & (depth < 1e30)
    rows, columns = range(0, block.height, _PART), range(0, block.width, _PART)

    def reduced(of: np.ufunc, fill: float) -> Floats:
        filled = np.where(sound, depth, fill)
        found: Floats = of.reduceat(of.reduceat(filled, rows, axis=0), columns, axis=1)
        return found

    nearest, farthest = reduced(np.minimum, np.inf), reduced(np.maximum, 0.0)
    held = np.argwhere(farthest > 0)
    parts = [
        Rectangle(
            block.x0 + int(column) * _PART, block.y0 + int(row) * _PART, _PART, _PART
        ).intersection(block)
        for row, column in held
    ]
    return parts, np.column_stack([nearest[farthest > 0], farthest[farthest > 0]])
