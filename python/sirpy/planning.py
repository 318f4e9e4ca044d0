"""The plan: the grid for a memory budget, with the peak memory that each stage will need.

Every stage says what it holds in bytes per pixel; the windows of a candidate grid are found by view selection
itself, so the prediction knows the sources of this scene. The coarsest grid that fits is chosen: larger
sub-images waste less on halos.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sirpy import _core
from sirpy.errors import BudgetError
from sirpy.memory import gigabytes
from sirpy.model_arrays import read_arrays
from sirpy.native_scene import NativeScene, native_scene
from sirpy.rectangle import Grid
from sirpy.sub_image_model import undistorted_model
from sirpy.view_selection import SubImageViews, sub_image_views
from sirpy.workspace import NativeImage, SubImage

# Python with numpy, pycolmap and rasterio loaded.
_PROCESS_BYTES = 130_000_000
# Sparse models of an observation, with its share of a point: as solved, undistorted, of the sub-images, and on the
# way to the disk. Measured: 130 where five photographs see a point, 190 where two do.
_BYTES_PER_OBSERVATION = 190
# The allocator and the kernel keep a little more than what is asked for.
_SLACK = 1.1
# Bands of rows of the photograph, of the undistorted image and of the files that are open: bytes for each pixel
# of width. The height does not matter.
_CUT_BYTES_PER_COLUMN = 6000
_SMALLEST_SIDE = 256  # of a sub-image, pixels: below this the halo is most of the work
_MOST_IMAGES = 40  # that a plan looks at; evenly chosen when there are more
# Pixels that any stereo holds for each pixel of the reference: the reference and about 10 sources, at about 10
# bytes each, and the maps. For workspaces that are made for other engines.
_ENGINE_BYTES_PER_PIXEL = 200


@dataclass(frozen=True)
class Plan:
    """A grid, and the predicted peak memory (bytes, of the whole process tree) of each stage."""

    grid: Grid
    predicted_peak: dict[str, int]

    @property
    def peak(self) -> int:
        return max(self.predicted_peak.values())


def plan(
    model: Path | str | NativeScene,
    *,
    memory: int | None,
    grid: Grid | None = None,
    num_sources: int = 8,
    halo: int = 32,
) -> Plan:
    """The coarsest grid whose stages stay within `memory`, or the prediction for a given grid.

    Args:
        model: folder of a COLMAP model in native pixels, or the scene of its undistorted images.
        memory: bytes of the whole process tree; None for no bound.
        grid: of sub-images; chosen if None.
        num_sources, halo: as in `views`.

    Raises:
        BudgetError: nothing fits; the message says the least memory that would do.
        InputError: the model cannot be read.
    """
    scene = (
        model
        if isinstance(model, NativeScene)
        else native_scene(undistorted_model(read_arrays(model)))
    )
    least: Plan | None = None
    for candidate in [grid] if grid else _candidates(scene):
        found = Plan(candidate, _predict(scene, candidate, num_sources, halo))
        if memory is None or found.peak <= memory:
            return found
        if least is None or found.peak < least.peak:
            least = found
    assert least is not None  # there is always a 1x1 grid
    subject = f"a grid of {grid} sub-images needs" if grid else "the least that would do is"
    raise BudgetError(
        f"no plan fits into --memory {gigabytes(memory or 0)}: {subject} {gigabytes(least.peak)}, "
        "or fewer --num-sources"
    )


def grid_for_memory(sizes: list[tuple[int, int]], memory: int) -> Grid:
    """A grid for images of these sizes whose sub-images other stereo engines can hold in `memory` bytes.

    Raises:
        BudgetError: not even the smallest sub-images would fit.
    """
    width, height = max(w for w, _ in sizes), max(h for _, h in sizes)
    for candidate in _grids(width, height):
        area = -(-width // candidate.columns) * -(-height // candidate.rows)
        if _ENGINE_BYTES_PER_PIXEL * area <= memory:
            return candidate
    least = _ENGINE_BYTES_PER_PIXEL * _SMALLEST_SIDE**2
    raise BudgetError(
        f"--memory {gigabytes(memory)} is too little for any sub-image: the least that would do is "
        f"{gigabytes(least)}"
    )


def _candidates(scene: NativeScene) -> Iterator[Grid]:
    largest = max(scene.cameras.values(), key=lambda camera: camera.width * camera.height)
    yield from _grids(largest.width, largest.height)


def _grids(width: int, height: int) -> Iterator[Grid]:
    """Grids of about square sub-images, from the whole image down to the smallest sub-images."""
    yielded = set()
    for count in range(1, max(2, max(width, height) // _SMALLEST_SIDE + 1)):
        side = max(width, height) / count
        grid = Grid(max(1, round(width / side)), max(1, round(height / side)))
        if grid not in yielded:
            yielded.add(grid)
            yield grid


def _predict(scene: NativeScene, grid: Grid, num_sources: int, halo: int) -> dict[str, int]:
    cameras = list(scene.cameras.values())
    cameras = cameras[:: -(-len(cameras) // _MOST_IMAGES)]
    stereo = fuse = cut = 0.0
    for camera in cameras:
        native = NativeImage(camera.name, camera.width, camera.height, ())
        cut = max(cut, _CUT_BYTES_PER_COLUMN * camera.width)
        for row, column, core in grid.cores(camera.width, camera.height):
            sub_image = SubImage("", row, column, core, core)
            views = sub_image_views(scene, native, sub_image, num_sources=num_sources, halo=halo)
            stereo = max(stereo, _stereo_bytes(views))
            fuse = max(fuse, _fuse_bytes(core.area, views))
    observations = sum(len(seen.point) for seen in scene.observations.values())
    process = _PROCESS_BYTES + _BYTES_PER_OBSERVATION * observations
    return {
        stage: int(process + _SLACK * peak)
        for stage, peak in (("cut", cut), ("stereo", stereo), ("fuse", fuse))
    }


def _stereo_bytes(views: SubImageViews) -> int:
    """The geometric pass, which holds the depths of the sources too, or the photometric one."""
    sources = sum(source.window.area for source in views.sources)
    peaks = []
    # Beside the core's own: grey 1, depth 4, normal 12 read; grey 1, depth 4 of each source.
    for geometric, reference_bytes, source_bytes in ((False, 1, 1), (True, 17, 5)):
        per_reference, per_source = _core.patch_match_bytes_per_pixel(geometric)
        peaks.append(
            views.window.area * (per_reference + reference_bytes)
            + sources * (per_source + source_bytes)
        )
    return max(peaks)


def _fuse_bytes(area: int, views: SubImageViews) -> int:
    """Depth and its inverse 8, normal 12, colour 3; a point 56 by rows and 45 in arrays."""
    return 124 * area + 8 * sum(source.window.area for source in views.sources)
