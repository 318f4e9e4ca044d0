"""SIFT by pycolmap on the sub-images of photographs: the process that `features.features` starts.

It runs apart (`python -m sirpy.feature_extraction TASK.json`), for the reasons that
`structure_from_motion` gives, and says what it does on the pipe that it was given, one JSON object
a line: {"done"}, the number of photographs that are in the database; {"left_out", "reason"}; last
{"finished"}.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from sirpy.child_process import Caller, begin
from sirpy.errors import InputError
from sirpy.feature_selection import Features, spread
from sirpy.feature_tiles import FeatureTile, feature_tiles
from sirpy.initial_cameras import initial_camera
from sirpy.memory import give_back
from sirpy.photographs import open_photograph, recapture_to_files, white_level

_ALL = 10_000_000  # features of a sub-image; the cap is on those of a photograph


@dataclass(frozen=True)
class NativePhotograph:
    """A photograph, and its number from 1 in the database; `position`: latitude, longitude
    (degrees) and altitude (m) where GPS gave all three."""

    number: int
    name: str
    width: int
    height: int
    position: tuple[float, float, float] | None


@dataclass(frozen=True)
class FeatureTask:
    """What the process is to do.

    `cameras` are the names of the photographs that share one; `side` (pixels) is the longest of a
    sub-image, of which `extractors` are worked on at once; at most `most` features are kept of a
    photograph.
    """

    images: str
    database: str
    scratch: str
    photographs: tuple[NativePhotograph, ...]
    cameras: tuple[tuple[str, ...], ...]
    camera_model: str
    first_octave: int
    side: int
    extractors: int
    most: int

    def write(self, path: Path) -> None:
        path.write_text(json.dumps(asdict(self)), encoding="utf-8")

    @classmethod
    def read(cls, path: Path) -> FeatureTask:
        values = json.loads(path.read_text(encoding="utf-8"))
        values["photographs"] = tuple(NativePhotograph(**one) for one in values["photographs"])
        return cls(**values)

    def tiles(self, photograph: NativePhotograph) -> list[FeatureTile]:
        return feature_tiles(photograph.width, photograph.height, self.side, self.first_octave)


def extract(task: FeatureTask, caller: Caller) -> None:
    """Adds the photographs that are not yet in the database, each in one transaction."""
    database, tiles = Path(task.database), Path(task.scratch) / "tiles"
    if not database.exists():
        _write_cameras(task, database)
    with pycolmap.Database.open(database) as opened:
        waiting = [one for one in task.photographs if not opened.exists_image(one.name)]
    done = len(task.photographs) - len(waiting)
    caller.say(done=done)
    for batch in _batches(task, waiting):
        shutil.rmtree(tiles, ignore_errors=True)
        cut = []
        for photograph in batch:
            try:
                _cut(task, photograph, tiles)
                cut.append(photograph)
            except InputError as error:
                caller.say(left_out=photograph.name, reason=str(error))
        if cut:
            _find(task, tiles)
        for photograph in cut:
            _store(task, photograph, _selected(task, photograph, tiles))
        give_back()
        done += len(batch)
        caller.say(done=done)
    shutil.rmtree(tiles, ignore_errors=True)
    caller.say(finished=True)


def _write_cameras(task: FeatureTask, database: Path) -> None:
    """Makes the database, with cameras alone; it appears whole or not at all."""
    temporary = Path(task.scratch) / "cameras.db"
    temporary.unlink(missing_ok=True)
    by_name = {one.name: one for one in task.photographs}
    with pycolmap.Database.open(temporary) as opened:
        for number, names in enumerate(task.cameras, start=1):
            first = by_name[names[0]]
            path, size = Path(task.images) / first.name, (first.width, first.height)
            camera = initial_camera(path, size, task.camera_model, has_exif=True)
            camera.camera_id = number
            opened.write_camera(camera, use_camera_id=True)
            rig = pycolmap.Rig(rig_id=number)
            rig.add_ref_sensor(camera.sensor_id)
            opened.write_rig(rig, use_rig_id=True)
    os.replace(temporary, database)


def _batches(
    task: FeatureTask, waiting: list[NativePhotograph]
) -> Iterator[list[NativePhotograph]]:
    """As many photographs at once as keep the extractors busy."""
    batch: list[NativePhotograph] = []
    for photograph in waiting:
        batch.append(photograph)
        if sum(len(task.tiles(one)) for one in batch) >= task.extractors:
            yield batch
            batch = []
    if batch:
        yield batch


def _tile_name(photograph: NativePhotograph, index: int) -> str:
    return f"{photograph.number:06d}/{index:04d}.png"


def _cut(task: FeatureTask, photograph: NativePhotograph, folder: Path) -> None:
    """Writes the sub-images, in one pass over the rows of the photograph; none where it fails."""
    header = open_photograph(Path(task.images) / photograph.name)
    size = photograph.width, photograph.height
    files = [
        (folder / _tile_name(photograph, index), tile.stored)
        for index, tile in enumerate(task.tiles(photograph))
    ]
    files[0][0].parent.mkdir(parents=True)
    try:
        white = white_level(header) if header.bits == 16 else 0
        recapture_to_files(header, None, size, files, white=white)
    except InputError:
        shutil.rmtree(files[0][0].parent)
        raise


def _find(task: FeatureTask, folder: Path) -> None:
    """Features of the sub-images, in a database of their own."""
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = task.extractors
    options.max_image_size = task.side
    options.sift.first_octave = task.first_octave
    options.sift.max_num_features = _ALL
    pycolmap.extract_features(_found(folder), folder, extraction_options=options)


def _found(folder: Path) -> Path:
    return folder / "features.db"


def _selected(task: FeatureTask, photograph: NativePhotograph, folder: Path) -> Features:
    """What is kept of the features that the sub-images of a photograph own, in its pixels."""
    kept, size = Features.none(), (photograph.width, photograph.height)
    with pycolmap.Database.open(_found(folder)) as found:
        for index, tile in enumerate(task.tiles(photograph)):
            name = _tile_name(photograph, index)
            image = found.read_image_with_name(name)
            if image is None:
                raise RuntimeError(f"COLMAP found no features in sub-image {name}")
            keypoints: NDArray[np.float32] = found.read_keypoints(image.image_id)
            if len(keypoints) == 0:
                continue
            descriptors = found.read_descriptors(image.image_id).data
            # Whole numbers up to 2^16 move a float32 position by less than 1/100 pixel.
            keypoints[:, :2] += np.array([tile.stored.x0, tile.stored.y0], np.float32)
            pixel = np.floor(keypoints[:, :2])
            core = tile.core
            # Positions a little outside the photograph belong to its border.
            column = np.clip(pixel[:, 0], 0, photograph.width - 1)
            row = np.clip(pixel[:, 1], 0, photograph.height - 1)
            owned = (core.x0 <= column) & (column < core.x1) & (core.y0 <= row) & (row < core.y1)
            kept = spread(
                kept.joined(Features(keypoints[owned], descriptors[owned])), size, task.most
            )
    return kept


def _store(task: FeatureTask, photograph: NativePhotograph, features: Features) -> None:
    """Writes a photograph to the database, whole or not at all."""
    camera_id = next(
        number for number, names in enumerate(task.cameras, start=1) if photograph.name in names
    )
    image = pycolmap.Image(name=photograph.name, camera_id=camera_id, image_id=photograph.number)
    sift = pycolmap.FeatureExtractorType.SIFT
    with (
        pycolmap.Database.open(task.database) as database,
        pycolmap.DatabaseTransaction(database),
    ):
        database.write_image(image, use_image_id=True)
        frame = pycolmap.Frame(frame_id=photograph.number, rig_id=camera_id)
        frame.add_data_id(image.data_id)
        database.write_frame(frame, use_frame_id=True)
        database.write_keypoints(photograph.number, features.keypoints)
        database.write_descriptors(
            photograph.number, pycolmap.FeatureDescriptors(sift, features.descriptors)
        )
        if photograph.position is not None:
            database.write_pose_prior(
                pycolmap.PosePrior(
                    pose_prior_id=photograph.number,
                    corr_data_id=image.data_id,
                    position=np.array(photograph.position),
                    coordinate_system=pycolmap.PosePriorCoordinateSystem.WGS84,
                ),
                use_pose_prior_id=True,
            )


def main() -> None:
    task, caller = begin()
    extract(FeatureTask.read(task), caller)


if __name__ == "__main__":
    main()
