"""Reading COLMAP models: the files are checked against their own sizes before pycolmap sees them.

A damaged model makes COLMAP abort, loop or allocate without end. Walking the binary records first
(counts, names, tracks; COLMAP's layout, little-endian) costs a fraction of the reading and ends in
one sentence.
"""

from __future__ import annotations

import hashlib
import math
import mmap
import struct
from collections.abc import Callable
from pathlib import Path

import pycolmap

from sirpy.errors import InputError

_FILES = ("cameras", "images", "points3D")  # what every COLMAP reads
_EXTRA_FILES = ("rigs", "frames")  # COLMAP 4 only
_SUBFOLDERS = (".", "sparse", "0", "sparse/0")  # where COLMAP's own tools put a model
_LARGEST_SIDE = 1 << 20  # pixels; beyond it the record is noise


def read_model(path: Path | str) -> pycolmap.Reconstruction:
    """Reads a COLMAP model: binary or text, three files (3.8) or five (4.x).

    `path` holds the model, or is the folder above it (with `sparse/`, `0/` or `sparse/0/`).

    Raises:
        InputError: there is no model, it is damaged, or has no images or no 3D points.
    """
    folder = find_model(Path(path))
    if (folder / "cameras.bin").is_file():
        _check_binary(folder)
    # pycolmap repeats its exceptions on stderr, and some warnings: our sentence says it all.
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    try:
        model = pycolmap.Reconstruction(folder)
    except (ValueError, RuntimeError, IndexError, KeyError, MemoryError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"the sparse model in {folder} is damaged ({reason}): export it again"
        ) from None
    finally:
        pycolmap.logging.minloglevel = level
    if model.num_reg_images() == 0:
        raise InputError(
            f"the sparse model in {folder} has no images: give a model with registered photographs"
        )
    if model.num_points3D() == 0:
        raise InputError(
            f"the sparse model in {folder} has no 3D points, which depth ranges and source views "
            "come from: triangulate it first (`colmap point_triangulator`)"
        )
    return model


def model_identity(path: Path) -> str:
    """A hash of the content of the model's files: equal models have equal identities.

    Raises:
        InputError: there is no model.
    """
    folder = find_model(path)
    suffix = _suffix(folder)
    digest = hashlib.sha256()
    for name in (*_FILES, *_EXTRA_FILES):
        file = folder / f"{name}{suffix}"
        if file.is_file():
            digest.update(f"{file.name} {file.stat().st_size}\n".encode())
            with file.open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
    return digest.hexdigest()[:32]


def find_model(path: Path) -> Path:
    """The folder that holds the model's files: `path`, or the one below it where COLMAP puts them.

    Raises:
        InputError: there is none, it lacks a file, or there are several models to choose from.
    """
    if not path.is_dir():
        raise InputError(f"there is no folder {path}: give the folder of a COLMAP sparse model")
    for subfolder in _SUBFOLDERS:
        folder = path / subfolder
        if not any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            continue
        if folder.name == "0" and (folder.parent / "1").is_dir():
            raise InputError(
                f"{folder.parent} holds several models (0, 1, ...): give one of these folders"
            )
        suffix = _suffix(folder)
        for name in _FILES:
            if not (folder / f"{name}{suffix}").is_file():
                raise InputError(
                    f"the sparse model in {folder} has no {name}{suffix}: export it again"
                )
        return folder
    raise InputError(
        f"{path} holds no COLMAP sparse model (cameras.bin, images.bin, points3D.bin, or .txt): "
        "give the folder that has these files"
    )


def _suffix(folder: Path) -> str:
    return ".bin" if (folder / "cameras.bin").is_file() else ".txt"


class _Records:
    """Steps through the records of one binary file; never past its end."""

    def __init__(self, data: bytes | mmap.mmap) -> None:
        self._data = data
        self._offset = 0

    def take(self, layout: struct.Struct) -> tuple[int | float, ...]:
        start = self._offset
        self.skip(layout.size)
        return layout.unpack_from(self._data, start)

    def skip(self, size: int) -> None:
        if size > len(self._data) - self._offset:
            raise _DamagedError("it ends too early")
        self._offset += size

    def count(self, least_record: int) -> int:
        """A number of records that are each at least `least_record` bytes, and must fit the
        file."""
        (count,) = _COUNT.unpack_from(self._data, self._advance(_COUNT.size))
        if count * least_record > len(self._data) - self._offset:
            raise _DamagedError(f"it names {count} records, more than its size holds")
        return int(count)

    def name(self) -> str:
        end = self._data.find(b"\0", self._offset)
        if end < 0:
            raise _DamagedError("a name has no end")
        raw = self._data[self._offset : end]
        self._offset = end + 1
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError:
            raise _DamagedError("a name is not UTF-8 text") from None

    def end(self) -> None:
        if self._offset != len(self._data):
            raise _DamagedError(f"{len(self._data) - self._offset} bytes too many follow")

    def _advance(self, size: int) -> int:
        start = self._offset
        self.skip(size)
        return start


class _DamagedError(Exception):
    """What is wrong in a file; becomes an InputError that names the file."""


_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<IiQQ")  # id, model, width, height; then the parameters
_IMAGE = struct.Struct("<I7dI")  # id, quaternion and translation, camera; then name and 2D points
_POINT_2D = struct.Struct("<ddQ")
_POINT_3D = struct.Struct("<Q3d3Bd")  # id, position, colour, error; then the track
_TRACK_ELEMENT = struct.Struct("<II")
_RIG = struct.Struct("<II")  # id, number of sensors
_SENSOR = struct.Struct("<iI")
_SENSOR_HAS_POSE = struct.Struct("<iIB")
_POSE = struct.Struct("<7d")
_FRAME = struct.Struct("<II7dI")  # id, rig, pose, number of data ids
_DATA_ID = struct.Struct("<iIQ")


def _check_binary(folder: Path) -> None:
    camera_ids: set[int] = set()

    def cameras(records: _Records) -> None:
        camera_ids.update(_check_cameras(records))

    checks: dict[str, Callable[[_Records], None]] = {
        "cameras": cameras,
        "images": lambda records: _check_images(records, camera_ids),
        "points3D": _check_points,
        "rigs": _check_rigs,
        "frames": _check_frames,
    }
    for name, check in checks.items():
        file = folder / f"{name}.bin"
        if not file.is_file() and name in _EXTRA_FILES:
            continue
        try:
            with file.open("rb") as stream:
                if file.stat().st_size < _COUNT.size:
                    raise _DamagedError("it ends too early")
                with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                    records = _Records(data)
                    check(records)
                    records.end()
        except _DamagedError as damage:
            raise InputError(f"{file} is damaged ({damage}): export the model again") from None
        except OSError as error:
            raise InputError(f"{file} cannot be read ({error.strerror})") from None


def _check_cameras(records: _Records) -> set[int]:
    ids: set[int] = set()
    for _ in range(records.count(_CAMERA.size)):
        camera_id, model, width, height = (int(value) for value in records.take(_CAMERA))
        parameters = _PARAMETERS.get(model)
        if parameters is None:
            raise _DamagedError(f"there is no camera model {model}")
        if not (0 < width <= _LARGEST_SIDE and 0 < height <= _LARGEST_SIDE):
            raise _DamagedError(f"camera {camera_id} has {width}x{height} pixels")
        _check_finite(records.take(struct.Struct(f"<{parameters}d")), f"camera {camera_id}")
        if camera_id in ids:
            raise _DamagedError(f"camera {camera_id} is there twice")
        ids.add(camera_id)
    return ids


def _check_images(records: _Records, camera_ids: set[int]) -> None:
    ids: set[int] = set()
    names: set[str] = set()
    for _ in range(records.count(_IMAGE.size + 1 + _COUNT.size)):
        image_id, *pose, camera_id = records.take(_IMAGE)
        name = records.name()
        _check_finite(tuple(pose), f"the pose of image {name}")
        if not any(pose[:4]):
            raise _DamagedError(f"the pose of image {name} has no rotation")
        if camera_id not in camera_ids:
            raise _DamagedError(f"image {name} has camera {camera_id}, which does not exist")
        if image_id in ids or name in names:
            raise _DamagedError(f"image {name} is there twice")
        ids.add(int(image_id))
        names.add(name)
        records.skip(records.count(_POINT_2D.size) * _POINT_2D.size)


def _check_points(records: _Records) -> None:
    for _ in range(records.count(_POINT_3D.size + _COUNT.size)):
        records.skip(_POINT_3D.size)
        records.skip(records.count(_TRACK_ELEMENT.size) * _TRACK_ELEMENT.size)


def _check_rigs(records: _Records) -> None:
    for _ in range(records.count(_RIG.size)):
        _, sensors = records.take(_RIG)
        if sensors == 0:
            continue
        records.take(_SENSOR)  # the reference sensor has no pose
        for _ in range(int(sensors) - 1):
            if records.take(_SENSOR_HAS_POSE)[2]:
                _check_finite(records.take(_POSE), "the pose of a sensor")


def _check_frames(records: _Records) -> None:
    for _ in range(records.count(_FRAME.size)):
        frame_id, _, *pose, data_ids = records.take(_FRAME)
        _check_finite(tuple(pose), f"the pose of frame {frame_id}")
        records.skip(int(data_ids) * _DATA_ID.size)


def _check_finite(values: tuple[int | float, ...], what: str) -> None:
    if not all(math.isfinite(value) for value in values):
        raise _DamagedError(f"{what} is not finite")


def _parameters_of_models() -> dict[int, int]:
    """Number of parameters of each camera model that pycolmap knows, by COLMAP's model number."""
    numbers = {}
    for name, model in pycolmap.CameraModelId.__members__.items():
        if name != "INVALID":
            camera = pycolmap.Camera.create_from_model_id(0, model, 1.0, 1, 1)
            numbers[int(model)] = len(camera.params)
    return numbers


_PARAMETERS = _parameters_of_models()
