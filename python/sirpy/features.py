"""Features of photographs at native resolution, in a COLMAP database of native images.

SIFT needs 95 bytes of memory per pixel, 330 where the photograph is upsampled first. So it sees
sub-images of the photograph as it is, lens distortion and all (sirpy.feature_tiles), and what it
finds is written as the features of the native image: positions in native pixels, centre of the
top-left pixel at (0.5, 0.5).

    DATABASE                 for COLMAP, pycolmap 4 and COLMAP 3.8 alike
    DATABASE.features.json   of what it was made; lets a killed run go on
    DATABASE.features/       while it is made, and log.txt of a run that failed
"""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any

from sirpy.child_process import run_apart
from sirpy.errors import InputError, OutputError
from sirpy.exif import Exif, read_exif
from sirpy.feature_extraction import FeatureTask, NativePhotograph
from sirpy.feature_tiles import check_tile_side, extractors, feature_tiles, tile_side
from sirpy.files import file_identity, fingerprint, read_json, write_json
from sirpy.initial_cameras import CameraPer, check_camera_options, lens_groups
from sirpy.left_out import leave_out, sizes_of_photographs
from sirpy.native_images import LeftOut
from sirpy.photographs import check_choice
from sirpy.progress import Progress, Steps

__all__ = ["FeatureResult", "features"]

# Where COLMAP up to 3.8 looks for GPS positions; it does not open a database without them.
_PRIORS = ("prior_qw", "prior_qx", "prior_qy", "prior_qz", "prior_tx", "prior_ty", "prior_tz")


@dataclass(frozen=True)
class FeatureResult:
    """`database`: of the photographs but those `left_out`."""

    database: Path
    left_out: list[LeftOut]


def features(
    images: Path | str,
    database: Path | str,
    *,
    max_features: int = 20_000,
    first_octave: int = 0,
    camera_model: str = "SIMPLE_RADIAL",
    camera_per: CameraPer = "auto",
    memory: int = 1_000_000_000,
    tile: int | None = None,
    threads: int = 0,
    progress: Progress | None = None,
) -> FeatureResult:
    """SIFT features of the photographs in `images`, at native resolution, in a COLMAP database.

    They do not depend on `threads`, and hardly on `memory` and `tile`. The same command continues
    a run that was killed, and does nothing when all is done.

    Args:
        max_features: of a photograph, spread evenly over it (sirpy.feature_selection).
        first_octave: 0, or -1 for features down to half the scale, four times the time and
            memory per pixel.
        camera_model: COLMAP's name.
        camera_per: who shares a camera: auto (a lens by EXIF, else a folder), image, folder or
            single.
        memory: bound in bytes on this process and its child together.
        tile: longest side of a sub-image with its overlap, pixels; None for what memory allows.
        threads: 0 for one on each core.

    Raises:
        InputError: an option or a photograph's size that cannot be, no photographs, or a database
            that was made otherwise.
        BudgetError: not even one sub-image fits in `memory`.
        OutputError: the database cannot be written.
    """
    images, database, progress = Path(images), Path(database), progress or Progress()
    _check_options(max_features, first_octave, camera_model, camera_per, threads)
    if tile is not None:
        check_tile_side(tile, memory, first_octave)
    side = tile or tile_side(memory, first_octave)
    sizes, left_out = sizes_of_photographs(images, progress)
    if not sizes:
        raise InputError(f"{images} holds no usable photograph: {left_out[0].reason}")
    exifs = {name: read_exif(images / name) for name in sizes}
    cameras = lens_groups(sizes, exifs, camera_per)
    made_of = {
        "options": fingerprint(max_features, first_octave, camera_model, cameras, sizes),
        "photographs": {name: list(file_identity(images / name)) for name in sizes},
    }
    finished = _finished(database, made_of)
    tiles = [tile for size in sizes.values() for tile in feature_tiles(*size, side, first_octave)]
    task = FeatureTask(
        images=str(images.resolve()),
        database=str(database.resolve()),
        scratch=str(_scratch(database).resolve()),
        photographs=tuple(
            NativePhotograph(number, name, *size, _position(exifs[name]))
            for number, (name, size) in enumerate(sizes.items(), start=1)
        ),
        cameras=tuple(tuple(group) for group in cameras),
        camera_model=camera_model,
        first_octave=first_octave,
        side=side,
        extractors=min(threads or os.cpu_count() or 1, extractors(tiles, memory, first_octave)),
        most=max_features,
    )
    if finished < sizes.keys():
        write_json(_record(database), made_of)
        left_out += _run(task, progress)
    _serve_older_colmap(database, task)
    shutil.rmtree(_scratch(database), ignore_errors=True)
    return FeatureResult(database, sorted(left_out, key=lambda out: out.name))


def _check_options(
    max_features: int, first_octave: int, camera_model: str, camera_per: str, threads: int
) -> None:
    check_camera_options(camera_model, camera_per)
    check_choice("first_octave", str(first_octave), ("0", "-1"))
    if max_features < 1:
        raise InputError(f"--max_features {max_features} is not possible: choose 1 or more")
    if threads < 0:
        raise InputError(f"--threads {threads} is not possible: choose 0 or more")


def _position(exif: Exif) -> tuple[float, float, float] | None:
    if exif.position is None or exif.altitude is None:
        return None
    return (*exif.position, exif.altitude)


def _record(database: Path) -> Path:
    return database.with_name(f"{database.name}.features.json")


def _scratch(database: Path) -> Path:
    return database.with_name(f"{database.name}.features")


def _finished(database: Path, made_of: dict[str, Any]) -> set[str]:
    """Names of the photographs in the database.

    Raises:
        InputError: it holds something else, or features that were made otherwise.
    """
    if not database.exists():
        return set()
    otherwise = (
        f"{database} was made of other photographs or with other options: delete it, or choose "
        "another --database"
    )
    try:
        before = read_json(_record(database), dict, f"delete it and {database}")
        with closing(_connect(database)) as connection:
            finished = {str(name) for (name,) in connection.execute("SELECT name FROM images")}
    except (FileNotFoundError, sqlite3.Error):
        raise InputError(
            f"{database} exists, and was not made by this command: choose another --database"
        ) from None
    then, now = before.get("photographs"), made_of["photographs"]
    if before.get("options") != made_of["options"] or not isinstance(then, dict):
        raise InputError(otherwise)
    if any(name not in now or then.get(name) != now[name] for name in finished):
        raise InputError(otherwise)
    return finished


def _connect(database: Path) -> sqlite3.Connection:
    """Never while this process runs COLMAP on it: two copies of SQLite break each other's locks."""
    return sqlite3.connect(f"file:{database}?mode=rw", uri=True)


def _run(task: FeatureTask, progress: Progress) -> list[LeftOut]:
    """Runs the extraction in a process of its own; the photographs that it left out."""
    scratch = Path(task.scratch)
    try:
        scratch.mkdir(parents=True, exist_ok=True)
        task.write(scratch / "task.json")
        log = (scratch / "log.txt").open("ab")
    except OSError as error:
        raise OutputError(
            f"cannot write {scratch}: {error.strerror or error}; choose another --database"
        ) from error
    with (
        log,
        progress.stage("finding features", len(task.photographs), "photograph") as steps,
    ):
        (left_out, finished), failure = run_apart(
            "sirpy.feature_extraction",
            scratch / "task.json",
            log,
            partial(_follow, steps=steps, progress=progress),
            omp_threads=1,
        )
    if failure or not finished:
        raise InputError(
            f"the search for features in {task.images} {failure or 'ended early'}: the end of "
            f"{scratch / 'log.txt'} says why"
        )
    return left_out


def _follow(messages: IO[str], steps: Steps, progress: Progress) -> tuple[list[LeftOut], bool]:
    """The photographs that are left out, and whether all others are done."""
    left_out: list[LeftOut] = []
    done, finished = 0, False
    for message in map(json.loads, messages):
        if "left_out" in message:
            leave_out(message["left_out"], message["reason"], left_out, progress)
        steps.advance(message.get("done", done) - done)
        done = message.get("done", done)
        finished = "finished" in message
    return left_out, finished


def _serve_older_colmap(database: Path, task: FeatureTask) -> None:
    """Adds the columns that COLMAP up to 3.8 expects, with GPS positions; newer ones ignore them."""
    with closing(_connect(database)) as connection, connection:
        there = {row[1] for row in connection.execute("PRAGMA table_info(images)")}
        for column in _PRIORS:
            if column not in there:
                connection.execute(f"ALTER TABLE images ADD COLUMN {column} REAL")
        connection.executemany(
            "UPDATE images SET prior_tx = ?, prior_ty = ?, prior_tz = ? WHERE image_id = ?",
            [(*one.position, one.number) for one in task.photographs if one.position],
        )
