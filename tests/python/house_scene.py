"""A red house with blue walls on ground whose colour tells the place, photographed from above."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pycolmap
from cloud_scenes import cloud_of
from sirpy import _core
from sirpy.cloud import Cloud
from sirpy.cutting import cut
from sirpy.frame import Frame
from sirpy.native_scene import read_native_scene
from sirpy.rectangle import Grid
from sirpy.windows import write_map
from sirpy.workspace import Workspace
from sub_image_scenes import write_image

Floats = npt.NDArray[np.float64]

HALF, ROOF = 5.0, 8.0  # the house: -HALF <= x, y <= HALF, up to ROOF
HEIGHT, FOCAL, SIZE = 60.0, 300.0, (320, 240)
GSD = HEIGHT / FOCAL
RED, BLUE = (230, 20, 20), (20, 20, 230)


def ground_colour(xy: Floats) -> Floats:
    """(n, 3); changes so slowly that a pixel's difference is below a level."""
    x, y = xy[:, 0], xy[:, 1]
    return np.column_stack([90 + 1.5 * x, 120 + 2.0 * y, 60 + 0 * x])


def photographed_house(
    folder: Path, centres: Sequence[tuple[float, float]], frame: Frame | None = None
) -> tuple[Workspace, Cloud]:
    """A workspace of 2x1 sub-images, with exact depth maps, and its cloud, in `frame`.

    Args:
        centres: x and y of the photographs, which look straight down, in the order of their names.
    """
    surface, down = _house(), np.diag([1.0, -1.0, -1.0])
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(
        model="PINHOLE",
        width=SIZE[0],
        height=SIZE[1],
        params=[FOCAL, FOCAL, SIZE[0] / 2, SIZE[1] / 2],
        camera_id=1,
    )
    model.add_camera_with_trivial_rig(camera)
    depths, places, normals = {}, [], []
    for number, (x, y) in enumerate(centres, start=1):
        centre, name = np.array([x, y, HEIGHT]), f"{number}.png"
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(down), -down @ centre)
        v, u = np.mgrid[0.5 : SIZE[1], 0.5 : SIZE[0]]
        rays = np.column_stack(
            [(u.ravel() - SIZE[0] / 2) / FOCAL, (v.ravel() - SIZE[1] / 2) / FOCAL, np.ones(u.size)]
        )
        depth = surface.cast(centre, np.ascontiguousarray(rays @ down))
        seen = centre + depth[:, None] * (rays @ down)
        # A model has sparse points: here one of each photograph.
        image = pycolmap.Image(name=name, keypoints=[[0.5, 0.5]], camera_id=1, image_id=number)
        model.add_image_with_trivial_frame(image, pose)
        track = pycolmap.Track()
        track.add_element(number, 0)
        model.add_point3D_with_id(number, pycolmap.Point3D(xyz=seen[0], track=track))
        write_image(folder / "photos" / name, _colours(seen).reshape(*u.shape, 3))
        depths[name] = depth.reshape(u.shape).astype(np.float32)
        places.append(seen)
        normals.append(_normals(seen))
    (folder / "sparse").mkdir()
    model.write_binary(str(folder / "sparse"))
    workspace = cut(folder / "photos", folder / "sparse", folder / "out", grid=Grid(2, 1))
    assert set(read_native_scene(workspace).cameras) == set(depths)
    for native, sub in workspace.sub_images():
        part = depths[native.name][sub.stored.slices_in(native.rectangle)]
        write_map(workspace.depth_map(sub, "geometric"), np.ascontiguousarray(part))
    frame = frame or Frame()
    moved = frame.world(np.vstack(places))
    turned = np.vstack(normals) @ frame.rotation.T
    gsd = GSD * frame.scale
    return workspace, cloud_of(folder / "points.npy", moved, turned, gsd, frame)


def _house() -> _core.Surface:
    a, far = HALF, 200.0
    vertices = [(x, y, z) for z in (0.0, ROOF) for x, y in [(-a, -a), (a, -a), (a, a), (-a, a)]]
    vertices += [(x, y, 0.0) for x, y in [(-far, -far), (far, -far), (far, far), (-far, far)]]
    sides = [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7), (8, 9, 10, 11)]
    triangles = [half for a, b, c, d in sides for half in ((a, b, c), (a, c, d))]
    return _core.Surface(np.array(vertices, np.float64), np.array(triangles, np.int32))


def _colours(places: Floats) -> npt.NDArray[np.uint8]:
    z = places[:, 2]
    colours = ground_colour(places[:, :2])
    colours[z > 1e-6] = BLUE
    colours[z > ROOF - 1e-6] = RED
    return (np.clip(colours, 0, 255) + 0.5).astype(np.uint8)


def _normals(places: Floats) -> Floats:
    normals = np.tile([0.0, 0.0, 1.0], (len(places), 1))
    wall = (places[:, 2] > 1e-6) & (places[:, 2] < ROOF - 1e-6)
    outward = np.where(np.abs(np.abs(places[:, :2]) - HALF) < 1e-6, np.sign(places[:, :2]), 0.0)
    normals[wall] = np.column_stack([outward[wall], np.zeros(wall.sum())])
    return normals
