"""Fusion: depth maps to one cloud, sub-image by sub-image, stateless (cpp/src/fusion.h).

Each sub-image gives the points of its core; the cloud is their concatenation in the order of the sub-images, the
same whatever the order or number of workers.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sirpy import _core
from sirpy.errors import InputError
from sirpy.files import fingerprint, written_whole
from sirpy.native_images import NativeImage, SubImage
from sirpy.native_scene import NativeScene, read_native_scene
from sirpy.npy import open_npy, write_npy
from sirpy.progress import Progress
from sirpy.rectangle import Rectangle
from sirpy.view_selection import Views, read_views
from sirpy.windows import read_map_window, read_window
from sirpy.workspace import Workspace

# What every reader of PLY clouds knows: 27 bytes per point.
POINT = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    + [(name, "u1") for name in ("red", "green", "blue")]
)


@dataclass(frozen=True)
class FusionOptions:
    """Options of `fuse`; they carry the names and defaults of the C++ core."""

    min_consistent: int = 2  # sources whose depth must agree
    consistency: float = 1.0  # pixels, forward-backward
    keep_duplicates: bool = (
        False  # every view emits the surface, not only the one that sees it best
    )
    threads: int = 0  # 0: one for each core

    def __post_init__(self) -> None:
        if not 1 <= self.min_consistent <= 16:
            raise InputError(
                f"--min-consistent {self.min_consistent} is not possible: choose 1 to 16"
            )
        if self.threads < 0:
            raise InputError(f"--threads {self.threads} is not possible: choose 0 or more")
        if not self.consistency > 0:
            raise InputError(
                f"--consistency {self.consistency} is not possible: choose more than 0"
            )


def fuse(
    workspace: Workspace,
    *,
    options: FusionOptions | None = None,
    progress: Progress | None = None,
) -> int:
    """Fuses the geometric depth maps into fused.ply; returns the number of points.

    Raises:
        InputError: depth maps are missing (run `stereo` first), a file is damaged, or an option is out
            of range.
    """
    options = options or FusionOptions()
    progress = progress or Progress()
    views = read_views(workspace)
    scene = read_native_scene(workspace)
    natives = {native.name: native for native in workspace.natives}
    todo = list(workspace.sub_images())
    for _, sub_image in todo:
        if not workspace.depth_map(sub_image, "geometric").exists():
            raise InputError(
                f"{workspace.depth_map(sub_image, 'geometric')} is missing: run `sirpy stereo` first"
            )
    what = {key: value for key, value in asdict(options).items() if key != "threads"}
    workspace.begin_stage("fuse", fingerprint(workspace.fingerprint_of("stereo"), what))
    with progress.stage("fuse", len(todo), "sub-image") as step:
        for native, sub_image in todo:
            part = workspace.fused_part(sub_image)
            if not part.exists():
                points = _fuse_core(workspace, natives, scene, views, native, sub_image, options)
                write_npy(part, points)
            step.advance()
    return write_cloud(workspace.fused, [workspace.fused_part(sub_image) for _, sub_image in todo])


def write_cloud(path: Path, parts: list[Path]) -> int:
    """Writes the points of all parts (.npy of POINT) as one binary PLY file; returns their number.

    Raises:
        InputError: a part is missing or damaged.
        OutputError: the cloud cannot be written.
    """
    # One part is open at a time: there may be more of them than a process may open files.
    count = sum(len(_open_part(part)) for part in parts)
    kind = {"<f4": "float", "|u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    header += [f"property {kind[POINT[name].str]} {name}" for name in POINT.names or ()]
    with written_whole(path) as temporary, temporary.open("wb") as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii"))
        for part in parts:
            file.write(_open_part(part).tobytes())
    return count


def _open_part(path: Path) -> npt.NDArray[np.void]:
    return open_npy(path, POINT, (None,), "`sirpy fuse`")


def _fuse_core(
    workspace: Workspace,
    natives: dict[str, NativeImage],
    scene: NativeScene,
    views: Views,
    native: NativeImage,
    sub_image: SubImage,
    options: FusionOptions,
) -> npt.NDArray[np.void]:
    def depth_view(name: str, rectangle: Rectangle) -> _core.DepthView:
        camera = scene.cameras[name]
        return _core.DepthView(
            intrinsics=camera.intrinsics,
            cam_from_world=camera.cam_from_world,
            x0=rectangle.x0,
            y0=rectangle.y0,
            rank=views.rank[name],
            depth=read_map_window(workspace, natives[name], rectangle, "depth", "geometric"),
        )

    core_options = _core.FusionOptions()
    for key, value in asdict(options).items():
        setattr(core_options, key, value)
    field = views.fields[native.name]
    windows = {one.name: one.window for one in views.sub_images[sub_image.name].sources}
    core = sub_image.core
    position, normal, pixel, _, _, _ = _core.fuse(
        depth_view(native.name, core),
        read_map_window(workspace, native, core, "normal", "geometric"),
        [
            depth_view(source.name, windows[source.name]) if source.name in windows else None
            for source in field.sources
        ],
        block_side=field.side,
        allowed=field.allowed,
        options=core_options,
    )
    color = read_window(workspace, native.name, core, "color").reshape(-1, 3)[pixel]
    points = np.empty(len(pixel), POINT)
    for axis, (place, direction) in enumerate(zip("xyz", ("nx", "ny", "nz"), strict=True)):
        points[place], points[direction] = position[:, axis], normal[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        points[name] = color[:, channel]
    return points
