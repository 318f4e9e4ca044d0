"""Small photographs and models for the tests of recapture, exact where it matters."""

from __future__ import annotations

import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pycolmap
import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning
from sirpy.model_arrays import SparseModel, write_model

# One camera of 90 x 70 pixels for every model of COLMAP that a pinhole camera can replace.
LENSES = {
    "SIMPLE_PINHOLE": [80, 44, 36],
    "PINHOLE": [80, 82, 44, 36],
    "SIMPLE_RADIAL": [80, 44, 36, -0.1],
    "RADIAL": [80, 44, 36, -0.1, 0.02],
    "OPENCV": [80, 82, 44, 36, -0.1, 0.02, 0.001, -0.0005],
    "FULL_OPENCV": [80, 82, 44, 36, -0.1, 0.02, 0.001, -0.0005, 0.01, 0.01, 0, 0],
    "OPENCV_FISHEYE": [80, 82, 44, 36, -0.01, 0.002, 0.001, -0.0005],
    "SIMPLE_FISHEYE": [80, 44, 36],
    "FISHEYE": [80, 82, 44, 36],
    "SIMPLE_RADIAL_FISHEYE": [80, 44, 36, 0.02],
    "RADIAL_FISHEYE": [80, 44, 36, 0.02, 0.001],
    "THIN_PRISM_FISHEYE": [80, 82, 44, 36, 0.01, 0.002, 0.001, 0.0005, 0.001, 2e-4, 1e-4, 1e-4],
    "RAD_TAN_THIN_PRISM_FISHEYE": [80, 82, 44, 36, 0.01, 0.002, *[1e-4] * 10],
    "FOV": [80, 82, 44, 36, 0.5],
    "SIMPLE_DIVISION": [80, 44, 36, -0.1],
    "DIVISION": [80, 82, 44, 36, -0.1],
}
WIDTH, HEIGHT = 90, 70


def camera(model: str, camera_id: int = 1, scale: float = 1) -> pycolmap.Camera:
    made = pycolmap.Camera(
        model=model, width=WIDTH, height=HEIGHT, params=LENSES[model], camera_id=camera_id
    )
    if scale != 1:
        made.rescale(scale)
    return made


def noise(shape: tuple[int, ...], seed: int = 0) -> NDArray[np.uint8]:
    """Pixels without any likeness to their neighbours: any wrong position shows."""
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def write_image(path: Path, pixels: NDArray[np.uint8]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert pycolmap.Bitmap.from_array(pixels).write(path)


def read_image(path: Path) -> NDArray[np.uint8]:
    """As stored: (height, width) grey, or (height, width, 3)."""
    color = np.asarray(pycolmap.Bitmap.read(path, True).to_array())
    grey = np.asarray(pycolmap.Bitmap.read(path, False).to_array()).reshape(color.shape[:2])
    return grey if (color == color[..., :1]).all() else color


def write_raster(path: Path, pixels: NDArray[np.uint8 | np.uint16], **options: object) -> None:
    """(height, width, channels) in the format of the extension, through GDAL."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width, count = pixels.shape
    with (
        warnings.catch_warnings(action="ignore", category=NotGeoreferencedWarning),
        rasterio.Env(GDAL_PAM_ENABLED=False),
        rasterio.open(
            path, "w", width=width, height=height, count=count, dtype=pixels.dtype, **options
        ) as raster,
    ):
        raster.write(pixels.transpose(2, 0, 1))


def read_raster(path: Path) -> NDArray[np.uint8 | np.uint16]:
    """(height, width, channels) as stored, through GDAL."""
    with (
        warnings.catch_warnings(action="ignore", category=NotGeoreferencedWarning),
        rasterio.open(path) as raster,
    ):
        return raster.read().transpose(1, 2, 0)


def model_of(
    names: list[str], cameras: list[pycolmap.Camera], points: int = 200, seed: int = 0
) -> pycolmap.Reconstruction:
    """Images at different poses that see the same random points, each observed with some error."""
    random = np.random.default_rng(seed)
    world = np.column_stack(
        [random.uniform(-1.5, 1.5, points), random.uniform(-1.2, 1.2, points), np.full(points, 3.0)]
    ) + random.normal(0, 0.2, (points, 3))
    model = pycolmap.Reconstruction()
    tracks = [pycolmap.Track() for _ in range(points)]
    for made in {made.camera_id: made for made in cameras}.values():
        model.add_camera_with_trivial_rig(made)
    for image_id, (name, made) in enumerate(zip(names, cameras, strict=True), 1):
        cam_from_world = pycolmap.Rigid3d(
            pycolmap.Rotation3d(np.array([0, 0, 0.1 * image_id])), np.array([0.1 * image_id, 0, 0])
        )
        in_camera = world @ cam_from_world.rotation.matrix().T + cam_from_world.translation
        xy = made.img_from_cam(in_camera) + random.normal(0, 0.5, (points, 2))
        inside = ((xy > 0) & (xy < [made.width, made.height])).all(axis=1)
        # A keypoint without a 3D point comes first, so that indices differ from point numbers.
        keypoints = np.vstack([[1.0, 1.0], xy[inside]])
        image = pycolmap.Image(
            name=name, keypoints=keypoints, camera_id=made.camera_id, image_id=image_id
        )
        model.add_image_with_trivial_frame(image, cam_from_world)
        for index, point in enumerate(np.flatnonzero(inside), 1):
            tracks[point].add_element(image_id, index)
    for point, track in enumerate(tracks):
        if track.length() > 0:
            model.add_point3D_with_id(
                1000 + 7 * point,
                pycolmap.Point3D(
                    xyz=world[point], color=np.array([1, 2, point % 256], np.uint8), track=track
                ),
            )
    return model


def read_by_pycolmap(model: SparseModel) -> pycolmap.Reconstruction:
    """What COLMAP finds in the files of the model."""
    with TemporaryDirectory() as folder:
        write_model(model, Path(folder) / "model")
        return pycolmap.Reconstruction(Path(folder) / "model")


def residuals(model: pycolmap.Reconstruction) -> dict[tuple[str, int], NDArray[np.float64]]:
    """Reprojection error (x, y) in pixels of each observation, by (image name, point id)."""
    found = {}
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        for point2d in image.points2D:
            if point2d.has_point3D():
                xyz = model.point3D(point2d.point3D_id).xyz
                found[image.name, point2d.point3D_id] = point2d.xy - image.project_point(xyz)
    return found
