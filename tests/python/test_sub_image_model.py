import numpy as np
import pycolmap
import pytest
from sirpy.layout import Layout
from sirpy.model_arrays import read_arrays
from sirpy.native_images import NativeImage, SubImage
from sirpy.rectangle import Grid, Rectangle
from sirpy.sub_image_model import sub_image_model, undistorted_model
from sub_image_scenes import camera, model_of, read_by_pycolmap, residuals


def cut_model(
    grid: Grid, overlap: int
) -> tuple[pycolmap.Reconstruction, list[NativeImage], pycolmap.Reconstruction]:
    names = ["a.jpg", "sub/b.jpg", "c.jpg"]
    cameras = [camera("OPENCV", 4), camera("PINHOLE", 2), camera("OPENCV", 4)]
    native = undistorted_model(read_arrays(model_of(names, cameras)))
    layout = Layout(grid, overlap)
    natives = []
    for image in sorted(native.images, key=lambda image: image.name):
        target = native.camera_of(image)
        cut = layout.native_image(image.name, (target.width, target.height))
        natives.append(layout.named(cut, image.name[:-4], "png"))
    subs = sub_image_model(native, natives)
    return read_by_pycolmap(native), natives, read_by_pycolmap(subs)


def test_undistorted_observations_move_with_the_lens() -> None:
    model = model_of(["a.jpg", "b.jpg"], [camera("OPENCV", 3), camera("SIMPLE_PINHOLE", 5)])
    native = read_by_pycolmap(undistorted_model(read_arrays(model)))
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
    native = read_by_pycolmap(undistorted_model(read_arrays(model), names=["b.jpg"]))
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


def test_any_rectangle_takes_the_observations_inside_it() -> None:
    """Rectangles that overlap, leave gaps, reach beyond the image, or hold a single pixel."""
    native = undistorted_model(read_arrays(model_of(["a.jpg"], [camera("PINHOLE")], points=500)))
    x, y = np.floor(native.xy[0]).astype(int).tolist()
    rectangles = [
        Rectangle(-30, 5, 60, 20),
        Rectangle(10, 10, 50, 50),
        Rectangle(x, y, 1, 1),
        Rectangle(85, 65, 400, 300),
        Rectangle(200, 200, 10, 10),
    ]
    subs = [SubImage(f"{i}.png", 0, i, r, r) for i, r in enumerate(rectangles)]
    found = sub_image_model(native, [NativeImage("a.jpg", 90, 70, tuple(subs))])
    for i, r in enumerate(rectangles):
        corner, size = np.array([r.x0, r.y0]), np.array([r.width, r.height])
        inside = ((native.xy >= corner) & (native.xy < corner + size)).all(axis=1)
        np.testing.assert_array_equal(found.xy[found.seen(i)], native.xy[inside] - corner)
        np.testing.assert_array_equal(
            found.point_ids[found.point[found.seen(i)]], native.point_ids[native.point[inside]]
        )
    assert 1 in np.diff(found.starts) and 0 in np.diff(found.starts)
    assert set(found.point) == set(range(len(found.point_ids)))
