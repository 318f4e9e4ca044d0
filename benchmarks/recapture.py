"""What recapture costs beside COLMAP's undistortion: one JSON line.

    python benchmarks/recapture.py WORK [--width 13470 --height 8670] [--photographs 2] [--grid 5x5]
        [--limits build/cpp/limits] [--without_pycolmap]

Photographs with an OPENCV lens are made in WORK (kept for the next time), JPEG of quality 95 with 4:2:0
chroma, which is what pycolmap writes. Both sides write that again, each as a process of its own, from the
start of Python to its end; the kernel reports CPU time and peak resident memory. sirpy writes the sub-images of
the grid, pycolmap one image for each photograph, which it works on in parallel. `--limits` names the program
of limits.cc (`cmake -DSIRPY_BENCHMARKS=ON`); its CPU seconds are for one photograph.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from sirpy import _core

QUALITY, CHROMA = 95, "420"

# Of the process itself: what the kernel tells its parent counts the parent's own pages too.
PEAK = """
import re
print(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read()).group(1))
"""

SIRPY = """
import sys
from sirpy import Grid, cut
from sirpy.cut_tasks import PixelOptions
from sirpy.photographs import Encoding
work, output, columns, rows = sys.argv[1:]
pixels = PixelOptions(encoding=Encoding({quality}, "{chroma}"))
cut(work + "/photos", work + "/sparse", output, grid=Grid(int(columns), int(rows)), pixels=pixels)
"""

PYCOLMAP = """
import sys
import pycolmap
pycolmap.undistort_images(sys.argv[2], sys.argv[1] + "/sparse", sys.argv[1] + "/photos", jpeg_quality={quality})
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path)
    parser.add_argument("--width", type=int, default=13470)
    parser.add_argument("--height", type=int, default=8670)
    parser.add_argument("--photographs", type=int, default=2)
    parser.add_argument("--grid", default="5x5")
    parser.add_argument("--limits", type=Path)
    parser.add_argument("--without_pycolmap", action="store_true")
    arguments = parser.parse_args()
    count, width, height = arguments.photographs, arguments.width, arguments.height
    work = arguments.work / f"{count}x{width}x{height}"
    if not (work / "sparse").exists():
        make(work, count, width, height)
    found: dict[str, Any] = {"photographs": count, "grid": arguments.grid}
    found["megapixels_each"] = round(width * height / 1e6, 1)
    found["sirpy"] = measure(SIRPY, work, *arguments.grid.split("x"))
    if arguments.limits:
        command = [arguments.limits, work / "photos" / "0.jpg", work, str(QUALITY), CHROMA]
        found["limits_cpu_s_each"] = json.loads(subprocess.check_output(command, text=True))
    if not arguments.without_pycolmap:
        found["pycolmap"] = measure(PYCOLMAP, work)
        for cost in ("cpu_s", "wall_s", "peak_mb"):
            ratio = found["pycolmap"][cost] / found["sirpy"][cost]
            found[f"{cost}_ratio"] = round(ratio, 1)
    print(json.dumps(found))


def measure(program: str, work: Path, *arguments: str) -> dict[str, float]:
    output = work / "out"
    shutil.rmtree(output, ignore_errors=True)
    output.mkdir()
    program = program.format(quality=QUALITY, chroma=CHROMA) + PEAK
    command = [sys.executable, "-c", program, str(work), str(output), *arguments]
    begin = time.monotonic()
    before = os.times()
    printed = subprocess.check_output(command, stderr=subprocess.DEVNULL, text=True)
    wall, after = time.monotonic() - begin, os.times()
    used = after.children_user + after.children_system
    size = sum(path.stat().st_size for path in output.rglob("*.jpg"))
    shutil.rmtree(output)
    return {
        "cpu_s": round(used - before.children_user - before.children_system, 2),
        "wall_s": round(wall, 2),
        "peak_mb": round(int(printed.split()[-1]) * 1024 / 1e6, 1),
        "written_mb": round(size / 1e6, 1),
    }


def make(work: Path, count: int, width: int, height: int) -> None:
    """Photographs of structure at all scales with some grain, and a model of them."""
    focal = 1.1 * width
    lens = [focal, focal, width / 2 + 10, height / 2 - 7, -0.05, 0.01, 1e-4, -1e-4]
    camera = pycolmap.Camera(model="OPENCV", width=width, height=height, params=lens, camera_id=1)
    tile = _texture(1024)
    recapture = _core.Recapture(
        photograph=(width, height, 3, 1),
        lens=None,
        interpolation="nearest",
        size=(width, height),
        files=[(work / "photos" / "0.jpg", 0, 0, width, height)],
        jpeg_quality=QUALITY,
        jpeg_chroma=CHROMA,
        last_is_alpha=False,
        in_memory=False,
        white=0,
    )
    across = np.arange(width) % len(tile)
    for row in range(height):
        recapture.push(np.ascontiguousarray(tile[row % len(tile), across][None]))
    recapture.finish()
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    points = np.random.default_rng(0).uniform([-0.4, -0.25, 1], [0.4, 0.25, 1.1], (500, 3))
    tracks = [pycolmap.Track() for _ in points]
    for number in range(count):
        if number > 0:
            os.link(work / "photos" / "0.jpg", work / "photos" / f"{number}.jpg")
        moved = pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([0.01 * number, 0, 0]))
        pixels = camera.img_from_cam(points + moved.translation)
        image = pycolmap.Image(
            name=f"{number}.jpg", keypoints=pixels, camera_id=1, image_id=number + 1
        )
        model.add_image_with_trivial_frame(image, moved)
        for index, track in enumerate(tracks):
            track.add_element(number + 1, index)
    for index, (xyz, track) in enumerate(zip(points, tracks, strict=True), 1):
        model.add_point3D_with_id(index, pycolmap.Point3D(xyz=xyz, track=track))
    (work / "sparse").mkdir()
    model.write_binary(work / "sparse")


def _texture(side: int) -> np.ndarray:
    """RGB noise whose amplitude falls with frequency, as that of aerial photographs; periodic."""
    random = np.random.default_rng(0)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(side), np.fft.fftfreq(side)))
    frequency[0, 0] = 1
    grey = np.fft.ifft2(np.fft.fft2(random.normal(size=(side, side))) / frequency**1.2).real
    grey = 120 + 45 * grey / grey.std()
    color = grey[..., None] * [1, 1.02, 0.93] + random.normal(0, 3, (side, side, 3))
    return np.clip(color, 0, 255).astype(np.uint8)


if __name__ == "__main__":
    main()
