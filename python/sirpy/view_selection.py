"""View selection: what each reference sub-image is matched against, how deep, and in which windows.

For a reference sub-image the sparse points seen in and around it tell the depth range (robust percentiles) and
which native images make good sources: many shared points, seen under good angles at a like resolution (the score
of OpenMVS). The window of a source is what the frustum of the sub-image, between the two depths, projects to, so
no match is lost at a border of the grid.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sirpy.colmap_lists import is_listable, is_source, names_note
from sirpy.errors import InputError
from sirpy.files import fingerprint, read_json, write_json, written_whole
from sirpy.native_images import NativeImage, SubImage
from sirpy.native_scene import (
    Floats,
    Indices,
    NativeCamera,
    NativeScene,
    Observations,
    read_native_scene,
)
from sirpy.progress import Progress
from sirpy.rectangle import Rectangle
from sirpy.workspace import Workspace

ALIGNMENT = 8  # native pixels: windows start and end on the lattice of the coarsest pyramid level
MOST_SOURCES = 16  # of a sub-image: what the estimator holds
PATCH_REACH = (
    9  # native pixels: a patch of radius 4, magnified at most 2 times in the source, and a pixel
)

_ENOUGH_POINTS = 60  # that give a depth range and a choice of sources
_BLOCKS_OF_A_SIDE = 4
_MIN_SHARED = 8  # sparse points that a source must share with the reference
_DEPTH_PERCENTILES = (1.0, 99.0)
_DEPTH_MARGIN = 0.25  # of the range of the sparse points, on both sides
_LEAST_DEPTH_MARGIN = 0.02  # of the depth
_SOURCE_SUB_IMAGES = 20  # of other images, listed for COLMAP


@dataclass(frozen=True)
class Source:
    """A native image to match against, and the rectangle of it (native pixels) that can be needed."""

    name: str
    window: Rectangle


@dataclass(frozen=True)
class SubImageViews:
    """The problem of one reference sub-image; no sources where too few sparse points are seen."""

    name: str
    window: Rectangle  # of the reference: what it stores and the halo, native pixels
    min_depth: float  # z in the reference camera, world units
    max_depth: float
    sources: tuple[Source, ...]  # the best first


@dataclass(frozen=True)
class Views:
    """`sub_images` by name; `rank` of each native image in fusion: 0 has the finest sampling."""

    sub_images: dict[str, SubImageViews]
    rank: dict[str, int]


def views(
    workspace: Workspace,
    *,
    num_sources: int = 8,
    halo: int = 32,
    progress: Progress | None = None,
) -> Views:
    """Chooses sources, depth range and windows of every sub-image; writes views.json and patch-match.cfg.

    Args:
        workspace: with its sub-images and models (see `cut`).
        num_sources: native images that each place is matched against, at most (1 to 16); a
            sub-image takes those of all its places, 16 at most.
        halo: native pixels around a sub-image that are estimated with it and thrown away.

    Raises:
        InputError: an option out of range, or no sub-image has a source.
    """
    check_num_sources(num_sources)
    if halo < 0:
        raise InputError(f"--halo {halo} is not possible: choose 0 or more pixels")
    natives = workspace.natives  # before anything is written: is this a workspace?
    begun = workspace.begin_stage(
        "views", fingerprint(workspace.fingerprint_of("cut"), num_sources, halo)
    )
    if begun and workspace.views.exists():
        return read_views(workspace)
    scene = read_native_scene(workspace)
    covered = {native.name: native.covered for native in natives}
    found: dict[str, SubImageViews] = {}
    with (progress or Progress()).stage(
        "views", sum(len(native.sub_images) for native in natives), "sub-image"
    ) as step:
        for native, sub_image in workspace.sub_images():
            found[sub_image.name] = sub_image_views(
                scene, native, sub_image, num_sources=num_sources, halo=halo, covered=covered
            )
            step.advance()
    if not any(one.sources for one in found.values()):
        raise InputError(
            f"no sub-image of {workspace.folder} shares enough sparse points with another photograph: "
            "check that the model and the photographs belong together and overlap"
        )
    result = Views(found, _ranks(scene))
    _write_colmap_lists(workspace, result)
    if progress and (note := names_note(found, sources=True)):
        progress.note(note)
    _write_views(workspace.views, result)
    return result


def check_num_sources(num_sources: int) -> None:
    """Raises InputError unless stereo can match against so many sources."""
    if not 1 <= num_sources <= MOST_SOURCES:
        raise InputError(f"--num-sources {num_sources} is not possible: choose 1 to {MOST_SOURCES}")


def read_views(workspace: Workspace) -> Views:
    """What `views` wrote.

    Raises:
        InputError: the workspace has no views.json yet, or it is damaged.
    """
    mend = "delete it and run `sirpy views` again"
    try:
        found = read_json(workspace.views, _parsed_views, mend)
    except FileNotFoundError:
        raise InputError(
            f"{workspace.folder} has no views.json: run `sirpy views` before stereo and fusion"
        ) from None
    natives = {native.name for native in workspace.natives}
    sub_images = {sub.name for _, sub in workspace.sub_images()}
    sources = {source.name for one in found.sub_images.values() for source in one.sources}
    if found.sub_images.keys() != sub_images or not natives | sources <= found.rank.keys():
        raise InputError(f"{workspace.views} is of other sub-images than sir.json: {mend}")
    return found


def _parsed_views(stored: Any) -> Views:
    found = [
        SubImageViews(
            str(one["name"]),
            Rectangle(*map(int, one["window"])),
            float(one["min_depth"]),
            float(one["max_depth"]),
            tuple(
                Source(str(s["name"]), Rectangle(*map(int, s["window"]))) for s in one["sources"]
            ),
        )
        for one in stored["sub_images"]
    ]
    rank = {str(name): int(value) for name, value in stored["rank"].items()}
    return Views({one.name: one for one in found}, rank)


def aligned(window: Rectangle, image: Rectangle) -> Rectangle:
    """The smallest window around `window` on the pyramid's lattice, cut to the image; it may be empty."""
    inside = window.intersection(image)
    if not inside.area:
        return inside
    return Rectangle.from_corners(
        inside.x0 // ALIGNMENT * ALIGNMENT,
        inside.y0 // ALIGNMENT * ALIGNMENT,
        -(-inside.x1 // ALIGNMENT) * ALIGNMENT,
        -(-inside.y1 // ALIGNMENT) * ALIGNMENT,
    ).intersection(image)


def source_window(
    reference: NativeCamera,
    window: Rectangle,
    depths: tuple[float, float],
    source: NativeCamera,
    covered: Rectangle | None = None,
) -> Rectangle:
    """What `window` of the reference, between two depths, projects to in the source, with the patch's reach.

    Within `covered`, what the sub-images of the source hold of it; all of it if None.

    The frustum between two depths is convex, so the bounding box of its eight projected corners holds all
    of it. Where a corner lies behind the source nothing can be said, and it is all that there is.
    """
    whole = Rectangle(0, 0, source.width, source.height)
    if covered is not None:
        whole = aligned(covered, whole)
    x = np.array([window.x0, window.x1, window.x1, window.x0] * 2, dtype=np.float64)
    y = np.array([window.y0, window.y0, window.y1, window.y1] * 2, dtype=np.float64)
    corners = reference.world(np.column_stack([x, y]), np.repeat(depths, 4))
    if (source.in_camera(corners)[:, 2] <= 0).any():
        return whole
    pixels = source.project(corners)
    low, high = np.floor(pixels.min(axis=0)), np.ceil(pixels.max(axis=0))
    box = Rectangle.from_corners(int(low[0]), int(low[1]), int(high[0]), int(high[1]))
    return aligned(box.padded(PATCH_REACH), whole)


def sub_image_views(
    scene: NativeScene,
    native: NativeImage,
    sub_image: SubImage,
    *,
    num_sources: int,
    halo: int,
    covered: Mapping[str, Rectangle] | None = None,
) -> SubImageViews:
    """Depth range, sources and windows of one sub-image.

    Args:
        covered: what the sub-images of each native image hold of it; all of it if None. Images that
            it does not name are no sources.
    """
    whole = native.rectangle if covered is None else aligned(covered[native.name], native.rectangle)
    window = aligned(sub_image.stored.padded(halo), whole)
    reference = scene.cameras[native.name]
    seen = scene.observations[native.name]
    near = observations_around(scene, native, sub_image.core)
    if len(near) < 3:
        return SubImageViews(sub_image.name, window, 0.0, 0.0, ())
    depths = _depth_range(seen.depth[near])
    windows: dict[str, Rectangle] = {}

    def has_part(name: str) -> bool:
        if covered is not None and name not in covered:
            return False
        if name not in windows:
            within = None if covered is None else covered[name]
            windows[name] = source_window(reference, window, depths, scene.cameras[name], within)
        return min(windows[name].width, windows[name].height) > 2 * PATCH_REACH

    chosen: Counter[str] = Counter()
    for block in _blocks(native, sub_image.stored):
        points = seen.point[observations_around(scene, native, block)]
        ranked = _scored_sources(scene, native.name, points)
        best = list(islice(filter(has_part, ranked), num_sources))
        # The best of each block come before the second best of any.
        chosen.update({name: 1 << (MOST_SOURCES - i) for i, name in enumerate(best)})
    names = sorted(chosen, key=lambda name: (-chosen[name], name))[:MOST_SOURCES]
    sources = tuple(Source(name, windows[name]) for name in names)
    return SubImageViews(sub_image.name, window, *depths, sources)


def points_seen(scene: NativeScene, native: str, rectangle: Rectangle) -> int:
    """How many sparse points a native image sees in a rectangle (native pixels)."""
    return int(np.count_nonzero(_inside(scene.observations[native], rectangle)))


def source_scores(
    scene: NativeScene, native: NativeImage, rectangle: Rectangle
) -> dict[str, float]:
    """Native images by their score as sources of a rectangle (native pixels), the best first.

    The points are those in the rectangle or, where they are few, around it, as for the depth range.
    """
    near = observations_around(scene, native, rectangle)
    return _scored_sources(scene, native.name, scene.observations[native.name].point[near])


def _blocks(native: NativeImage, rectangle: Rectangle) -> list[Rectangle]:
    """Quarters of the native image's longest side that touch the rectangle.

    Sources are chosen for each of them: the parts of a large sub-image are seen by different
    photographs, and the choice must not depend on how the image is cut.
    """
    side = -(-max(native.width, native.height) // _BLOCKS_OF_A_SIDE)
    blocks = [
        Rectangle(x0, y0, side, side).intersection(native.rectangle)
        for y0 in range(0, native.height, side)
        for x0 in range(0, native.width, side)
    ]
    return [block for block in blocks if block.intersection(rectangle).area]


def observations_around(scene: NativeScene, native: NativeImage, rectangle: Rectangle) -> Indices:
    """Indices of the observations in a region around a rectangle that grows until it holds enough."""
    seen = scene.observations[native.name]
    margin = max(1, max(rectangle.width, rectangle.height) // 8)
    while True:
        region = rectangle.padded(margin)
        inside = _inside(seen, region)
        if inside.sum() >= _ENOUGH_POINTS or region.contains(native.rectangle):
            return np.flatnonzero(inside)
        margin *= 2


def _inside(seen: Observations, rectangle: Rectangle) -> npt.NDArray[np.bool_]:
    x, y = seen.pixel[:, 0], seen.pixel[:, 1]
    return (x >= rectangle.x0) & (x < rectangle.x1) & (y >= rectangle.y0) & (y < rectangle.y1)


def _depth_range(depth: Floats) -> tuple[float, float]:
    low, middle, high = np.percentile(depth, [_DEPTH_PERCENTILES[0], 50, _DEPTH_PERCENTILES[1]])
    margin = max(_DEPTH_MARGIN * (high - low), _LEAST_DEPTH_MARGIN * middle)
    return float(max(low - margin, 0.1 * low)), float(high + margin)


def _scored_sources(scene: NativeScene, reference: str, points: Indices) -> dict[str, float]:
    """Scores of native images over the given points, the best first; those with hardly a shared point
    are left out.

    Only the cameras that see one of the points are touched: the work does not grow with the number of
    photographs.
    """
    start, camera = scene.observers
    count = start[points + 1] - start[points]
    which = np.repeat(np.arange(len(points)), count)
    offset = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    present, observer = np.unique(
        camera[np.repeat(start[points], count) + offset], return_inverse=True
    )
    every = list(scene.cameras)
    names = [every[i] for i in present]
    other = np.array([name != reference for name in names], bool)[observer]
    which, observer = which[other], observer[other]

    world = scene.points[points[which]]
    centres = np.array([scene.cameras[name].centre for name in names]).reshape(-1, 3)
    focals = np.array([scene.cameras[name].intrinsics[0, 0] for name in names])
    here = scene.cameras[reference].centre - world
    there = centres[observer] - world
    here_distance, there_distance = np.linalg.norm(here, axis=1), np.linalg.norm(there, axis=1)
    cosine = (here * there).sum(axis=1) / (here_distance * there_distance)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    # OpenMVS: best at 12 degrees; a source may be finer by up to 1.6, other ratios count less.
    angle_sigma = np.where(angle < 12, 0.38 * 12, 0.7 * 12)
    angle_weight = np.maximum(np.exp(-((angle - 12) ** 2) / (2 * angle_sigma**2)), 0.1)
    angle_weight[angle < 1] = 0.0
    own_focal = scene.cameras[reference].intrinsics[0, 0]
    ratio = (here_distance / own_focal) / (there_distance / focals[observer])
    scale_weight = np.where(
        ratio > 1.6, (1.6 / ratio) ** 2, np.where(ratio < 1, np.minimum(ratio, 1) ** 2, 1.0)
    )
    score = np.bincount(observer, angle_weight * scale_weight, minlength=len(names))
    shared = np.bincount(observer, minlength=len(names))
    enough = min(_MIN_SHARED, max(3, len(points) // 4))
    order = np.lexsort((np.arange(len(names)), -score))
    return {names[i]: float(score[i]) for i in order if score[i] > 0 and shared[i] >= enough}


def _ranks(scene: NativeScene) -> dict[str, int]:
    """Native images by the median size of their pixels on the ground, the finest first."""
    sampling = {
        name: float(np.median(seen.depth)) / scene.cameras[name].intrinsics[0, 0]
        if len(seen.depth)
        else float("inf")
        for name, seen in scene.observations.items()
    }
    ordered = sorted(sampling, key=lambda name: (sampling[name], name))
    return {name: rank for rank, name in enumerate(ordered)}


def _write_colmap_lists(workspace: Workspace, found: Views) -> None:
    """patch-match.cfg with explicit sources (sub-images that a source window touches) and fusion.cfg."""
    natives = {native.name: native for native in workspace.natives}
    lines = []
    for one in found.sub_images.values():
        touched = [
            (source.window.intersection(sub.core).area, order, sub.name)
            for order, source in enumerate(one.sources)
            for sub in natives[source.name].sub_images
        ]
        best = sorted(
            (-area, order, name) for area, order, name in touched if area and is_source(name)
        )
        if best and is_listable(one.name):
            lines += [one.name, ", ".join(name for _, _, name in best[:_SOURCE_SUB_IMAGES])]
    listed = [
        one.name for one in found.sub_images.values() if one.sources and is_listable(one.name)
    ]
    for path, text in ((workspace.patch_match_config, lines), (workspace.fusion_config, listed)):
        with written_whole(path) as temporary:
            temporary.write_text("\n".join(text) + "\n", encoding="utf-8")


def _write_views(path: Path, found: Views) -> None:
    write_json(
        path,
        {
            "version": 1,
            "rank": found.rank,
            "sub_images": [
                {
                    "name": one.name,
                    "window": one.window.as_list(),
                    "min_depth": one.min_depth,
                    "max_depth": one.max_depth,
                    "sources": [
                        {"name": source.name, "window": source.window.as_list()}
                        for source in one.sources
                    ],
                }
                for one in found.sub_images.values()
            ],
        },
    )
