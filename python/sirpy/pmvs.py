"""The data folder of PMVS (Furukawa and Ponce, PAMI 2010): pmvs/, with the options to run it.

pmvs/visualize/00000000.jpg, pmvs/txt/00000000.txt (CONTOUR and the 3x4 projection matrix, pixel centres
at whole numbers as in Bundler's own converter), pmvs/vis.dat (which sub-images show the same surface),
pmvs/option-all, pmvs/option-0000 ... for clusters, and pmvs/masks/00000000.pgm where there are masks.
There is no bundle.rd.out: COLMAP would read it in place of txt/ and set every principal point to the
centre of its image, which is not where that of a sub-image lies.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from sirpy.engine_options import CopyPolicy
from sirpy.engine_views import EngineView, engine_views, grey_note, place_images, precision_note
from sirpy.errors import InputError
from sirpy.files import write_text, written_whole
from sirpy.progress import Progress
from sirpy.windows import read_mask_window
from sirpy.workspace import Workspace

_ENGINE = "PMVS"
_OPTIONS = """\
level 0
csize 2
threshold 0.7
wsize 7
minImageNum 3
CPU {cores}
setEdge 0
useBound 0
useVisData 1
sequence -1
maxAngle 10
quad 2.0
timages {count} {images}
oimages 0
"""
_SCRIPT = """\
#!/bin/sh
# PMVS at full resolution: all clusters of sub-images where there are some, else all sub-images at
# once. PMVS2 names the program to use.
set -e
workspace=$(cd "$(dirname "$0")" && pwd)
pmvs=${PMVS2:-pmvs2}
set -- "$workspace"/pmvs/option-[0-9]*
[ -e "$1" ] || set -- "$workspace/pmvs/option-all"
for option in "$@"; do
  "$pmvs" "$workspace/pmvs/" "$(basename "$option")"
done
"""


def write_pmvs(
    workspace: Workspace,
    *,
    clusters: Sequence[Sequence[str]] = (),
    copy_policy: CopyPolicy = "hard-link",
    progress: Progress = Progress(),
) -> None:
    """Writes pmvs/ and run-pmvs.sh into a workspace that was cut.

    Args:
        clusters: names of the sub-images of each group that PMVS shall work on alone.
        copy_policy: how the images get their numbers.

    Raises:
        InputError: this is no workspace, its sub-images are no JPEGs, or a cluster names one that
            it does not have.
        OutputError: the folder cannot be written.
    """
    views = engine_views(workspace, progress=progress)
    numbers = {view.sub_image.name: view.number for view in views}
    groups = [_numbers(cluster, numbers, workspace) for cluster in clusters]
    folder = workspace.pmvs
    place_images(
        workspace, views, lambda n: folder / "visualize" / f"{n:08}.jpg", copy_policy, _ENGINE
    )
    for view in views:
        rows = [" ".join(map(repr, row)) for row in view.img_from_world.tolist()]
        write_text(folder / "txt" / f"{view.number:08}.txt", "\n".join(["CONTOUR", *rows, ""]))
    for view in views:
        if workspace.native(view.camera.name).masked:
            _write_mask(folder / "masks" / f"{view.number:08}.pgm", workspace, view)
    (folder / "models").mkdir(exist_ok=True)  # PMVS writes its results there
    write_text(folder / "vis.dat", _visibility(views))
    _write_options(workspace, [view.number for view in views], groups)
    write_text(workspace.pmvs_script, _SCRIPT, executable=True)
    for note in (precision_note(views, _ENGINE), grey_note(workspace, views, _ENGINE)):
        if note:
            progress.note(note)


def _write_mask(path: Path, workspace: Workspace, view: EngineView) -> None:
    """PMVS takes binary PGM, 0 where pixels are not to be used."""
    stored = view.sub_image.stored
    masked = read_mask_window(workspace, view.camera.name, stored)
    pixels = np.where(masked, 0, 255).astype(np.uint8)
    with written_whole(path) as temporary:
        header = f"P5\n{stored.width} {stored.height}\n255\n"
        temporary.write_bytes(header.encode() + pixels.tobytes())


def _numbers(cluster: Sequence[str], numbers: dict[str, int], workspace: Workspace) -> list[int]:
    if unknown := [name for name in cluster if name not in numbers]:
        raise InputError(
            f"a cluster lists {unknown[0]!r}, which is no sub-image of {workspace.folder}: give "
            "names as they are in sir.json"
        )
    return sorted(numbers[name] for name in cluster)


def _write_options(workspace: Workspace, everything: list[int], groups: list[list[int]]) -> None:
    for old in workspace.pmvs_groups:
        old.unlink()
    cores = os.cpu_count() or 1
    named = {f"option-{index:04}": group for index, group in enumerate(groups)}
    for name, images in {"option-all": everything, **named}.items():
        listed = " ".join(map(str, images))
        text = _OPTIONS.format(cores=cores, count=len(images), images=listed)
        write_text(workspace.pmvs / name, text)


def _visibility(views: Iterable[EngineView]) -> str:
    """vis.dat: for each sub-image, in order, the numbers of those that show its surface; symmetric."""
    views = list(views)
    seen: list[set[int]] = [set() for _ in views]
    for view in views:
        for number, _ in view.sources:
            seen[view.number].add(number)
            seen[number].add(view.number)
    lines = [
        " ".join(map(str, [number, len(others), *sorted(others)]))
        for number, others in enumerate(seen)
    ]
    return "\n".join(["VISDATA", str(len(seen)), *lines, ""])
