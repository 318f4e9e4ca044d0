"""A small synthetic aerial scene with exact ground truth: a town, photographed from the air.

    FOLDER/images/*.jpg   photographs, rendered directly through the lens
    FOLDER/sparse/        COLMAP model (binary): exact camera and poses, points with their
    observations FOLDER/truth.npz      the exact surface (sirpy.truth)

World frame: metres, x east, y north, z up.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sirpy import _core
from sirpy.errors import InputError, OutputError
from sirpy.files import written_whole
from sirpy.flight import GSD, CameraModel, Shot, flying_height, make_camera, plan_flight
from sirpy.pictures import encoded_jpeg
from sirpy.progress import Progress
from sirpy.truth import Evaluation, Truth, evaluate_cloud, visible
from sirpy.workspace import check_writable

__all__ = ["Evaluation", "Truth", "evaluate", "read_truth", "render_scene"]

_BAND_ROWS = 128
_JPEG_QUALITY = 97
_POINTS_OF_AN_IMAGE = 700
_LEAST_EXTENT = 150.0  # half the side of a scene that has whole blocks with towers and woods, m


def render_scene(
    folder: Path | str,
    *,
    image_count: int = 8,
    size: tuple[int, int] = (960, 640),
    camera_model: CameraModel = "OPENCV",
    seed: int = 1,
    keypoint_noise: float = 0.0,
    tall: float = 0.0,
    middle: tuple[float, float] = (0.0, 0.0),
    threads: int = 0,
    progress: Progress | None = None,
) -> Path:
    """Renders a scene into `folder` and returns the folder.

    Args:
        image_count: photographs, at least 2; a quarter of them is oblique.
        size: (width, height) of a photograph in pixels; the GSD is 0.1 m whatever the size.
        camera_model: OPENCV (with lens distortion) or PINHOLE.
        seed: of the town, the flight and all noise.
        keypoint_noise: standard deviation of the model's observations, in pixels.
        tall: height of towers and woods above the ground, in metres, at which the photographs then
            overlap; 0 for a town without them.
        middle: (x, y) of the place photographed.
        threads: 0 uses all; the files are the same whatever the number.

    Raises:
        InputError: an option that cannot be.
        OutputError: the folder cannot be written.
    """
    if keypoint_noise < 0:
        raise InputError(f"keypoint_noise of {keypoint_noise} pixels: it must not be negative")
    if tall < 0:
        raise InputError(f"towers of {tall} metres: the height must not be negative")
    folder = Path(folder)
    check_writable(folder)
    camera = make_camera(camera_model, size)
    top = tall + _ground(seed, middle) if tall else 0.0
    shots = plan_flight(image_count, size, seed, (*middle, top))
    scene = _make_scene(shots, size, seed, tall)
    truth = Truth(scene.surface.vertices, scene.surface.triangles, GSD)
    with (progress or Progress()).stage("rendering", len(shots), "photograph") as steps:
        for index, shot in enumerate(shots):
            image = _photograph(scene, camera, shot, seed * 100_003 + index, threads)
            with written_whole(folder / "images" / shot.name) as temporary:
                temporary.write_bytes(encoded_jpeg(image, _JPEG_QUALITY))
            steps.advance()
    _write_model(folder / "sparse", _make_model(truth, camera, shots, seed, keypoint_noise))
    truth.write(folder / "truth.npz")
    return folder


def read_truth(scene_folder: Path | str) -> Truth:
    """The exact surface of a scene that `render_scene` wrote."""
    return Truth.read(Path(scene_folder) / "truth.npz")


def evaluate(
    scene_folder: Path | str, cloud_path: Path | str, *, thresholds: Sequence[float] = (1, 2, 5)
) -> Evaluation:
    """Accuracy, completeness and F1 of a cloud (PLY, in the scene's world frame) at `thresholds`
    GSD.

    Raises:
        InputError: the folder is no synthetic scene, or the cloud cannot be read.
    """
    import pycolmap

    scene_folder = Path(scene_folder)
    truth = read_truth(scene_folder)
    model = pycolmap.Reconstruction(str(scene_folder / "sparse"))
    return evaluate_cloud(truth, model, Path(cloud_path), thresholds)


def _ground(seed: int, place: tuple[float, float]) -> float:
    """The height of the terrain at a place (x, y)."""
    return float(_core.terrain_heights(seed, np.array([place], np.float64))[0])


def _make_scene(
    shots: Sequence[Shot], size: tuple[int, int], seed: int, tall: float = 0.0
) -> _core.Scene:
    options = _core.SceneOptions()
    options.seed = seed
    options.finest_detail = GSD
    # The farthest ground that an oblique photograph sees is about two flying heights away.
    farthest = max(float(np.abs(shot.centre[:2]).max()) for shot in shots)
    options.half_extent = farthest + 2.2 * flying_height(size)
    if tall:
        options.tall = tall
        options.half_extent = max(options.half_extent, _LEAST_EXTENT)
    options.terrain_step = max(options.terrain_step, options.half_extent / 500)
    return _core.Scene(options)


def _photograph(
    scene: _core.Scene, camera: Any, shot: Shot, noise_seed: int, threads: int
) -> NDArray[np.uint8]:
    """RGB (height, width, 3), rendered in bands so that the rays of few rows are held at a time."""
    options = _core.RenderOptions()
    options.seed = noise_seed
    options.threads = threads
    world_from_cam = np.ascontiguousarray(shot.cam_from_world.T)
    image = np.empty((camera.height, camera.width, 3), np.uint8)
    for row in range(0, camera.height, _BAND_ROWS):
        end = min(row + _BAND_ROWS, camera.height)
        nodes = _rays_of_corners(camera, row, end)
        image[row:end] = scene.render(nodes, row, shot.centre, world_from_cam, options)
    return image


def _rays_of_corners(camera: Any, first: int, end: int) -> NDArray[np.float64]:
    """Rays of the pixels' corners in rows first .. end: (end - first + 1, width + 1, 2)."""
    x, y = np.meshgrid(np.arange(camera.width + 1.0), np.arange(first, end + 1.0))
    pixels = np.stack([x, y], axis=-1)
    rays = camera.cam_from_img(pixels.reshape(-1, 2))
    return np.ascontiguousarray(rays, np.float64).reshape(pixels.shape)


def _make_model(
    truth: Truth, camera: Any, shots: Sequence[Shot], seed: int, keypoint_noise: float
) -> Any:
    """The exact model: points where random pixels meet the surface, with all their true
    observations.
    """
    import pycolmap

    model = pycolmap.Reconstruction()
    camera.camera_id = 1
    model.add_camera_with_trivial_rig(camera)
    for index, shot in enumerate(shots, start=1):
        rotation = pycolmap.Rotation3d(shot.cam_from_world)
        pose = pycolmap.Rigid3d(rotation, -shot.cam_from_world @ shot.centre)
        image = pycolmap.Image(name=shot.name, camera_id=1, image_id=index)
        model.add_image_with_trivial_frame(image, pose)

    random = np.random.default_rng([seed, 7])
    points = _sparse_points(truth, camera, shots, random)
    tracks: list[list[tuple[int, int]]] = [[] for _ in points]
    for image_id in sorted(model.images):
        image = model.images[image_id]
        seen = visible(truth, image, points)
        pixels = camera.img_from_cam(image.cam_from_world() * points[seen])
        pixels = pixels + random.normal(0, 1, pixels.shape) * keypoint_noise
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(pixel) for pixel in pixels])
        for place, index in enumerate(seen):
            tracks[index].append((image_id, place))
    for point, track in zip(points, tracks, strict=True):
        if len(track) < 2:
            continue
        elements = [pycolmap.TrackElement(image_id, place) for image_id, place in track]
        model.add_point3D(point, pycolmap.Track(elements), np.array([128, 128, 128], np.uint8))
    model.update_point_3d_errors()
    return model


def _sparse_points(
    truth: Truth, camera: Any, shots: Sequence[Shot], random: np.random.Generator
) -> NDArray[np.float64]:
    """Where random pixels of each photograph meet the surface: (points, 3)."""
    points = []
    for shot in shots:
        pixels = random.uniform(0, 1, (_POINTS_OF_AN_IMAGE, 2)) * [camera.width, camera.height]
        rays = np.column_stack([camera.cam_from_img(pixels), np.ones(len(pixels))])
        rays = np.ascontiguousarray(rays @ shot.cam_from_world)
        way = truth.surface.cast(shot.centre, rays)
        hit = np.isfinite(way)
        points.append(shot.centre + way[hit, None] * rays[hit])
    return np.concatenate(points)


def _write_model(folder: Path, model: Any) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        model.write_binary(str(folder))
    except (OSError, RuntimeError, ValueError) as error:
        raise OutputError(
            f"cannot write the model {folder} ({error}): free some space or choose another folder"
        ) from error
