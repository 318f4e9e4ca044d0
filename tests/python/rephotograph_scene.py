"""A textured plane before a photograph that is held out, and the wider photographs that a cloud of it is made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image
from sirpy.model_arrays import PosedImage, SparseModel, write_model
from sirpy.ply import write_vertices

WIDTH, HEIGHT, FOCAL, DEPTH = 160, 120, 160.0, 10.0
HELD_OUT = "held.png"
COLOURED = np.dtype(
    [(name, "<f8") for name in "xyz"] + [(name, "u1") for name in ("red", "green", "blue")]
)
LENSES = {
    "PINHOLE": [FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2],
    "OPENCV": [FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, -0.1, 0.02, 1e-3, -1e-3],
}


@dataclass(frozen=True)
class Scene:
    """`points` (height, width, 3) lie where the pixels of the held-out photograph see the plane, with their
    `colours` (height, width, 3)."""

    folder: Path
    model: SparseModel
    points: np.ndarray
    colours: np.ndarray

    @property
    def sparse(self) -> Path:
        return self.folder / "sparse"

    @property
    def images(self) -> Path:
        return self.folder / "images"

    def cloud(self, kept: np.ndarray | None = None, shift: float = 0.0, name: str = "") -> Path:
        """A PLY file of the points, those that are kept, moved along x by a shift in pixels."""
        kept = np.ones((HEIGHT, WIDTH), bool) if kept is None else kept
        vertices = coloured(self.points[kept] + [shift * DEPTH / FOCAL, 0, 0], self.colours[kept])
        path = self.folder / f"cloud{name}.ply"
        write_vertices(path, COLOURED, [vertices])
        return path


def coloured(points: np.ndarray, colours: np.ndarray) -> np.ndarray:
    vertices = np.zeros(len(points), COLOURED)
    for axis, name in enumerate("xyz"):
        vertices[name] = points[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        vertices[name] = colours[:, channel]
    return vertices


def plane_scene(folder: Path, lens: str = "PINHOLE") -> Scene:
    """Every pixel of the held-out photograph is seen by the three others."""
    held = pycolmap.Camera(camera_id=1, model=lens, width=WIDTH, height=HEIGHT, params=LENSES[lens])
    wide = pycolmap.Camera(
        camera_id=2, model="PINHOLE", width=WIDTH, height=HEIGHT, params=[90, 90, 80, 60]
    )
    images = [PosedImage(1, 1, HELD_OUT, (1.0, 0, 0, 0, 0, 0, 0))]
    for index, x in enumerate((-0.5, 0.0, 0.5), start=2):
        images.append(PosedImage(index, 2, f"{index}.png", (1.0, 0, 0, 0, x, 0, 0)))
    pixels = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1) + 0.5
    rays = held.cam_from_img(pixels.reshape(-1, 2))
    points = DEPTH * np.column_stack([rays, np.ones(len(rays))]).reshape(HEIGHT, WIDTH, 3)
    colours = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    sparse = points[4::8, 4::8].reshape(-1, 3)
    cameras = [held, wide, wide, wide]
    xy = [
        camera.img_from_cam(sparse + image.pose[4:])
        for camera, image in zip(cameras, images, strict=True)
    ]
    count = len(sparse)
    model = SparseModel(
        {1: held, 2: wide},
        tuple(images),
        np.arange(1, count + 1, dtype=np.uint64),
        sparse,
        np.zeros((count, 3), np.uint8),
        np.zeros(count),
        np.arange(0, 4 * count + 1, count, dtype=np.int64),
        np.concatenate(xy),
        np.tile(np.arange(count, dtype=np.int32), 4),
    )
    write_model(model, folder / "sparse")
    (folder / "images").mkdir()
    Image.fromarray(colours).save(folder / "images" / HELD_OUT)
    return Scene(folder, model, points, colours)
