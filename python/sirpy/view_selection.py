"""View selection: what each reference sub-image is matched against, how deep, and in which windows: views.json.

The sources and depth ranges are fields over the native images (see `sirpy.view_fields`), whatever the grid; the
windows of the sub-images follow from them (see `sirpy.view_windows`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sirpy.colmap_lists import is_listable, is_source, names_note
from sirpy.errors import InputError
from sirpy.files import fingerprint, read_json, write_json, written_whole
from sirpy.native_images import NativeImage
from sirpy.native_scene import NativeScene, read_native_scene
from sirpy.progress import Progress
from sirpy.rectangle import Rectangle
from sirpy.view_fields import (
    MOST_LEVELS,
    MOST_OF_A_BLOCK,
    MOST_SOURCES,
    FieldSource,
    ViewField,
    field_shape,
)
from sirpy.view_windows import HALO, LEAST_COARSEST, Source, SubImageViews, ViewSelection
from sirpy.workspace import Workspace

NUM_SOURCES = 8  # that a place is matched against, unless the user says otherwise
_VERSION = 3  # of views.json
_SOURCE_SUB_IMAGES = 20  # of other images, listed for COLMAP


@dataclass(frozen=True)
class Views:
    """What stereo and fusion are to do.

    `fields` by native name; `sub_images` by name; `rank` of each native image in fusion: 0 has the
    finest sampling; `coarsest`: the level of the pass over whole photographs; `halo`: pixels around a
    sub-image that are estimated with it, of each level.
    """

    fields: dict[str, ViewField]
    sub_images: dict[str, SubImageViews]
    rank: dict[str, int]
    coarsest: int
    halo: int


def views(
    workspace: Workspace,
    *,
    num_sources: int = NUM_SOURCES,
    halo: int = HALO,
    progress: Progress | None = None,
) -> Views:
    """Chooses sources, depth ranges and windows; writes views.json and patch-match.cfg.

    Args:
        workspace: with its sub-images and models (see `cut`).
        num_sources: native images that each place is matched against, at most (1 to 16); a
            native image takes those of all its places, 32 at most.
        halo: pixels of each level around a sub-image that are estimated with it and thrown away.

    Raises:
        InputError: an option out of range, or no sub-image has a source.
    """
    check_num_sources(num_sources)
    if halo < 0:
        raise InputError(f"--halo {halo} is not possible: choose 0 or more pixels")
    natives = workspace.natives  # before anything is written: is this a workspace?
    begun = workspace.begin_stage(
        "views", fingerprint(workspace.fingerprint_of("cut"), num_sources, halo, _VERSION)
    )
    if begun and workspace.views.exists():
        return read_views(workspace)
    scene = read_native_scene(workspace)
    covered = {native.name: native.covered for native in natives}
    selection = ViewSelection(scene, covered, num_sources, halo)
    units = list(workspace.sub_images())
    found: dict[str, SubImageViews] = {}
    with (progress or Progress()).stage("views", len(units), "sub-image") as step:
        for native, sub_image in units:
            found[sub_image.name] = selection.sub_image(native.name, sub_image)
            step.advance()
    if not any(one.sources for one in found.values()):
        raise InputError(
            f"no sub-image of {workspace.folder} sees what another photograph sees: "
            "check that the model and the photographs belong together and overlap"
        )
    fields = {name: selection.field(name) for name in covered}
    result = Views(fields, found, _ranks(scene), selection.coarsest, halo)
    _write_colmap_lists(workspace, result)
    if progress and (note := names_note(found, sources=True)):
        progress.note(note)
    _write_views(workspace.views, result)
    return result


class Selected:
    """What fusion needs of the views: the field of each native image, found when it is asked for, and ranks."""

    def __init__(self, field: Callable[[str], ViewField], rank: Mapping[str, int]) -> None:
        self.field, self.rank = field, rank


def selected_views(
    workspace: Workspace, scene: NativeScene, natives: Mapping[str, NativeImage]
) -> Selected:
    """The views of a workspace; of one that another program made, what would be chosen for `natives`.

    Raises:
        InputError: views.json is missing or damaged.
    """
    if workspace.has_views:
        found = read_views(workspace)
        return Selected(found.fields.__getitem__, found.rank)
    covered = {name: native.covered for name, native in natives.items()}
    return Selected(ViewSelection(scene, covered, NUM_SOURCES, 0).field, _ranks(scene))


def check_num_sources(num_sources: int) -> None:
    """Raises InputError unless stereo can match a place against so many sources."""
    if not 1 <= num_sources <= MOST_OF_A_BLOCK:
        raise InputError(
            f"--num-sources {num_sources} is not possible: choose 1 to {MOST_OF_A_BLOCK}"
        )


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


def read_views(workspace: Workspace) -> Views:
    """What `views` wrote.

    Raises:
        InputError: the workspace has no views.json yet, or it is damaged or of another version.
    """
    mend = "delete it and run `sirpy views` again"

    def parsed(stored: Any) -> Views:
        if stored["version"] != _VERSION:
            raise InputError(f"{workspace.views} was made by another version of sirpy: {mend}")
        return _parsed_views(stored)

    try:
        found = read_json(workspace.views, parsed, mend)
    except FileNotFoundError:
        raise InputError(
            f"{workspace.folder} has no views.json: run `sirpy views` before stereo and fusion"
        ) from None
    natives = {native.name: native for native in workspace.natives}
    owners = {sub.name: native for native, sub in workspace.sub_images()}
    sources = {source.name for one in found.sub_images.values() for source in one.sources}
    sources |= {source.name for field in found.fields.values() for source in field.sources}
    shapes = {name: field_shape(one.width, one.height) for name, one in natives.items()}
    if (
        shapes != {name: (one.side, *one.allowed.shape) for name, one in found.fields.items()}
        or found.sub_images.keys() != owners.keys()
        or not sources <= natives.keys() <= found.rank.keys()
        or not all(
            _is_part(window, image.rectangle)
            for one in found.sub_images.values()
            for window, image in (
                (one.window, owners[one.name]),
                *((source.window, natives[source.name]) for source in one.sources),
            )
        )
    ):
        raise InputError(f"{workspace.views} is of other sub-images than sir.json: {mend}")
    return found


def _is_part(window: Rectangle, image: Rectangle) -> bool:
    return window.width > 0 and window.height > 0 and image.contains(window)


def _parsed_views(stored: Any) -> Views:
    fields = [_parsed_field(one) for one in stored["images"]]
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
    coarsest, halo = int(stored["coarsest"]), int(stored["halo"])
    if coarsest < LEAST_COARSEST or halo < 0:
        raise ValueError(f"coarsest = {coarsest}, halo = {halo}")
    return Views(
        {one.name: one for one in fields},
        {one.name: one for one in found},
        rank,
        coarsest,
        halo,
    )


def _parsed_field(one: Any) -> ViewField:
    field = ViewField(
        str(one["name"]),
        int(one["side"]),
        tuple(FieldSource(str(s["name"]), int(s["level"])) for s in one["sources"]),
        np.array(one["allowed"], np.uint32),
        np.array(one["min_depth"], np.float32),
        np.array(one["max_depth"], np.float32),
    )
    few = len(field.sources) <= MOST_SOURCES
    if not (few and all(0 <= source.level <= MOST_LEVELS for source in field.sources)):
        raise ValueError(f"sources of {field.name}")
    if field.allowed.max() >= 1 << len(field.sources):
        raise ValueError(f"allowed of {field.name}")
    sound = (
        (field.min_depth > 0) & (field.min_depth <= field.max_depth) & (field.max_depth < np.inf)
    )
    if field.allowed.shape != sound.shape or not sound[field.allowed != 0].all():
        raise ValueError(f"depths of {field.name}")
    return field


def _write_views(path: Path, found: Views) -> None:
    write_json(
        path,
        {
            "version": _VERSION,
            "coarsest": found.coarsest,
            "halo": found.halo,
            "rank": found.rank,
            "images": [
                {
                    "name": field.name,
                    "side": field.side,
                    "sources": [
                        {"name": source.name, "level": source.level} for source in field.sources
                    ],
                    "allowed": field.allowed.tolist(),
                    "min_depth": _shortest(field.min_depth),
                    "max_depth": _shortest(field.max_depth),
                }
                for field in found.fields.values()
            ],
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


def _shortest(depths: npt.NDArray[np.float32]) -> list[list[float]]:
    """Numbers with as few digits as tell a float32."""
    return [[float(str(depth)) for depth in row] for row in depths]
