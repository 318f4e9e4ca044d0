import shutil
import subprocess
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from sirpy.layout import Layout
from sirpy.rectangle import Grid
from sirpy.sub_image_model import sub_image_model, undistorted_model, write_model
from sirpy.workspace import NativeImage
from sub_image_scenes import camera, model_of, residuals


def cut_model(
    grid: Grid, overlap: int
) -> tuple[pycolmap.Reconstruction, list[NativeImage], pycolmap.Reconstruction]:
    names = ["a.jpg", "sub/b.jpg", "c.jpg"]
    cameras = [camera("OPENCV", 4), camera("PINHOLE", 2), camera("OPENCV", 4)]
    native = undistorted_model(model_of(names, cameras))
    layout = Layout(grid, overlap)
    natives = []
    for name in sorted(names):
        target = native.camera(native.find_image_with_name(name).camera_id)
        cut = layout.native_image(name, (target.width, target.height))
        natives.append(layout.named(cut, name[:-4], "png"))
    return native, natives, sub_image_model(native, natives)


def test_undistorted_observations_move_with_the_lens() -> None:
    model = model_of(["a.jpg", "b.jpg"], [camera("OPENCV", 3), camera("SIMPLE_PINHOLE", 5)])
    native = undistorted_model(model)
    assert {i: native.image(i).name for i in native.reg_image_ids()} == {1: "a.jpg", 2: "b.jpg"}
    assert {c.camera_id: c.model_name for c in native.cameras.values()} == {
        3: "PINHOLE",
        5: "PINHOLE",
    }
    seen = 0
    for image_id, image in model.images.items():
        np.testing.assert_allclose(
            image.cam_from_world().matrix(), native.image(image_id).cam_from_world().matrix()
        )
        moved = {p.point3D_id: p.xy for p in native.image(image_id).points2D}
        for point2d in image.points2D:
            if point2d.has_point3D():
                ray = image.camera.cam_from_img(point2d.xy)
                moved_ray = native.image(image_id).camera.cam_from_img(moved[point2d.point3D_id])
                np.testing.assert_allclose(moved_ray, ray, atol=1e-9)
                seen += 1
    assert seen == model.compute_num_observations() == native.compute_num_observations()
    for point_id in model.point3D_ids():
        np.testing.assert_array_equal(model.point3D(point_id).xyz, native.point3D(point_id).xyz)
        np.testing.assert_array_equal(model.point3D(point_id).color, native.point3D(point_id).color)


def test_only_chosen_images_stay() -> None:
    model = model_of(["a.jpg", "b.jpg"], [camera("PINHOLE", 1), camera("PINHOLE", 1)])
    native = undistorted_model(model, names=["b.jpg"])
    assert [image.name for image in native.images.values()] == ["b.jpg"]
    assert all(point.track.length() == 1 for point in native.points3D.values())
    assert native.num_points3D() < model.num_points3D()


@pytest.mark.parametrize("overlap", [0, 9])
def test_residuals_are_those_of_the_native_model(overlap: int) -> None:
    native, natives, subs = cut_model(Grid(3, 2), overlap)
    expected = residuals(native)
    found = residuals(subs)
    seen = set()
    for image in natives:
        for sub in image.sub_images:
            for (name, point_id), residual in found.items():
                if name == sub.name:
                    seen.add((image.name, point_id))
                    np.testing.assert_allclose(residual, expected[image.name, point_id], atol=1e-9)
    # Every observation inside its image is in at least one sub-image, in just one without overlap.
    inside = {
        (image.name, point2d.point3D_id)
        for image in native.images.values()
        for point2d in image.points2D
        if (point2d.xy >= 0).all()
        and (point2d.xy < [image.camera.width, image.camera.height]).all()
    }
    assert seen == inside
    assert (len(found) == len(inside)) == (overlap == 0)


def test_cameras_differ_by_whole_pixels_only() -> None:
    native, natives, subs = cut_model(Grid(3, 2), 9)
    for image in natives:
        camera_of_native = native.find_image_with_name(image.name).camera
        for sub in image.sub_images:
            posed = subs.find_image_with_name(sub.name)
            fx, fy, cx, cy = posed.camera.params
            shift = [sub.stored.x0, sub.stored.y0]
            np.testing.assert_array_equal([fx, fy], camera_of_native.params[:2])
            np.testing.assert_array_equal([cx, cy], camera_of_native.params[2:] - shift)
            assert (posed.camera.width, posed.camera.height) == (
                sub.stored.width,
                sub.stored.height,
            )
            np.testing.assert_array_equal(
                posed.cam_from_world().matrix(),
                native.find_image_with_name(image.name).cam_from_world().matrix(),
            )


def test_tracks_and_observations_agree() -> None:
    _, _, subs = cut_model(Grid(3, 2), 9)
    for point_id, point in subs.points3D.items():
        assert point.track.length() > 0
        for element in point.track.elements:
            point2d = subs.image(element.image_id).points2D[element.point2D_idx]
            assert point2d.point3D_id == point_id


def test_written_models_are_read_again(tmp_path: Path) -> None:
    _, _, subs = cut_model(Grid(2, 2), 3)
    write_model(subs, tmp_path / "sparse")
    write_model(subs, tmp_path / "sparse")
    assert [path.name for path in tmp_path.iterdir()] == ["sparse"]
    again = pycolmap.Reconstruction(tmp_path / "sparse")
    assert residuals(again).keys() == residuals(subs).keys()
    assert again.num_points3D() == subs.num_points3D()


@pytest.mark.skipif(shutil.which("colmap") is None, reason="needs the program colmap")
def test_colmap_reads_the_model(tmp_path: Path) -> None:
    _, _, subs = cut_model(Grid(2, 2), 3)
    write_model(subs, tmp_path / "sparse")
    done = subprocess.run(
        ["colmap", "model_analyzer", "--path", tmp_path / "sparse"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    assert "Images: 12" in said
    assert f"Points: {subs.num_points3D()}" in said
    assert f"Observations: {subs.compute_num_observations()}" in said
