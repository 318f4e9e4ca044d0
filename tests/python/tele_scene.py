"""A town seen by two cameras of one place in the air, nearly: one has twice the focal length."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
from sirpy.flight import GSD, Shot, flying_height, make_camera
from sirpy.synthetic import _make_scene, _photograph
from sirpy.truth import Truth, visible
from sub_image_scenes import write_image

SIZE = 240, 180


def wide_and_tele(folder: Path) -> Path:
    """images/wide.png and tele.png, both straight down; sparse/ and truth.npz as of `render_scene`.

    The second stands a fifth of the height to the north and sees half of the first one's columns and
    rows.
    """
    height = flying_height(SIZE)
    down = np.diag([1.0, -1.0, -1.0])
    shots = [
        Shot("wide.png", np.array([0.0, 0.0, height]), down),
        Shot("tele.png", np.array([0.0, 0.2 * height, height]), down),
    ]
    scene = _make_scene(shots, SIZE, seed=1)
    truth = Truth(scene.surface.vertices, scene.surface.triangles, GSD)
    truth.write(folder / "truth.npz")
    model = pycolmap.Reconstruction()
    for number, shot in enumerate(shots, start=1):
        camera = make_camera("PINHOLE", SIZE)
        camera.camera_id = number
        camera.focal_length_x *= number
        camera.focal_length_y *= number
        model.add_camera_with_trivial_rig(camera)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(down), -down @ shot.centre)
        image = pycolmap.Image(name=shot.name, camera_id=number, image_id=number)
        model.add_image_with_trivial_frame(image, pose)
        write_image(folder / "images" / shot.name, _photograph(scene, camera, shot, number, 0))
    _add_points(model, truth)
    (folder / "sparse").mkdir()
    model.write_binary(str(folder / "sparse"))
    return folder


def _add_points(model: pycolmap.Reconstruction, truth: Truth) -> None:
    """Points of the surface that both photographs see."""
    random = np.random.default_rng(4)
    first, second = (model.images[number] for number in (1, 2))
    camera = model.cameras[2]
    pixels = random.uniform(0, 1, (2000, 2)) * SIZE
    rays = np.column_stack([camera.cam_from_img(pixels), np.ones(len(pixels))])
    rotation = second.cam_from_world().rotation.matrix()
    centre = second.projection_center()
    way = truth.surface.cast(centre, np.ascontiguousarray(rays @ rotation))
    points = centre + way[:, None] * (rays @ rotation)
    seen = [set(visible(truth, image, points).tolist()) for image in (first, second)]
    both = sorted(seen[0] & seen[1])
    for image in (first, second):
        of_camera = model.cameras[image.camera_id]
        found = of_camera.img_from_cam(image.cam_from_world() * points[both])
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(pixel) for pixel in found])
    for place, index in enumerate(both):
        track = pycolmap.Track([pycolmap.TrackElement(number, place) for number in (1, 2)])
        model.add_point3D(points[index], track, np.full(3, 128, np.uint8))
    model.update_point_3d_errors()
