"""Fusion through the workspace's files: perfect depth maps give a perfect cloud."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pycolmap
import pytest
from engine_scenes import Notes
from sirpy.cloud import POINT
from sirpy.colmap_dense import open_workspace
from sirpy.cut_tasks import PixelOptions
from sirpy.cutting import cut
from sirpy.errors import InputError
from sirpy.fusion import FusionOptions, fuse, fused_parts
from sirpy.model_files import read_model
from sirpy.native_scene import NativeCamera, read_native_scene
from sirpy.ply import read_vertices
from sirpy.rectangle import Grid
from sirpy.synthetic import evaluate, read_truth
from sirpy.view_selection import views
from sirpy.windows import read_map, read_map_window, write_map
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
    made = fuse(perfect)
    judged = evaluate(town, perfect.fused, thresholds=(0.5, 1))
    assert judged.accuracy[0] > 0.99
    assert judged.completeness[1] > 0.95
    points = read_vertices(perfect.fused)
    assert len(points) == made.points
    assert not made.left_out
    # What is kept of each point.
    assert points.dtype == POINT
    assert points["views"].min() >= 2  # of a place with one source, two
    gsd = np.median(points["gsd"])
    assert np.all((points["gsd"] > 0.5 * gsd) & (points["gsd"] < 3 * gsd))


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
        clouds.append(np.sort(points, order=["x", "y", "z", "nx"]))
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
    owned = fuse(perfect).points
    everything = fuse(perfect, options=FusionOptions(keep_duplicates=True)).points
    assert everything > 1.5 * owned


def _copied(source: Workspace, folder: Path) -> Workspace:
    shutil.copytree(source.folder, folder)
    return Workspace(folder)


def _as_colmap(perfect: Workspace, town: Path, folder: Path, *, normals: bool) -> Path:
    """The dense workspace that COLMAP would have made of uncut images, with the true depths."""
    workspace = cut(town / "images", town / "sparse", folder / "cut", grid=Grid(1, 1))
    _copy_maps(perfect, workspace)
    dense = folder / "dense"
    for name in ("images", "sparse", "stereo"):
        shutil.move(workspace.folder / name, dense / name)
    if not normals:
        shutil.rmtree(dense / "stereo" / "normal_maps")
    return dense


@pytest.mark.parametrize("normals", [True, False])
def test_a_workspace_of_colmap_gives_a_perfect_cloud_too(
    town: Path, perfect: Workspace, tmp_path: Path, normals: bool
) -> None:
    dense = open_workspace(_as_colmap(perfect, town, tmp_path, normals=normals))
    fuse(dense)
    judged = evaluate(town, dense.fused, thresholds=(0.5, 1))
    assert judged.accuracy[0] > 0.99
    assert judged.completeness[1] > 0.95


def test_the_maps_of_a_photometric_pass_do(town: Path, perfect: Workspace, tmp_path: Path) -> None:
    dense = _as_colmap(perfect, town, tmp_path, normals=False)
    expected = fuse(open_workspace(dense)).points
    for path in (dense / "stereo" / "depth_maps").iterdir():
        path.rename(path.with_name(path.name.replace(".geometric.", ".photometric.")))
    assert fuse(open_workspace(dense)).points == expected


def test_maps_of_another_size_than_their_images_are_named(
    town: Path, perfect: Workspace, tmp_path: Path
) -> None:
    dense = open_workspace(_as_colmap(perfect, town, tmp_path, normals=False))
    for _, sub in dense.sub_images():
        path = dense.depth_map(sub, "geometric")
        write_map(path, np.ascontiguousarray(read_map(path)[::2, ::2]))
    with pytest.raises(InputError, match="max_image_size -1"):
        fuse(dense)


@pytest.mark.parametrize("damage", ["missing", "half", "size", "empty"])
def test_a_bad_depth_map_is_left_out_and_said(
    perfect: Workspace, tmp_path: Path, damage: str
) -> None:
    workspace = _copied(perfect, tmp_path / "copy")
    whole = fuse(workspace).points
    name = workspace.natives[1].sub_images[2].name
    bad = workspace.depth_map(workspace.natives[1].sub_images[2], "geometric")
    data = bad.read_bytes()
    if damage == "missing":
        bad.unlink()
    elif damage == "size":
        write_map(bad, np.ones((3, 5), np.float32))
    else:
        bad.write_bytes(data[: len(data) // 2] if damage == "half" else b"")
    notes = Notes()
    made = fuse(workspace, progress=notes)
    assert [out.name for out in made.left_out] == [name]
    assert any(name in note for note in notes.notes)
    assert 0.5 * whole < made.points < whole
    # It is made again: nothing of the cloud without it stays.
    bad.write_bytes(data)
    assert fuse(workspace).points == whole


def test_a_photograph_without_any_depth_map_confirms_nothing(
    perfect: Workspace, tmp_path: Path
) -> None:
    workspace = _copied(perfect, tmp_path / "copy")
    lost = workspace.natives[0]
    for sub in lost.sub_images:
        workspace.depth_map(sub, "geometric").unlink()
    made = fuse(workspace)
    assert {out.name for out in made.left_out} == {sub.name for sub in lost.sub_images}
    assert made.points > 10_000
    assert len(fused_parts(workspace)) == len(list(workspace.sub_images())) - len(lost.sub_images)


def test_a_damaged_normal_map_is_made_of_the_depths(perfect: Workspace, tmp_path: Path) -> None:
    workspace = _copied(perfect, tmp_path / "copy")
    bad = workspace.normal_map(workspace.natives[1].sub_images[0], "geometric")
    bad.write_bytes(bad.read_bytes()[:1000])
    notes = Notes()
    made = fuse(workspace, progress=notes)
    assert not made.left_out
    assert any(str(bad) in note for note in notes.notes)


def test_stray_depths_do_not_make_the_windows_large(
    perfect: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Whatever the blocks, the points are the same.
    workspace = _copied(perfect, tmp_path / "copy")
    fuse(workspace)
    whole = np.sort(np.array(read_vertices(workspace.fused)))
    monkeypatch.setattr("sirpy.fusion._MOST_HELD", 20_000)
    for _, sub in workspace.sub_images():
        workspace.fused_part(sub).unlink()
    fuse(workspace)
    np.testing.assert_array_equal(np.sort(np.array(read_vertices(workspace.fused))), whole)


def test_numbers_that_are_no_depths_give_no_points(perfect: Workspace, tmp_path: Path) -> None:
    workspace = _copied(perfect, tmp_path / "copy")
    sub = workspace.natives[0].sub_images[0]
    path = workspace.depth_map(sub, "geometric")
    depth = read_map(path)
    assert (depth[20:60, 20:80] > 0).all()
    depth[20:30, 20:80] = np.nan
    depth[30:40, 20:80] = -7
    depth[40:50, 20:80] = np.inf
    depth[50:60, 20:80] = 1e-42
    write_map(path, depth)
    notes = Notes()
    fuse(workspace, progress=notes)
    assert any(sub.name in note and "2400 pixels" in note for note in notes.notes)
    points = read_vertices(workspace.fused)
    assert all(np.isfinite(points[field]).all() for field in ("x", "y", "z", "nx", "gsd"))


def test_what_other_views_look_through_is_dropped(perfect: Workspace, tmp_path: Path) -> None:
    # A flake in the air before two photographs, where all the others see the ground.
    workspace = _copied(perfect, tmp_path / "copy")
    scene = read_native_scene(workspace)
    cameras = list(scene.cameras.values())
    middle = cameras[0].centre + 0.7 * (scene.points.mean(axis=0) - cameras[0].centre)
    for native in workspace.natives[:3]:
        camera = scene.cameras[native.name]
        for sub in native.sub_images:
            path = workspace.depth_map(sub, "geometric")
            depth = read_map(path)
            y, x = np.mgrid[sub.stored.y0 : sub.stored.y1, sub.stored.x0 : sub.stored.x1] + 0.5
            at = camera.project(middle[None])[0]
            flake = np.hypot(x - at[0], y - at[1]) < 12
            depth[flake] = camera.in_camera(middle[None])[0, 2]
            write_map(path, depth)
    fuse(workspace)
    points = read_vertices(workspace.fused)
    away = np.linalg.norm(np.column_stack([points[axis] for axis in "xyz"]) - middle, axis=1)
    ground = np.linalg.norm(scene.points.mean(axis=0) - middle)
    assert away.min() > 0.3 * ground


def test_a_killed_run_goes_on(perfect: Workspace, tmp_path: Path) -> None:
    workspace = _copied(perfect, tmp_path / "copy")
    fuse(workspace)
    cloud = workspace.fused.read_bytes()
    # As if the run had ended in the middle of a part.
    part = workspace.fused_part(workspace.natives[1].sub_images[0])
    part.rename(part.with_name(f".{part.stem}.4711.tmp.npy"))
    workspace.fused.unlink()
    workspace.fused_parts.unlink()
    with pytest.raises(InputError, match="run `sirpy fuse` first"):
        fused_parts(workspace)
    fuse(workspace)
    assert workspace.fused.read_bytes() == cloud
    assert not list(part.parent.glob(".*.tmp*"))


def test_missing_depth_maps_are_named(town: Path, tmp_path: Path) -> None:
    model = read_model(town / "sparse")
    workspace = cut(town / "images", model, tmp_path, identity="town", grid=Grid(1, 1))
    views(workspace)
    with pytest.raises(
        InputError, match=r"no depth map that can be used.*run `sirpy stereo` first"
    ):
        fuse(workspace)


@pytest.mark.parametrize(
    "options", [{"min_consistent": 0}, {"consistency": 0.0}, {"min_consistent": 99}]
)
def test_options_out_of_range_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(InputError, match="is not possible"):
        FusionOptions(**options)  # type: ignore[arg-type]
