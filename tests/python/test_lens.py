import numpy as np
import pycolmap
import pytest
from sirpy.errors import InputError
from sirpy.lens import UndistortOptions, lens_nodes, moved_between, undistorted_camera, undistortion
from sub_image_scenes import LENSES, camera


@pytest.mark.parametrize("scale", [1, 30])
@pytest.mark.parametrize("model", LENSES)
def test_nodes_agree_with_the_camera_model(model: str, scale: float) -> None:
    distorted = camera(model, scale=scale)
    undistorted = undistorted_camera(distorted)
    nodes = lens_nodes(distorted, undistorted)
    random = np.random.default_rng(1)
    pixels = 0.5 + np.floor(random.uniform(0, [undistorted.width, undistorted.height], (20_000, 2)))
    corners = np.array([[0.5, 0.5], [undistorted.width - 0.5, undistorted.height - 0.5]])
    pixels = np.vstack([pixels, corners])
    error = nodes.map().at(pixels) - moved_between(undistorted, distorted, pixels)
    assert np.abs(error).max() < 0.01
    assert nodes.error <= 1 / 400
    # Few nodes do: a lens is smooth.
    assert nodes.nodes.size < 2 * 64 * 64


@pytest.mark.parametrize("options", [{}, {"blank_pixels": 0.5}, {"max_image_size": 50}])
@pytest.mark.parametrize("model", ["PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "OPENCV_FISHEYE"])
def test_the_undistorted_camera_is_colmaps(model: str, options: dict[str, float]) -> None:
    distorted = camera(model, camera_id=7)
    ours = undistorted_camera(distorted, UndistortOptions(**options))
    theirs = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(**options), distorted)
    assert ours.model_name == "PINHOLE"
    assert ours.camera_id == 7
    assert (ours.width, ours.height) == (theirs.width, theirs.height)
    np.testing.assert_array_equal(ours.params, theirs.params)


@pytest.mark.parametrize("model", ["PINHOLE", "SIMPLE_PINHOLE"])
def test_pinhole_pixels_are_copied(model: str) -> None:
    how = undistortion(camera(model))
    assert how.lens is None
    np.testing.assert_array_equal(
        how.camera.calibration_matrix(), camera(model).calibration_matrix()
    )


def test_a_lens_beyond_any_pinhole_is_refused() -> None:
    # The undistorted image of half the field of view of 179 degrees is undefined at its border.
    wide = pycolmap.Camera(
        model="SIMPLE_DIVISION", width=90, height=70, params=[20, 45, 35, 2.0], camera_id=3
    )
    with pytest.raises(InputError, match=r"camera 3 \(SIMPLE_DIVISION"):
        undistortion(wide, UndistortOptions(blank_pixels=1))


@pytest.mark.parametrize(
    "options",
    [
        {"blank_pixels": 1.5},
        {"min_scale": 0},
        {"max_scale": 0.1},
        {"max_image_size": 0},
        {"roi_min_x": 0.8, "roi_max_x": 0.2},
    ],
)
def test_impossible_options_name_themselves(options: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(options))):
        UndistortOptions(**options)
