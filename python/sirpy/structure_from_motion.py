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
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from sirpy.child_process import Caller, begin
from sirpy.errors import InputError
from sirpy.initial_cameras import initial_camera
from sirpy.lens_models import mapping_model, turn_cameras
from sirpy.mapping import SEED, map_photographs
from sirpy.pairing import COARSEST, Pairs, all_pairs, sequential_pairs, spatial_pairs
from sirpy.position_priors import write_priors
from sirpy.rigs import Rig, RigCamera, are_posed, write_rigs
from sirpy.self_calibration import adjust
from sirpy.sfm_options import Mapper, Matcher

# Upsampled twice (COLMAP's first octave -1), a 2304x1536 photograph takes 1.05 GB and 9 CPU s
# instead of 0.29 GB and 2.7, for the same cameras; below this size (longest side, px) the features
# would become too few.
_UPSAMPLED_SIDE = 1200


@dataclass(frozen=True)
class DecimatedPhotograph:
    """A photograph: its name and size (px), and the name and size of its decimated copy.

    Photographs of equal `camera` share one; `has_exif`: EXIF tells its lens; `position`: latitude
    and longitude in degrees, altitude in m.
    """

    name: str
    width: int
    height: int
    decimated: str
    decimated_width: int
    decimated_height: int
    camera: int
    has_exif: bool
    position: tuple[float, float, float | None] | None

    @property
    def ground(self) -> tuple[float, float] | None:
        return None if self.position is None else (self.position[0], self.position[1])


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
    matcher: Matcher  # not auto
    mapper: Mapper
    use_priors: bool
    rigs: tuple[Rig, ...]
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
        values["rigs"] = tuple(
            tuple(RigCamera(**camera) for camera in rig) for rig in values["rigs"]
        )
        return cls(**values)


def first_octave(longest_side: int) -> int:
    """COLMAP's first octave for decimated photographs of this longest side in pixels."""
    return -1 if longest_side <= _UPSAMPLED_SIDE else 0


class _Report:
    """What the caller is told.

    {"stage", "total", "unit", "table"}: a stage begins; the rows of `table` in the database count
    its steps, or where that is null {"done"} does. {"note"} is for the user. Last {"components"},
    the names in each model, that of the largest first, or {"error"}.
    """

    def __init__(self, caller: Caller) -> None:
        self.say = caller.say

    def stage(self, name: str, total: int, unit: str, table: str | None = None) -> None:
        self.say(stage=name, total=total, unit=unit, table=table)


def solve(task: Task, report: _Report) -> None:
    """Features, pairs, mapping, then the largest model in native pixels.

    Raises:
        InputError: no two photographs could be oriented to each other.
    """
    _import_photographs(task)
    _extract_features(task, report)
    _match(task, report)
    models = _map(task, report)
    names = {photograph.decimated: photograph.name for photograph in task.photographs}
    components = [sorted(names[m.image(i).name] for i in m.reg_image_ids()) for m in models]
    model = models[0]
    _rescale_to_native(model, task)
    model = adjust(model, _priors(task))
    # Last: what decimated photographs tell of the further parameters makes poses worse.
    turn_cameras(model, task.camera_model)
    _write(model, Path(task.model))
    report.say(components=components)


def _import_photographs(task: Task) -> None:
    """Writes cameras, photographs, rigs and positions to the database, which appears whole or not
    at all."""
    database = Path(task.database)
    if database.exists():
        return
    temporary = database.with_suffix(".tmp.db")
    temporary.unlink(missing_ok=True)
    pycolmap.Database.open(temporary).close()
    groups: dict[int, list[DecimatedPhotograph]] = {}
    for photograph in task.photographs:
        groups.setdefault(photograph.camera, []).append(photograph)
    for group in groups.values():
        first = group[0]
        camera = initial_camera(
            Path(task.images) / first.name,
            (first.width, first.height),
            mapping_model(task.camera_model),
            has_exif=first.has_exif,
        )
        camera.rescale(first.decimated_width, first.decimated_height)
        with pycolmap.Database.open(temporary) as opened:
            camera_id = opened.write_camera(camera)
        pycolmap.import_images(
            temporary,
            task.decimated,
            pycolmap.CameraMode.SINGLE,
            image_names=[photograph.decimated for photograph in group],
            options=pycolmap.ImageReaderOptions(existing_camera_id=camera_id),
        )
    if task.rigs and are_posed(task.rigs):
        write_rigs(temporary, task.rigs)
    if task.use_priors:
        positions = {p.decimated: p.position for p in task.photographs if p.position is not None}
        write_priors(temporary, positions)
    os.replace(temporary, database)


def _extract_features(task: Task, report: _Report) -> None:
    side = max(max(p.decimated_width, p.decimated_height) for p in task.photographs)
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = task.extractors
    options.max_image_size = side
    options.sift.first_octave = first_octave(side)
    report.stage("finding features", len(task.photographs), "photograph", "descriptors")
    pycolmap.extract_features(task.database, task.decimated, extraction_options=options)


def _match(task: Task, report: _Report) -> None:
    """Matches the pairs and verifies them geometrically."""
    pairs = _pairs(task, report)
    names = [photograph.decimated for photograph in task.photographs]
    list_path = Path(task.database).with_name("pairs.txt")
    list_path.write_text("".join(f"{names[i]} {names[j]}\n" for i, j in pairs), encoding="utf-8")
    matching = pycolmap.FeatureMatchingOptions(num_threads=task.threads)
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
    report.stage("matching", len(pairs), "pair", "two_view_geometries")
    pycolmap.match_image_pairs(
        task.database,
        matching_options=matching,
        pairing_options=pycolmap.ImportedPairingOptions(match_list_path=list_path),
        verification_options=verification,
    )


def _pairs(task: Task, report: _Report) -> Pairs:
    count = len(task.photographs)
    if task.matcher == "exhaustive":
        return all_pairs(count)
    if task.matcher == "spatial":
        positions = [photograph.ground for photograph in task.photographs]
        return spatial_pairs([position for position in positions if position is not None])
    report.stage("comparing", count, "photograph")
    compared = 0

    def advance() -> None:
        nonlocal compared
        compared += 1
        report.say(done=compared)

    return sequential_pairs(_coarsest_descriptors(task), advance)


def _coarsest_descriptors(task: Task) -> list[NDArray[np.uint8]]:
    """Those of the coarsest features of each photograph, the coarsest first."""
    found = []
    with pycolmap.Database.open(task.database) as opened:
        image_ids = {image.name: image.image_id for image in opened.read_all_images()}
        for photograph in task.photographs:
            image_id = image_ids[photograph.decimated]
            keypoints: NDArray[np.float32] = opened.read_keypoints(image_id)
            # Columns x, y and the affine shape: its determinant is the square of the scale.
            shape = keypoints[:, 2:6]
            area = np.abs(shape[:, 0] * shape[:, 3] - shape[:, 1] * shape[:, 2])
            coarsest = np.argsort(-area, kind="stable")[:COARSEST]
            found.append(opened.read_descriptors(image_id).data[coarsest])
    return found


def _map(task: Task, report: _Report) -> list[pycolmap.Reconstruction]:
    """The models, the largest first."""
    database, images = Path(task.database), Path(task.decimated)
    total = len(task.photographs)

    def run(database: Path, stage: str) -> list[pycolmap.Reconstruction]:
        registered = 0

        def advance(images: int) -> None:
            nonlocal registered
            registered = min(total, registered + images)
            report.say(done=registered)

        report.stage(stage, total, "photograph")
        models = map_photographs(
            database, images, task.mapper, use_priors=task.use_priors, advance=advance
        )
        if not models:
            raise InputError(
                f"no two of the {total} photographs in {task.images} could be oriented to each "
                "other: they need to overlap by 60 % or more and show texture"
            )
        for camera in models[0].cameras.values():
            if camera.has_bogus_params(0.1, 10.0, 1.0):
                raise InputError(
                    f"the {task.mapper} mapper found a lens that cannot be ({camera.model_name} "
                    f"with focal length {camera.mean_focal_length():.0f} px for a width of "
                    f"{camera.width} px): choose another --mapper, or --camera_per folder or single"
                )
        return models

    if not task.rigs or are_posed(task.rigs):
        return run(database, "orienting")
    # The cameras one by one first: their model shows how they are fixed to each other.
    single = run(database, "orienting one by one")[0]
    rigged = database.with_name("rigged.db")
    shutil.copyfile(database, rigged)
    write_rigs(rigged, task.rigs, single)
    return run(rigged, "orienting")


def _rescale_to_native(model: pycolmap.Reconstruction, task: Task) -> None:
    """Native sizes and names: native_from_decimated is a scale by the exact ratio of the sizes."""
    by_decimated = {photograph.decimated: photograph for photograph in task.photographs}
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        photograph = by_decimated[image.name]
        scale = np.array(
            [
                photograph.width / photograph.decimated_width,
                photograph.height / photograph.decimated_height,
            ]
        )
        for point in image.points2D:
            point.xy = point.xy * scale
        image.name = photograph.name
    with pycolmap.Database.open(task.database) as opened:
        camera_ids = {image.name: image.camera_id for image in opened.read_all_images()}
    sizes = {camera_ids[p.decimated]: (p.width, p.height) for p in task.photographs}
    # A rig has also the cameras none of whose photographs could be oriented.
    for camera_id, camera in model.cameras.items():
        camera.rescale(*sizes[camera_id])


def _priors(task: Task) -> list[pycolmap.PosePrior]:
    if not task.use_priors:
        return []
    with pycolmap.Database.open(task.database) as opened:
        return list(opened.read_all_pose_priors())


def _write(model: pycolmap.Reconstruction, folder: Path) -> None:
    temporary = folder.with_name(f".{folder.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir()
    model.write_binary(temporary)
    shutil.rmtree(folder, ignore_errors=True)
    os.replace(temporary, folder)


def main() -> None:
    task, caller = begin()
    try:
        solve(Task.read(task), _Report(caller))
    except InputError as error:
        caller.say(error=str(error))


if __name__ == "__main__":
    main()
