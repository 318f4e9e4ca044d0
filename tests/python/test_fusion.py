"""Fusion through the workspace's files: perfect depth maps give a perfect cloud."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pycolmap
import pytest
from sirpy.cut_tasks import PixelOptions
from sirpy.cutting import cut
from sirpy.errors import InputError
from sirpy.fusion import FusionOptions, fuse
from sirpy.native_scene import NativeCamera, read_native_scene
from sirpy.ply import read_vertices
from sirpy.rectangle import Grid
from sirpy.sparse_model import read_model
from sirpy.synthetic import evaluate, read_truth
from sirpy.view_selection import views
from sirpy.windows import read_map_window, write_map
from sirpy.workspace import Workspace

Floats = npt.NDArray[np.float64]


def _normals(depth: Floats, camera: NativeCamera) -> Floats:
    """(3, height, width), camera frame, towards the camera: across the neighbours of each pixel."""
    y, x = np.mgrid[0.5 : depth.shape[0], 0.5 : depth.shape[1]]
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(camera.intrinsics).T
    points = rays * depth[..., None]
    normal = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    normal *= -np.sign((normal * points).sum(axis=-1, keepdims=True))
    return np.moveaxis(normal, -1, 0)


@pytest.fixture(scope="module")
def perfect(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """A workspace of 2x2 sub-images with the true depths."""
    output = tmp_path_factory.mktemp("perfect")
    model = read_model(town / "sparse")
    workspace = cut(town / "images", model, output, identity="town", grid=Grid(2, 2))
    views(workspace)
    truth, scene = read_truth(town), read_native_scene(workspace)
    native_model = pycolmap.Reconstruction(str(workspace.native_model))
    images = {image.name: image for image in native_model.images.values()}
    for native in workspace.natives:
        image = images[native.name]
        camera = native_model.cameras[image.camera_id]
        depth = truth.depth_map(camera, image.cam_from_world()).astype(np.float64)
        normal = _normals(depth, scene.cameras[native.name])
        for sub in native.sub_images:
            rows, columns = sub.stored.slices_in(native.rectangle)
            write_map(
                workspace.depth_map(sub, "geometric"), depth[rows, columns].astype(np.float32)
            )
            write_map(
                workspace.normal_map(sub, "geometric"), normal[:, rows, columns].astype(np.float32)
            )
    return workspace


def _copy_maps(source: Workspace, target: Workspace) -> None:
    """The depths and normals of native images, cut up in another way."""
    for native, sub in target.sub_images():
        of_source = source.native(native.name)
        depth = read_map_window(source, of_source, sub.stored, "depth")
        normal = read_map_window(source, of_source, sub.stored, "normal")
        write_map(target.depth_map(sub, "geometric"), depth)
        write_map(target.normal_map(sub, "geometric"), normal)


def test_perfect_maps_give_a_perfect_cloud(town: Path, perfect: Workspace) -> None:
    count = fuse(perfect)
    judged = evaluate(town, perfect.fused, thresholds=(0.5, 1))
    assert judged.accuracy[0] > 0.99
    assert judged.completeness[1] > 0.95
    assert len(read_vertices(perfect.fused)) == count


def test_the_cloud_does_not_depend_on_threads(perfect: Workspace) -> None:
    fuse(perfect, options=FusionOptions(threads=1))
    one = perfect.fused.read_bytes()
    for _, sub_image in perfect.sub_images():
        perfect.fused_part(sub_image).unlink()
    fuse(perfect, options=FusionOptions(threads=3))
    assert perfect.fused.read_bytes() == one


def test_the_cloud_does_not_depend_on_the_grid(
    town: Path, perfect: Workspace, tmp_path: Path
) -> None:
    # Two sources for each block of a photograph, of five: a sub-image's blocks have more together.
    clouds = []
    for grid in (Grid(1, 1), Grid(5, 3)):
        output = tmp_path / str(grid)
        pixels = PixelOptions(format="png")
        workspace = cut(town / "images", town / "sparse", output, grid=grid, pixels=pixels)
        views(workspace, num_sources=2)
        _copy_maps(perfect, workspace)
        fuse(workspace)
        points = read_vertices(workspace.fused)
        clouds.append(np.sort(points, order=["x", "y", "z"]))
    assert len(clouds[0]) > 10_000
    np.testing.assert_array_equal(clouds[0], clouds[1])


@pytest.mark.parametrize("damage", [lambda data: data[:200], lambda data: b"", lambda data: b"x"])
def test_a_damaged_part_is_said_and_made_again(
    perfect: Workspace, damage: Callable[[bytes], bytes]
) -> None:
    fuse(perfect)
    cloud = perfect.fused.read_bytes()
    part = perfect.fused_part(perfect.natives[2].sub_images[1])
    part.write_bytes(damage(part.read_bytes()))
    with pytest.raises(InputError, match=f"{part} .*: delete it and run `sirpy fuse` again"):
        fuse(perfect)
    part.unlink()
    fuse(perfect)
    assert perfect.fused.read_bytes() == cloud


def test_duplicates_are_kept_on_request(town: Path, perfect: Workspace) -> None:
    owned = fuse(perfect)
    everything = fuse(perfect, options=FusionOptions(keep_duplicates=True))
    assert everything > 1.5 * owned


def test_missing_depth_maps_are_named(town: Path, tmp_path: Path) -> None:
    model = read_model(town / "sparse")
    workspace = cut(town / "images", model, tmp_path, identity="town", grid=Grid(1, 1))
    views(workspace)
    with pytest.raises(InputError, match="run `sirpy stereo` first"):
        fuse(workspace)


@pytest.mark.parametrize(
    "options", [{"min_consistent": 0}, {"consistency": 0.0}, {"min_consistent": 99}]
)
def test_options_out_of_range_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(InputError, match="is not possible"):
        FusionOptions(**options)  # type: ignore[arg-type]
