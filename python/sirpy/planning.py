"""The plan: the grid for a memory budget, with what each stage will write and need.

Every stage says what it holds in bytes per pixel; the windows of a candidate grid are found by view selection
itself, so the prediction knows the sources of this scene. The coarsest grid that fits is chosen: larger
sub-images waste less on halos. Times are estimates from what was measured (docs/performance.md).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from sirpy.area import AreaFilter
from sirpy.dense_stereo import stereo_passes
from sirpy.errors import BudgetError, InputError
from sirpy.layout import Layout, Region
from sirpy.memory import IMAGE_CACHE_BYTES, gigabytes
from sirpy.model_arrays import read_arrays
from sirpy.native_images import NativeImage, SubImage
from sirpy.native_scene import NativeScene, native_scene
from sirpy.photograph_detail import photograph_details, spoken_details
from sirpy.photographs import open_photograph
from sirpy.rectangle import Grid
from sirpy.stereo_backend import StereoBackend, StereoOptions
from sirpy.sub_image_model import undistorted_model
from sirpy.view_selection import check_num_sources
from sirpy.view_windows import HALO, ViewSelection, top_level

# Python with numpy, pycolmap and rasterio loaded, and what a plan and a cut leave behind in its heap.
_PROCESS_BYTES = 135_000_000
# Sparse models of an observation, with its share of a point: as solved, undistorted, of the sub-images, and on the
# way to the disk. Measured: 130 where five photographs see a point, 190 where two do.
_BYTES_PER_OBSERVATION = 190
# The allocator and the kernel keep a little more than what is asked for.
_SLACK = 1.1
# Bands of rows of the photograph, of the undistorted image and of the files that are open: bytes for each pixel
# of width, with a lens that bends lines by some per cent. The height does not matter.
_CUT_BYTES_PER_COLUMN = 3000
_SHRINKING_BYTES = (
    50_000_000  # of stereo: bands of native pixels on their way to the coarsest level
)
# Fusion: the colours of the core; maps, windows of sources and points of a block of 512 x 512.
_FUSE_BYTES, _FUSE_BLOCK_BYTES = (3, 0), 100_000_000
# What stereo on a GPU holds here, for each pixel of the reference: the image, ranges, random numbers, the result.
_GIVEN_TO_A_DEVICE = 25
_REPORT_BYTES = 220_000_000  # its pictures, whatever the photographs
_SMALLEST_SIDE = 256  # of a sub-image, pixels: below this the halo is most of the work
# Photographs and sub-images that a plan looks at, evenly chosen when there are more; and sub-images while a grid is
# searched for.
_MOST_IMAGES, _MOST_SUB_IMAGES, _MOST_WHILE_SEARCHING = 40, 600, 150
_WIDEST = (
    8_192  # of a sub-image, pixels, unless asked for: stereo addresses windows of 32,767 in a row
)
_NOTABLE_BYTES = 200_000_000  # of what has to be held of a photograph
# Pixels that any stereo holds for each pixel of the reference: the reference and about 10 sources, at about 10
# bytes each, and the maps. For workspaces that are made for other engines.
_ENGINE_BYTES_PER_PIXEL = 200

# CPU microseconds: per native pixel; views per photograph and per sub-image.
_CUT_TIME, _FUSE_TIME, _REPORT_TIME = 0.025, 0.3, 0.05
_VIEWS_TIME = 60_000.0, 1_500.0
# Bytes on disk: of a stored pixel as JPEG of quality 95 and as PNG; its maps (depth 4, normal 12, reason 4,
# confidence 4, standard deviation 4, level 4) and those of the passes, while stereo runs (28 and 40 a level, the
# latter not of the last: 51 in all); points per pixel, 56 bytes each in its part and again in the cloud.
_JPEG_BYTES, _PNG_BYTES = 0.5, 2.0
_MAP_FILES, _MAP_BYTES = 6, 83
_POINTS_PER_PIXEL, _POINT_BYTES = 0.3, 112


@dataclass(frozen=True)
class StagePlan:
    """What one stage will do and need."""

    name: str
    units: int
    unit: str
    peak: int  # predicted bytes of the whole process tree
    cpu_s: float  # estimate
    wall_s: float  # estimate, on all cores
    bytes_per_pixel: tuple[int, int] | None = None  # of the reference, and of its source windows


@dataclass(frozen=True)
class Plan:
    """A grid, what will be written with it, and what each stage will need."""

    grid: Grid
    photographs: int
    megapixels: float  # that are cut, without overlap
    sub_images: int
    largest: tuple[int, int]  # (width, height) of the largest sub-image file, pixels
    source_megapixels: tuple[float, float]  # mean and largest sum of a sub-image's source windows
    files: int
    written_bytes: int  # estimate
    stages: tuple[StagePlan, ...]
    device_load: float = 0.0  # share of a GPU's memory that stereo needs at most
    notes: tuple[str, ...] = ()  # what the user should know about the photographs

    @property
    def predicted_peak(self) -> dict[str, int]:
        """Bytes of the whole process tree, by stage."""
        return {stage.name: stage.peak for stage in self.stages}

    @property
    def peak(self) -> int:
        return max(stage.peak for stage in self.stages)


def plan(
    model: Path | str | NativeScene,
    *,
    memory: int | None,
    grid: Grid | None = None,
    overlap: int = 0,
    region: Region = Region(),
    images: Path | str | None = None,
    num_sources: int = 8,
    halo: int = HALO,
    stereo: StereoOptions = StereoOptions(),
    detail: bool = False,
) -> Plan:
    """The coarsest grid whose stages stay within `memory`, or the prediction for a given grid.

    Args:
        model: folder of a COLMAP model in native pixels, or the scene of its undistorted images.
        memory: bytes of the whole process tree; None for no bound.
        grid: of sub-images; chosen if None.
        overlap, region: as in `cut`.
        images: folder of the photographs, to look at what their headers say; some formats have to
            be held while they are read.
        num_sources, halo: as in `views`.
        stereo: as in `stereo`: each backend has its own needs.
        detail: whether to decode some of the photographs too, and note what they resolve.

    Raises:
        BudgetError: nothing fits; the message says the least memory that would do.
        InputError: the model cannot be read, or the region or the grid does not fit the images.
    """
    check_num_sources(num_sources)
    scene = (
        model
        if isinstance(model, NativeScene)
        else native_scene(undistorted_model(read_arrays(model)))
    )
    seeing = AreaFilter(region.area, scene) if region.area is not None else None
    # Which photographs are cut, and how much of them at most, does not depend on the grid.
    uncut = _cut_images(scene, Layout(Grid(1, 1), 0, region), seeing, list(scene.cameras))
    if seeing is not None and not uncut:
        raise seeing.nothing_left()
    names = list(uncut)
    held, notes = _held_bytes(Path(images), names) if images else ({}, ())
    if images and detail:
        details = photograph_details(Path(images), names)
        notes = (*notes, *spoken_details(details, len(names)))
    covered = {name: native.covered for name, native in uncut.items()}
    selection = ViewSelection(scene, covered, num_sources, halo)
    top = top_level(((one.width, one.height) for one in uncut.values()), selection.coarsest)
    passes = stereo_passes(selection.coarsest, top, stereo, scratch=None)

    def predict(candidate: Grid, some: list[str], most: int = _MOST_SUB_IMAGES) -> Plan:
        layout = Layout(candidate, overlap, region)
        # Smaller sub-images lie closer to what they see: an area may be seen by none of some.
        natives = _cut_images(scene, layout, seeing, some)
        natives = natives or _cut_images(scene, layout, seeing, names)
        return _predict(selection, passes, candidate, natives, held, notes, most)

    device_loads: list[float] = []

    def needed(found: Plan) -> int:
        # A device of its own is to be filled no more than the memory is.
        device_loads.append(found.device_load)
        return max(found.peak, int(found.device_load * (memory or 0)))

    candidates, peaks = [grid] if grid else _candidates(scene, region, names), list[int]()
    if grid is None and memory is not None:
        some = names[:: -(-len(names) // _MOST_IMAGES)]
        first, least = _coarsest(
            candidates, lambda one: needed(predict(one, some, _MOST_WHILE_SEARCHING)), memory
        )
        candidates, peaks = candidates[first:], [least]
    for candidate in candidates:  # the first, unless what was not looked at needs more
        found = predict(candidate, names)
        if memory is None or needed(found) <= memory:
            return found
        peaks.append(needed(found))
    if device_loads and min(device_loads) > 1:
        raise BudgetError(
            f"the GPU has too little memory: the least that would do is {min(device_loads):.2g} times as "
            "much; run on the processor (--device cpu)"
        )
    subject = f"a grid of {grid} sub-images needs" if grid else "the least that would do is"
    least = min(peaks)
    raise BudgetError(
        f"no plan fits into --memory {gigabytes(memory or 0)}: {subject} {gigabytes(least)}, "
        "or fewer --num-sources"
    )


def _coarsest(candidates: list[Grid], peak: Callable[[Grid], int], memory: int) -> tuple[int, int]:
    """The place of the first candidate whose peak is within `memory`, the end if there is none, and the
    least peak that was seen.

    By bisection: the peak falls from one candidate to the next, but for some per cent.
    """
    peaks: dict[int, int] = {}

    def fits(index: int) -> bool:
        peaks[index] = peak(candidates[index])
        return peaks[index] <= memory

    low, high = 0, len(candidates) - 1
    if fits(0):
        return 0, peaks[0]
    if high == 0 or not fits(high):
        return len(candidates), min(peaks.values())
    while high - low > 1:
        middle = (low + high) // 2
        if fits(middle):
            high = middle
        else:
            low = middle
    return high, min(peaks.values())


def grid_for_memory(
    sizes: list[tuple[int, int]], memory: int, *, overlap: int = 0, multiple: int = 0
) -> Grid:
    """A grid for images of these sizes whose sub-images other stereo engines can hold in `memory` bytes.

    Args:
        sizes: (width, height) in pixels of what is cut and may be stored.
        overlap, multiple: `overlap` and `same_size` of `cut`, pixels: what is stored counts.

    Raises:
        BudgetError: not even the smallest sub-images would fit.
    """
    width, height = max(w for w, _ in sizes), max(h for _, h in sizes)

    def stored(side: int, parts: int) -> int:
        # A part has a neighbour on both sides, on one of them, or none.
        grown = min(side, -(-side // parts) + min(parts - 1, 2) * overlap)
        return min(side, -(-grown // multiple) * multiple) if multiple else grown

    least = None
    for candidate in _grids(width, height):
        area = stored(width, candidate.columns) * stored(height, candidate.rows)
        if _ENGINE_BYTES_PER_PIXEL * area <= memory:
            return candidate
        least = min(least or area, area)
    assert least is not None  # there is always a 1x1 grid
    raise BudgetError(
        f"--memory {gigabytes(memory)} is too little for any sub-image: the least that would do is "
        f"{gigabytes(_ENGINE_BYTES_PER_PIXEL * least)}"
    )


def _candidates(scene: NativeScene, region: Region, names: list[str]) -> list[Grid]:
    """From one sub-image a photograph to the smallest, as far as every photograph can be cut so."""
    whole = [scene.cameras[name] for name in names]
    cut = [region.roi_of(one.name) or one for one in whole]
    largest = max(cut, key=lambda one: one.width * one.height)
    columns, rows = min(one.width for one in cut), min(one.height for one in cut)
    grids = [
        grid
        for grid in _grids(largest.width, largest.height)
        if grid.columns <= columns and grid.rows <= rows
    ]
    return [grid for grid in grids if largest.width <= _WIDEST * grid.columns] or grids


def _grids(width: int, height: int) -> Iterator[Grid]:
    """Grids of about square sub-images, from the whole image down to the smallest sub-images."""
    yielded = set()
    for count in range(1, max(2, max(width, height) // _SMALLEST_SIDE + 1)):
        side = max(width, height) / count
        grid = Grid(max(1, round(width / side)), max(1, round(height / side)))
        if grid not in yielded:
            yielded.add(grid)
            yield grid


def _cut_images(
    scene: NativeScene, layout: Layout, seeing: AreaFilter | None, names: list[str]
) -> dict[str, NativeImage]:
    """By name, those of the native images of which something is cut."""
    layout.check_names(scene.cameras)
    cameras = [scene.cameras[name] for name in names]
    natives = [layout.native_image(one.name, (one.width, one.height)) for one in cameras]
    if seeing is not None:
        natives = [native for native in map(seeing, natives) if native.sub_images]
    return {native.name: native for native in natives}


def _held_bytes(images: Path, names: list[str]) -> tuple[dict[str, int], tuple[str, ...]]:
    """What the reader of each photograph must hold beside a band of rows, by name, and what to say."""
    held: dict[str, int] = {}
    broken: list[str] = []
    for name in names:
        try:
            photograph = open_photograph(images / name)
        except InputError as error:
            broken.append(str(error))
            continue
        held[name] = photograph.held_bytes
    notes = []
    if broken:
        notes.append(f"{len(broken)} photographs would be left out; the first one: {broken[0]}")
    if (count := sum(size > _NOTABLE_BYTES for size in held.values())) > 0:
        notes.append(
            f"{count} photographs cannot be read row by row (progressive JPEG, TIFF of tall strips or "
            f"tiles): up to {gigabytes(max(held.values()))} more while one of them is cut"
        )
    return held, tuple(notes)


def _predict(
    selection: ViewSelection,
    passes: list[StereoBackend],
    grid: Grid,
    natives: dict[str, NativeImage],
    held: dict[str, int],
    notes: tuple[str, ...],
    most_sub_images: int,
) -> Plan:
    scene = selection.scene
    looked_at = list(natives.values())[:: -(-len(natives) // _MOST_IMAGES)]
    units = [(native, sub) for native in looked_at for sub in native.sub_images]
    chosen = units[:: -(-len(units) // most_sub_images)]
    # (pixels of the source windows, views) of each sub-image that is looked at.
    found = [
        (sum(source.window.area for source in views.sources), views)
        for native, sub in chosen
        for views in [selection.sub_image(native.name, sub)]
    ]
    stored = [sub.stored for native in natives.values() for sub in native.sub_images]
    core = sum(sub.core.area for native in natives.values() for sub in native.sub_images)
    pixels = sum(one.area for one in stored)
    share = len(stored) / len(found)  # of what was not looked at
    stereo_time = share * sum(
        views.window.area * (one.cpu_us[0] + one.cpu_us[1] * count)
        for one in passes
        for _, views in found
        for count in [min(len(views.sources), selection.num_sources)]
    )
    views_time = _VIEWS_TIME[0] * len(natives) + _VIEWS_TIME[1] * len(stored)
    observations = sum(len(seen.point) for seen in scene.observations.values())
    process = _PROCESS_BYTES + _BYTES_PER_OBSERVATION * observations
    process += max(one.loaded_bytes for one in passes)
    whole = [scene.cameras[name] for name in natives]
    cut = max(_CUT_BYTES_PER_COLUMN * one.width + held.get(one.name, 0) for one in whole)
    fuse = _FUSE_BYTES[0] * max(one.area for one in stored) + _FUSE_BLOCK_BYTES
    stereo, device_load = 0, 0.0
    for one in passes:
        held_bytes = _stereo_bytes(one, selection, chosen, looked_at)
        if one.device_bytes is None:
            stereo = max(stereo, held_bytes)
        else:
            stereo = max(stereo, _GIVEN_TO_A_DEVICE * max(one.area for one in stored))
            device_load = max(device_load, _SLACK * held_bytes / one.device_bytes)
    bytes_per_pixel = max(map(_stereo_bytes_per_pixel, passes))
    cached = min(IMAGE_CACHE_BYTES, pixels)
    cores = os.cpu_count() or 1
    count, unit = len(stored), "sub-image"

    def stage(
        name: str,
        units: tuple[int, str],
        held_bytes: float,
        time: float,
        threads: int,
        bytes_per_pixel: tuple[int, int] | None = None,
    ) -> StagePlan:
        peak = int(process + _SLACK * held_bytes)
        seconds = time * 1e-6
        return StagePlan(name, *units, peak, seconds, seconds / threads, bytes_per_pixel)

    native_pixels = sum(one.width * one.height for one in whole)
    return Plan(
        grid=grid,
        photographs=len(natives),
        megapixels=core / 1e6,
        sub_images=count,
        largest=max(((one.width, one.height) for one in stored), key=lambda s: (s[0] * s[1], s)),
        source_megapixels=(
            sum(sources for sources, _ in found) / len(found) / 1e6,
            max(sources for sources, _ in found) / 1e6,
        ),
        files=(2 + _MAP_FILES) * count,
        written_bytes=int(
            sum(_bytes_on_disk(native) for native in natives.values())
            + _MAP_BYTES * pixels
            + _POINTS_PER_PIXEL * _POINT_BYTES * core
        ),
        stages=(
            stage("cut", (len(natives), "photograph"), cut, _CUT_TIME * native_pixels, cores),
            stage("views", (count, unit), 0, views_time, 1),
            stage("stereo", (count, unit), cached + stereo, stereo_time, cores, bytes_per_pixel),
            stage("fuse", (count, unit), fuse, _FUSE_TIME * core, cores, _FUSE_BYTES),
            stage("report", (1, "page"), _REPORT_BYTES, _REPORT_TIME * core, 1),
        ),
        device_load=device_load,
        notes=notes,
    )


def _stereo_bytes(
    of_pass: StereoBackend,
    selection: ViewSelection,
    sub_images: list[tuple[NativeImage, SubImage]],
    natives: list[NativeImage],
) -> int:
    """Of the largest unit of a pass."""
    if of_pass.level >= selection.coarsest:
        whole = (selection.pixels(native.name, None) for native in natives)
        return max(of_pass.memory(*pixels) for pixels in whole) + _SHRINKING_BYTES
    level, halo = of_pass.level, of_pass.halo << of_pass.level
    parts = (selection.pixels(native.name, sub, halo) for native, sub in sub_images)
    return max(of_pass.memory(*(count >> 2 * level for count in counts)) for counts in parts)


def _stereo_bytes_per_pixel(of_pass: StereoBackend) -> tuple[int, int]:
    """Of the reference window and of the source windows, where there are several sources."""
    many = 1_000_000
    base = of_pass.memory(many, 8 * many)
    return (
        (of_pass.memory(2 * many, 8 * many) - base) // many,
        (of_pass.memory(many, 9 * many) - base) // many,
    )


def _bytes_on_disk(native: NativeImage) -> float:
    """Of the sub-images of a photograph, roughly: JPEG stays JPEG."""
    is_jpeg = PurePosixPath(native.name).suffix.lower() in (".jpg", ".jpeg")
    pixels = sum(sub.stored.area for sub in native.sub_images)
    return (_JPEG_BYTES if is_jpeg else _PNG_BYTES) * pixels
