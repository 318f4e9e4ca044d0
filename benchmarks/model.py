"""What the models of a large survey cost: one JSON line.

    python benchmarks/model.py FOLDER [--points 1000000] [--photographs 200] [--grid 5x5]
        [--overlap 0] [--lens OPENCV] [--pycolmap]

Makes a synthetic model (nadir photographs of 13470x8670 pixels in strips; a point is seen by about
6 of them), then reads it, moves its observations to the undistorted images, and makes and writes
the model of the sub-images, which another process does so that its memory is its own. With
--pycolmap the same sub-image model is built and written through pycolmap's objects too.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pycolmap
from sirpy.files import written_whole
from sirpy.model_arrays import PosedImage, SparseModel, read_arrays, write_model
from sirpy.native_images import NativeImage, SubImage
from sirpy.rectangle import Grid
from sirpy.resources import Meter
from sirpy.sub_image_model import sub_image_model, undistorted_model

WIDTH, HEIGHT, FOCAL = 13470, 8670, 12000.0
LENSES = {
    "PINHOLE": [FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2],
    "OPENCV": [FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, -0.05, 0.02, 1e-4, -1e-4],
}
FLYING_HEIGHT = 1000.0  # above ground that is flat within a tenth of it
STRIPS = 10
OVERLAPS = 0.65, 0.6  # of photographs along and across the flight
KEYPOINTS_WITHOUT_POINT = 0.5  # for each that has one

Result = TypeVar("Result")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--photographs", type=int, default=200)
    parser.add_argument("--grid", default="5x5")
    parser.add_argument("--overlap", type=int, default=0)
    parser.add_argument("--lens", choices=LENSES, default="OPENCV")
    parser.add_argument("--pycolmap", action="store_true")
    parser.add_argument("--step", choices=["ours", "pycolmap"], help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    source = arguments.folder / "native"
    if arguments.step:
        steps = {"ours": _ours, "pycolmap": _through_pycolmap}
        print(json.dumps(steps[arguments.step](source, arguments)))
        return
    made = _survey(arguments.points, arguments.photographs, arguments.lens)
    write_model(made, source)
    _add_keypoints(source, made)
    result: dict[str, Any] = {
        "photographs": len(made.images),
        "points": len(made.points),
        "observations": len(made.point),
        "grid": arguments.grid,
        "overlap": arguments.overlap,
        "lens": arguments.lens,
        "model_mb": round(sum(path.stat().st_size for path in source.iterdir()) / 1e6, 1),
    }
    del made
    for step in ["ours", "pycolmap"] if arguments.pycolmap else ["ours"]:
        command = [sys.executable, __file__, *sys.argv[1:], "--step", step]
        result[step] = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    print(json.dumps(result))


def _ours(source: Path, arguments: argparse.Namespace) -> dict[str, Any]:
    times: dict[str, float] = {}
    with Meter() as meter:
        model = _timed(times, "read", lambda: read_arrays(source))
        native = _timed(times, "undistort", lambda: undistorted_model(model))
        natives = _natives(native, arguments)
        subs = _timed(times, "sub_images", lambda: sub_image_model(native, natives))
        _timed(times, "write_native", lambda: write_model(native, arguments.folder / "undistorted"))
        _timed(times, "write", lambda: write_model(subs, arguments.folder / "sparse"))
    return {
        **_cost(times, meter),
        "sub_images": len(subs.images),
        "observations_written": len(subs.point),
        "points_written": len(subs.points),
    }


def _through_pycolmap(source: Path, arguments: argparse.Namespace) -> dict[str, Any]:
    """The same sub-images, point by point into a pycolmap.Reconstruction."""
    times: dict[str, float] = {}
    target = arguments.folder / "sparse_pycolmap"
    target.mkdir(exist_ok=True)
    with Meter() as meter:
        model = _timed(times, "read", lambda: pycolmap.Reconstruction(source))
        native = undistorted_model(read_arrays(source))
        natives = _natives(native, arguments)
        subs = sub_image_model(native, natives)
        built = _timed(times, "sub_images", lambda: _reconstruction(subs))
        _timed(times, "write", lambda: built.write_binary(target))
    del model
    return _cost(times, meter)


def _reconstruction(model: SparseModel) -> pycolmap.Reconstruction:
    built = pycolmap.Reconstruction()
    for camera in model.cameras.values():
        built.add_camera_with_trivial_rig(camera)
    tracks = [pycolmap.Track() for _ in model.points]
    for index, image in enumerate(model.images):
        seen = model.seen(index)
        made = pycolmap.Image(
            name=image.name,
            keypoints=model.xy[seen],
            camera_id=image.camera_id,
            image_id=image.image_id,
        )
        w, x, y, z, *translation = image.pose
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([x, y, z, w])), np.array(translation))
        built.add_image_with_trivial_frame(made, pose)
        for keypoint, point in enumerate(model.point[seen].tolist()):
            tracks[point].add_element(image.image_id, keypoint)
    for i, track in enumerate(tracks):
        point = pycolmap.Point3D(
            xyz=model.points[i], color=model.colors[i], error=model.errors[i], track=track
        )
        built.add_point3D_with_id(int(model.point_ids[i]), point)
    return built


def _timed(times: dict[str, float], name: str, step: Callable[[], Result]) -> Result:
    begin = time.monotonic()
    result = step()
    times[name] = round(time.monotonic() - begin, 2)
    return result


def _cost(times: dict[str, float], meter: Meter) -> dict[str, Any]:
    return {
        "seconds": times,
        "wall_s": round(meter.wall_s, 2),
        "cpu_s": round(meter.cpu_s, 2),
        "peak_gb": round((meter.peak_bytes or 0) / 1e9, 3),
    }


def _natives(native: SparseModel, arguments: argparse.Namespace) -> list[NativeImage]:
    grid = Grid(*map(int, arguments.grid.split("x")))
    natives = []
    for image in native.images:
        camera = native.camera_of(image)
        whole = NativeImage(image.name, camera.width, camera.height, ()).rectangle
        subs = tuple(
            SubImage(
                f"{image.name[:-4]}_r{row:02}_c{column:02}.jpg",
                row,
                column,
                core,
                core.padded(arguments.overlap).intersection(whole),
            )
            for row, column, core in grid.cores(camera.width, camera.height)
        )
        natives.append(NativeImage(image.name, camera.width, camera.height, subs))
    return natives


def _survey(points: int, photographs: int, lens: str) -> SparseModel:
    """Photographs that look down in strips, at points that lie anywhere below them."""
    random = np.random.default_rng(0)
    footprint = np.array([WIDTH, HEIGHT]) * FLYING_HEIGHT / FOCAL
    step = footprint * (1 - np.array(OVERLAPS))
    columns = -(-photographs // STRIPS)
    places = np.array([(i % columns, i // columns) for i in range(photographs)]) * step
    spread = places.max(axis=0) + footprint / 2
    world = np.column_stack(
        [random.uniform(-footprint / 2, spread, (points, 2)), random.uniform(0, 100, points)]
    )
    camera = pycolmap.Camera(
        camera_id=1, model=lens, width=WIDTH, height=HEIGHT, params=LENSES[lens]
    )
    images, seen, xy = [], [], []
    for index, (x, y) in enumerate(places):
        # Looking down: x to the right, y away from the viewer, z from the camera to the ground.
        in_camera = (world - [x, y, FLYING_HEIGHT]) * [1, -1, -1]
        near = np.flatnonzero((np.abs(in_camera[:, :2]) < 0.6 * footprint).all(axis=1))
        pixels = camera.img_from_cam(in_camera[near]) + random.normal(0, 0.3, (len(near), 2))
        inside = ((pixels > 0) & (pixels < [WIDTH, HEIGHT])).all(axis=1)
        seen.append(near[inside].astype(np.int32))
        xy.append(pixels[inside])
        # Half a turn around x.
        pose = (0.0, 1.0, 0.0, 0.0, -x, y, FLYING_HEIGHT)
        images.append(PosedImage(index + 1, 1, f"{index:05}.jpg", tuple(map(float, pose))))
    return SparseModel(
        {1: camera},
        tuple(images),
        np.arange(1, points + 1, dtype=np.uint64),
        world,
        random.integers(0, 256, (points, 3), np.uint8),
        np.full(points, 0.4),
        np.cumsum([0, *map(len, seen)], dtype=np.int64),
        np.concatenate(xy),
        np.concatenate(seen),
    ).with_seen_points()


def _add_keypoints(folder: Path, model: SparseModel) -> None:
    """Appends to each image keypoints that see no point, of which real models are full."""
    random = np.random.default_rng(1)
    old = (folder / "images.bin").read_bytes()
    offset = 8
    with written_whole(folder / "images.bin") as temporary, temporary.open("wb") as stream:
        stream.write(old[:8])
        for index, image in enumerate(model.images):
            header = 4 + 56 + 4 + len(image.name) + 1
            count = len(model.point[model.seen(index)])
            more = np.empty(
                int(KEYPOINTS_WITHOUT_POINT * count), [("xy", "<f8", 2), ("point", "<u8")]
            )
            more["xy"] = random.uniform(0, [WIDTH, HEIGHT], (len(more), 2))
            more["point"] = 2**64 - 1
            stream.write(old[offset : offset + header])
            stream.write((count + len(more)).to_bytes(8, "little"))
            stream.write(old[offset + header + 8 : offset + header + 8 + 24 * count])
            stream.write(more.tobytes())
            offset += header + 8 + 24 * count


if __name__ == "__main__":
    main()
