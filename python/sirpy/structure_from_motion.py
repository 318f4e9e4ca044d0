"""Structure from motion by pycolmap on decimated photographs: the process that
`sparse_model.sparse` starts.

It runs apart (`python -m sirpy.structure_from_motion TASK.json`): its memory is given back,
COLMAP's log goes to a file, and an abort inside COLMAP cannot take the caller with it. What it does
it says on the pipe that it was given, one JSON object a line.

The same photographs give the same model, byte for byte, whatever the number of threads: features
and pairs are computed independently of each other with fixed seeds, and the mapper and the bundle
adjustment run on one thread (with more, the order of the sums in Ceres changes the last digits).
Another version of pycolmap or another processor may differ.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from sirpy.child_process import serve
from sirpy.errors import InputError
from sirpy.exif import Exif, read_exif
from sirpy.initial_cameras import initial_camera, lens_groups
from sirpy.self_calibration import adjust

_SEED = 1
# Upsampled twice (COLMAP's first octave -1), a 2304x1536 photograph takes 1.05 GB and 9 CPU s
# instead of 0.29 GB and 2.7, for the same cameras; below this size (longest side, px) the features
# would become too few.
_UPSAMPLED_SIDE = 1200
# All pairs cost count^2 / 2 times 0.5 CPU s: 15 minutes on one core for 60 photographs.
_ALL_PAIRS = 60
_NEIGHBOURS = 30  # nearest photographs that each is matched with, beyond that number
_SEQUENCE = 5  # and those before and after it
_EARTH_RADIUS = 6_371_000.0  # m


@dataclass(frozen=True)
class DecimatedPhotograph:
    """A photograph: its name and size (px), and the name and size of its decimated copy."""

    name: str
    width: int
    height: int
    decimated: str
    decimated_width: int
    decimated_height: int


@dataclass(frozen=True)
class Task:
    """What the process is to do; `extractors` photographs are in memory at once for their
    features."""

    images: str
    decimated: str
    database: str
    model: str
    photographs: tuple[DecimatedPhotograph, ...]
    camera_model: str
    extractors: int
    threads: int

    def write(self, path: Path) -> None:
        path.write_text(json.dumps(asdict(self)), encoding="utf-8")

    @classmethod
    def read(cls, path: Path) -> Task:
        values = json.loads(path.read_text(encoding="utf-8"))
        values["photographs"] = tuple(
            DecimatedPhotograph(**entry) for entry in values["photographs"]
        )
        return cls(**values)


def first_octave(longest_side: int) -> int:
    """COLMAP's first octave for decimated photographs of this longest side in pixels."""
    return -1 if longest_side <= _UPSAMPLED_SIDE else 0


class _Report:
    """Speaks to the caller, one JSON object a line.

    {"stage", "total", "unit", "table"}: a stage begins; the rows of `table` in the database count
    its steps, or where that is null {"done"} does. {"note"} is for the user. Last {"registered"},
    the names in the model, or {"error"}.
    """

    def __init__(self, descriptor: int) -> None:
        self._pipe = os.fdopen(descriptor, "w", encoding="utf-8")

    def say(self, **message: Any) -> None:
        self._pipe.write(json.dumps(message) + "\n")
        self._pipe.flush()

    def stage(self, name: str, total: int, unit: str, table: str | None = None) -> None:
        self.say(stage=name, total=total, unit=unit, table=table)


def solve(task: Task, report: _Report) -> None:
    """Features, pairs, mapping, then the model in native pixels.

    Raises:
        InputError: no two photographs could be oriented to each other.
    """
    exifs = {
        photograph.name: read_exif(Path(task.images) / photograph.name)
        for photograph in task.photographs
    }
    _import_photographs(task, exifs)
    _extract_features(task, report)
    _match(task, exifs, report)
    model = _map(task, report)
    _rescale_to_native(model, task.photographs)
    model = adjust(model)
    _write(model, Path(task.model))
    report.say(registered=sorted(model.image(i).name for i in model.reg_image_ids()))


def _import_photographs(task: Task, exifs: dict[str, Exif]) -> None:
    """Writes cameras and photographs to the database, which appears whole or not at all."""
    database = Path(task.database)
    if database.exists():
        return
    temporary = database.with_suffix(".tmp.db")
    temporary.unlink(missing_ok=True)
    pycolmap.Database.open(temporary).close()
    by_name = {photograph.name: photograph for photograph in task.photographs}
    sizes = {name: (one.width, one.height) for name, one in by_name.items()}
    for names in lens_groups(sizes, exifs, "auto"):
        group = [by_name[name] for name in names]
        has_exif = bool(exifs[names[0]].lens)
        path, size = Path(task.images) / names[0], sizes[names[0]]
        camera = initial_camera(path, size, task.camera_model, has_exif=has_exif)
        camera.rescale(group[0].decimated_width, group[0].decimated_height)
        with pycolmap.Database.open(temporary) as opened:
            camera_id = opened.write_camera(camera)
        pycolmap.import_images(
            temporary,
            task.decimated,
            pycolmap.CameraMode.SINGLE,
            image_names=[photograph.decimated for photograph in group],
            options=pycolmap.ImageReaderOptions(existing_camera_id=camera_id),
        )
    os.replace(temporary, database)


def _extract_features(task: Task, report: _Report) -> None:
    side = max(max(p.decimated_width, p.decimated_height) for p in task.photographs)
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = task.extractors
    options.max_image_size = side
    options.sift.first_octave = first_octave(side)
    report.stage("finding features", len(task.photographs), "photograph", "descriptors")
    pycolmap.extract_features(task.database, task.decimated, extraction_options=options)


def _match(task: Task, exifs: dict[str, Exif], report: _Report) -> None:
    """Matches the pairs and verifies them geometrically."""
    pairs = _pairs([exifs[photograph.name].position for photograph in task.photographs])
    if len(task.photographs) > _ALL_PAIRS and any(
        exifs[photograph.name].position is None for photograph in task.photographs
    ):
        report.say(
            note=f"not every photograph has a GPS position, so all {len(pairs)} pairs are matched"
        )
    names = [photograph.decimated for photograph in task.photographs]
    list_path = Path(task.database).with_name("pairs.txt")
    list_path.write_text("".join(f"{names[i]} {names[j]}\n" for i, j in pairs), encoding="utf-8")
    matching = pycolmap.FeatureMatchingOptions(num_threads=task.threads)
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = _SEED
    report.stage("matching", len(pairs), "pair", "two_view_geometries")
    pycolmap.match_image_pairs(
        task.database,
        matching_options=matching,
        pairing_options=pycolmap.ImportedPairingOptions(match_list_path=list_path),
        verification_options=verification,
    )


def _pairs(positions: list[tuple[float, float] | None]) -> list[tuple[int, int]]:
    """Pairs of indices to match: all of a small set, else near neighbours by GPS and by
    sequence."""
    count = len(positions)
    known = [position for position in positions if position is not None]
    if count <= _ALL_PAIRS or len(known) < count:
        return [(i, j) for i in range(count) for j in range(i + 1, count)]
    degrees = np.array(known)
    scale = np.array([1.0, np.cos(np.radians(degrees[:, 0].mean()))])
    metres = np.radians(degrees) * scale * _EARTH_RADIUS
    pairs = {(i, j) for i in range(count) for j in range(i + 1, min(count, i + 1 + _SEQUENCE))}
    for i in range(count):
        distance = np.linalg.norm(metres - metres[i], axis=1)
        for j in np.argsort(distance, kind="stable")[: _NEIGHBOURS + 1].tolist():
            if i != j:
                pairs.add((min(i, j), max(i, j)))
    return sorted(pairs)


def _map(task: Task, report: _Report) -> pycolmap.Reconstruction:
    """The largest model of the incremental mapper."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = _SEED
    options.min_model_size = 2
    total = len(task.photographs)
    registered = 0

    def advance(images: int) -> None:
        nonlocal registered
        registered = min(total, registered + images)
        report.say(done=registered)

    folder = Path(task.database).with_name("models")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    report.stage("orienting", total, "photograph")
    models = pycolmap.incremental_mapping(
        task.database,
        task.decimated,
        folder,
        options,
        initial_image_pair_callback=lambda: advance(2),
        next_image_callback=lambda: advance(1),
    )
    shutil.rmtree(folder)
    largest = max(
        models.values(), key=lambda m: (m.num_reg_images(), m.num_points3D()), default=None
    )
    if largest is None or largest.num_reg_images() < 2:
        raise InputError(
            f"no two of the {total} photographs in {task.images} could be oriented to each other: "
            "they need to overlap by 60 % or more and show texture"
        )
    return largest


def _rescale_to_native(
    model: pycolmap.Reconstruction, photographs: tuple[DecimatedPhotograph, ...]
) -> None:
    """Native sizes and names: native_from_decimated is a scale by the exact ratio of the sizes."""
    by_decimated = {photograph.decimated: photograph for photograph in photographs}
    native_sizes: dict[int, tuple[int, int]] = {}
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        photograph = by_decimated[image.name]
        native_sizes[image.camera_id] = (photograph.width, photograph.height)
        scale = np.array(
            [
                photograph.width / photograph.decimated_width,
                photograph.height / photograph.decimated_height,
            ]
        )
        for point in image.points2D:
            point.xy = point.xy * scale
        image.name = photograph.name
    for camera_id, size in native_sizes.items():
        model.camera(camera_id).rescale(*size)


def _write(model: pycolmap.Reconstruction, folder: Path) -> None:
    temporary = folder.with_name(f".{folder.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir()
    model.write_binary(temporary)
    shutil.rmtree(folder, ignore_errors=True)
    os.replace(temporary, folder)


def main() -> None:
    """TASK.json, the descriptor of the pipe to the caller, and the caller's process id."""
    serve(int(sys.argv[3]))
    # glog's log files in /tmp would stay behind.
    pycolmap.logging.logtostderr = True
    report = _Report(int(sys.argv[2]))
    try:
        solve(Task.read(Path(sys.argv[1])), report)
    except InputError as error:
        report.say(error=str(error))


if __name__ == "__main__":
    main()
