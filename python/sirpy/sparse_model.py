"""The sparse model of photographs alone.

Structure from motion sees photographs decimated to `max_size` pixels (the paper's 2304); its model
is given in native pixels: native_from_decimated is (u, v) -> (u * W / w, v * H / h) in the cameras'
coordinates (centre of the top-left pixel at (0.5, 0.5)), which keeps the corners of the photograph
in place.
"""

from __future__ import annotations

import json
import os
import queue
import sqlite3
import threading
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any

from sirpy.child_process import run_apart
from sirpy.errors import BudgetError, InputError
from sirpy.files import file_identity, fingerprint, read_json, write_json
from sirpy.left_out import leave_out, sizes_of_photographs
from sirpy.memory import gigabytes
from sirpy.native_images import LeftOut
from sirpy.photographs import check_folders, decimate, photograph_size
from sirpy.progress import Progress, Steps
from sirpy.sfm_options import SfmOptions
from sirpy.structure_from_motion import DecimatedPhotograph, Task, first_octave
from sirpy.survey import Survey, look_at
from sirpy.workspace import Workspace, check_writable

_PROCESS = 0.15e9  # bytes of an interpreter with pycolmap and rasterio
_SIFT = {
    0: 90,
    -1: 310,
}  # bytes per decimated pixel of one extractor, by first octave; measured 81 and 297
_MAPPING = 12e6  # bytes per photograph of matches, tracks and bundle adjustment


@dataclass(frozen=True)
class SparseResult:
    """`model`: folder of the COLMAP model in native pixels; `left_out`: photographs that are not in
    it; `components`: names of the photographs that could be related to each other, first those of
    the model."""

    model: Path
    left_out: list[LeftOut]
    components: list[list[str]]


def predicted_peak(
    width: int, height: int, count: int, threads: int, *, max_size: int = 2304
) -> int:
    """Peak memory in bytes of `sparse`, caller and child process together.

    Two processes, and the larger of features (90 bytes per decimated pixel and thread, 310 where small
    photographs are upsampled) and mapping (12 MB a photograph).

    Args:
        width, height: size of a native photograph in pixels.
        count: number of photographs.
        threads: photographs whose features are found at once.
    """
    scale = min(1.0, max_size / max(width, height))
    side = scale * max(width, height)
    features = threads * _SIFT[first_octave(round(side))] * scale**2 * width * height
    return int(2 * _PROCESS + max(features, _MAPPING * count))


def predicted_sparse_peak(
    images: Path, threads: int, memory: int | None = None, *, max_size: int = 2304
) -> int:
    """`predicted_peak` for the photographs in a folder, with the threads that `sparse` would take.

    Raises:
        InputError: there are no photographs.
        BudgetError: not even one thread fits in `memory`.
    """
    sizes = list(sizes_of_photographs(images, Progress())[0].values())
    if not sizes:
        return int(2 * _PROCESS)
    width, height = _largest(sizes)
    extractors = _extractors(sizes, threads or os.cpu_count() or 1, memory, max_size)
    return predicted_peak(width, height, len(sizes), extractors, max_size=max_size)


def sparse(
    images: Path | str,
    output: Path | str,
    *,
    options: SfmOptions = SfmOptions(),
    memory: int | None = None,
    threads: int = 0,
    progress: Progress | None = None,
) -> SparseResult:
    """Makes the sparse model of the photographs in `images`, in native pixels, in the workspace
    `output`.

    SIFT, matching, mapping, a last bundle adjustment in native pixels; the largest model is kept,
    and the others are named. The result does not depend on `threads` or `memory`; the same command
    continues a run that was killed.

    Args:
        memory: bound in bytes on this process and its child together; None for no bound.
        threads: 0 for one on each core.

    Raises:
        InputError: fewer than two photographs are there, whole, or could be oriented; they do not
            have what the options ask for.
        BudgetError: not even one thread fits in `memory`.
        OutputError: the workspace cannot be written.
    """
    images, output = Path(images), Path(output)
    progress = progress or Progress()
    if threads < 0:
        raise InputError(f"--threads {threads} is not possible: choose 0 or more")
    threads = threads or os.cpu_count() or 1
    workspace = Workspace(output)
    # All that can be refused is refused before anything is written or removed.
    check_folders(images, output)
    check_writable(output)
    sizes, unreadable = sizes_of_photographs(images, progress)
    _check_count(images, list(sizes), unreadable)
    extractors = _extractors(list(sizes.values()), threads, memory, options.max_image_size)
    survey = look_at(images, sizes, options)
    inputs = fingerprint(
        [(name, *file_identity(images / name)) for name in sizes],
        {**asdict(options), "rig": survey.rigs},
    )
    if workspace.begin_stage("sparse", inputs) and workspace.sfm_left_out.is_file():
        return _result(workspace, unreadable)
    for note in survey.notes:
        progress.note(note)
    left_out: list[LeftOut] = []
    photographs = _decimated(
        images, sizes, survey, workspace, options.max_image_size, left_out, progress
    )
    _check_count(images, photographs, unreadable + left_out)
    task = Task(
        images=str(images.resolve()),
        decimated=str(workspace.sfm_images.resolve()),
        database=str(workspace.sfm_database.resolve()),
        model=str(workspace.sfm_model.resolve()),
        photographs=tuple(photographs),
        camera_model=options.camera_model,
        matcher=survey.matcher,
        mapper=options.mapper,
        use_priors=options.gps == "use",
        rigs=survey.rigs,
        extractors=extractors,
        threads=threads,
    )
    components = _run(task, workspace, progress)
    _name_components(components, photographs, left_out, progress)
    write_json(workspace.sfm_components, components)
    # Written last: it says that the stage is complete.
    write_json(workspace.sfm_left_out, [asdict(out) for out in left_out])
    return SparseResult(workspace.sfm_model, _sorted(unreadable + left_out), components)


def _check_count(images: Path, photographs: Sequence[object], left_out: list[LeftOut]) -> None:
    if len(photographs) < 2:
        raise InputError(
            f"{images} has {len(photographs)} usable photograph(s): structure from motion needs "
            "at least two that overlap" + "".join(f"; {out.reason}" for out in left_out[:3])
        )


def _sorted(left_out: list[LeftOut]) -> list[LeftOut]:
    return sorted(left_out, key=lambda out: out.name)


def _name_components(
    components: list[list[str]],
    photographs: list[DecimatedPhotograph],
    left_out: list[LeftOut],
    progress: Progress,
) -> None:
    """Says which photographs are not in the largest component; they join `left_out`."""
    chosen = set(components[0])
    reasons: dict[str, str] = {}
    for number, names in enumerate(components[1:], start=2):
        progress.note(f"component {number}: {len(names)} photographs: {', '.join(names)}")
        for name in names:
            reasons.setdefault(
                name,
                f"it belongs to component {number}, of {len(names)} photographs, which shares too "
                f"few points with the largest one, of {len(chosen)}",
            )
    unrelated = "it could not be oriented: too few matches with the other photographs"
    for photograph in photographs:
        if photograph.name not in chosen:
            reason = reasons.get(photograph.name, unrelated)
            leave_out(photograph.name, reason, left_out, progress)


def _decimated(
    images: Path,
    sizes: dict[str, tuple[int, int]],
    survey: Survey,
    workspace: Workspace,
    max_size: int,
    left_out: list[LeftOut],
    progress: Progress,
) -> list[DecimatedPhotograph]:
    """Decimates each photograph that is not yet; the damaged ones join `left_out`."""
    photographs = []
    workspace.sfm_images.mkdir(parents=True, exist_ok=True)
    with progress.stage("decimating", len(sizes), "photograph") as steps:
        for name, size in sizes.items():
            seen = survey.photographs[name]
            target = workspace.sfm_images / seen.decimated
            try:
                if not target.is_file():
                    decimate(images / name, target, max_size)
                decimated_size = photograph_size(target)
                photographs.append(
                    DecimatedPhotograph(
                        *(name, *size, seen.decimated, *decimated_size),
                        *(seen.camera, seen.has_exif, seen.position),
                    )
                )
            except InputError as error:
                leave_out(name, str(error), left_out, progress)
            steps.advance()
    return photographs


def _largest(sizes: list[tuple[int, int]]) -> tuple[int, int]:
    return max(sizes, key=lambda size: size[0] * size[1])


def _extractors(
    sizes: list[tuple[int, int]], threads: int, memory: int | None, max_size: int
) -> int:
    """Photographs whose features are found at once: `threads`, or as many as the memory holds."""
    if memory is None or not sizes:
        return threads
    width, height = _largest(sizes)
    count = len(sizes)
    for extractors in range(threads, 0, -1):
        if predicted_peak(width, height, count, extractors, max_size=max_size) <= memory:
            return extractors
    least = predicted_peak(width, height, count, 1, max_size=max_size)
    raise BudgetError(
        f"structure from motion on {count} photographs of {width}x{height} pixels needs "
        f"{gigabytes(least)}, more than --memory allows ({gigabytes(memory)}): allow more, or "
        "make the model with a smaller --max_image_size of `sirpy sfm`"
    )


def _run(task: Task, workspace: Workspace, progress: Progress) -> list[list[str]]:
    """Runs structure from motion in a process of its own; the names in each component.

    Raises:
        InputError: the process found the input unusable, or did not end well.
    """
    task.write(workspace.sfm_task)
    with workspace.sfm_log.open("ab") as log:
        last, failure = run_apart(
            "sirpy.structure_from_motion",
            workspace.sfm_task,
            log,
            partial(_follow, database=workspace.sfm_database, progress=progress),
            omp_threads=max(1, task.threads // task.extractors),
        )
    if "error" in last:
        raise InputError(last["error"])
    if failure or "components" not in last:
        raise InputError(
            f"structure from motion on {task.images} {failure or 'ended early'}: the end of "
            f"{workspace.sfm_log} says why"
        )
    return [list(names) for names in last["components"]]


def _follow(messages: IO[str], database: Path, progress: Progress) -> dict[str, Any]:
    """Shows the messages of the process as progress; the last one is its result."""
    lines: queue.Queue[str | None] = queue.Queue()

    def read() -> None:
        for line in messages:
            lines.put(line)
        lines.put(None)

    threading.Thread(target=read, daemon=True).start()
    last: dict[str, Any] = {}
    table: str | None = None
    steps, done, total = Steps(), 0, 0
    with ExitStack() as stages:
        while True:
            try:
                line = lines.get(timeout=0.5)
            except queue.Empty:
                now = min(total, _rows(database, table)) if table else done
            else:
                if line is None:
                    return last
                last = json.loads(line)
                if "stage" in last:
                    if table:  # that stage has ended since the last look
                        steps.advance(total - done)
                    stages.close()
                    stage = progress.stage(last["stage"], last["total"], last["unit"])
                    steps, done = stages.enter_context(stage), 0
                    total, table = last["total"], last["table"]
                if "note" in last:
                    progress.note(last["note"])
                now = last.get("done", done)
            steps.advance(max(0, now - done))
            done = max(done, now)


def _rows(database: Path, table: str) -> int:
    """Rows of a table of the database that COLMAP is writing.

    Never from the process that runs COLMAP: two copies of SQLite in one process break each other's
    locks, and the memory that they map with it.
    """
    try:
        with closing(
            sqlite3.connect(f"file:{database}?mode=ro", uri=True, timeout=0.1)
        ) as connection:
            (count,) = connection.execute(f"SELECT COUNT(*) FROM {table}").fetchone()
            return int(count)
    except sqlite3.Error:
        return 0  # busy; the next look will tell


def _result(workspace: Workspace, unreadable: list[LeftOut]) -> SparseResult:
    """What an earlier run made, of photographs beside which some cannot be read now."""
    mend = f"delete {workspace.sfm} and run again"
    left_out = read_json(
        workspace.sfm_left_out,
        lambda entries: [LeftOut(str(one["name"]), str(one["reason"])) for one in entries],
        mend,
    )
    components = read_json(
        workspace.sfm_components, lambda found: [[str(n) for n in one] for one in found], mend
    )
    if not components or not workspace.is_solved:
        raise InputError(f"{workspace.sfm} is damaged: {mend}")
    return SparseResult(workspace.sfm_model, _sorted(unreadable + left_out), components)
