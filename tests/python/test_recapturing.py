from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sirpy.errors import InputError
from sirpy.lens import UndistortOptions
from sirpy.recapturing import recapture, recapture_camera
from sirpy.rectangle import Rectangle
from sub_image_scenes import HEIGHT, LENSES, WIDTH, camera, noise, write_image, write_raster

NAMES = ("a.jpg", "a.png", "a.tif", "deep.png", "deep.tif")


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    for name in NAMES:
        if name.startswith("deep"):
            write_raster(folder / name, noise((HEIGHT, WIDTH, 6)).view(np.uint16))
        else:
            write_image(folder / name, noise((HEIGHT, WIDTH, 3)))
    return folder


@given(data=st.data(), lens=st.sampled_from([*LENSES]), name=st.sampled_from(NAMES))
@settings(max_examples=80, deadline=None)
def test_any_rectangle_is_a_part_of_the_whole(
    photos: Path, data: st.DataObject, lens: str, name: str
) -> None:
    distorted = camera(lens)
    undistort = data.draw(st.sampled_from([None, UndistortOptions(), UndistortOptions(0.5)]))
    whole = data.draw(st.sampled_from(["bilinear", "bicubic", "lanczos", "nearest"]))
    size = distorted
    if undistort is not None:
        size = pycolmap.undistort_camera(
            pycolmap.UndistortCameraOptions(blank_pixels=undistort.blank_pixels), distorted
        )
    everything = Rectangle(0, 0, size.width, size.height)
    x0 = data.draw(st.integers(0, size.width - 1))
    y0 = data.draw(st.integers(0, size.height - 1))
    part = Rectangle(
        x0,
        y0,
        data.draw(st.integers(1, size.width - x0)),
        data.draw(st.integers(1, size.height - y0)),
    )
    options = {"undistort": undistort, "interpolation": whole}
    native = recapture(photos / name, distorted, everything, **options)
    made = recapture(photos / name, distorted, part, **options)
    np.testing.assert_array_equal(made.pixels, native.pixels[part.slices_in(everything)])
    assert made.pixels.dtype == (np.uint16 if name.startswith("deep") else np.uint8)
    # A ray goes through the same pixel, moved by the origin.
    rays = np.array([[0.1, -0.05, 1], [-0.2, 0.1, 1]])
    moved = native.camera.img_from_cam(rays) - [part.x0, part.y0]
    np.testing.assert_allclose(made.camera.img_from_cam(rays), moved, atol=1e-9)


@given(data=st.data(), width=st.integers(1, 40), height=st.integers(1, 40))
@settings(max_examples=60, deadline=None)
def test_photographs_of_any_size(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, width: int, height: int
) -> None:
    path = tmp_path_factory.mktemp("size") / f"a.{data.draw(st.sampled_from(['png', 'tif']))}"
    pixels = noise((height, width, 2 * data.draw(st.sampled_from([1, 3])))).view(np.uint16)
    write_raster(path, pixels)
    whole = Rectangle(0, 0, width, height)
    # The principal point may lie far outside the photograph.
    far = [data.draw(st.floats(-500, 500)), data.draw(st.floats(-500, 500))]
    lens = pycolmap.Camera(model="PINHOLE", width=width, height=height, params=[900, 900, *far])
    x0, y0 = data.draw(st.integers(0, width - 1)), data.draw(st.integers(0, height - 1))
    x1, y1 = data.draw(st.integers(x0 + 1, width)), data.draw(st.integers(y0 + 1, height))
    part = Rectangle.from_corners(x0, y0, x1, y1)
    made = recapture(path, lens, part, undistort=UndistortOptions())
    np.testing.assert_array_equal(made.pixels, pixels[part.slices_in(whole)])
    assert made.camera.params[2:].tolist() == [far[0] - x0, far[1] - y0]


@pytest.mark.parametrize("lens", LENSES)
def test_the_recapture_camera_keeps_the_lens(lens: str) -> None:
    # Far outside too: the principal point is then at (-1e5, 1e5) of the sub-image.
    for rectangle in (Rectangle(13, 21, 5, 1), Rectangle(100_000, -100_000, 7, 9)):
        native = camera(lens)
        made = recapture_camera(native, rectangle)
        assert (made.model, made.width, made.height) == (
            native.model,
            rectangle.width,
            rectangle.height,
        )
        rays = np.array([[0.1, -0.05, 1], [-0.2, 0.1, 1], [0, 0, 1]])
        expected = native.img_from_cam(rays) - [rectangle.x0, rectangle.y0]
        np.testing.assert_allclose(made.img_from_cam(rays), expected, atol=1e-9)


def test_only_the_rows_that_are_needed_are_decoded(photos: Path, tmp_path: Path) -> None:
    lens = pycolmap.Camera(model="PINHOLE", width=600, height=4000, params=[500, 500, 300, 2000])
    write_image(tmp_path / "a.png", noise((4000, 600, 3)))
    whole = recapture(tmp_path / "a.png", lens, Rectangle(0, 0, 600, 4000)).pixels
    content = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(content[: len(content) * 3 // 4])
    part = recapture(tmp_path / "a.png", lens, Rectangle(5, 700, 90, 80)).pixels
    np.testing.assert_array_equal(part, whole[700:780, 5:95])
    with pytest.raises(InputError, match="is damaged"):
        recapture(tmp_path / "a.png", lens, Rectangle(5, 3900, 90, 80))


def test_mistakes_are_named(photos: Path) -> None:
    lens = camera("OPENCV")
    for rectangle in (Rectangle(0, 0, 91, 1), Rectangle(-1, 0, 5, 5), Rectangle(3, 3, 0, 4)):
        with pytest.raises(InputError, match="is not inside the image of 90x70 pixels"):
            recapture(photos / "a.png", lens, rectangle)
    with pytest.raises(InputError, match="has 90x70 pixels, but its camera 45x35"):
        recapture(photos / "a.png", camera("OPENCV", scale=0.5), Rectangle(0, 0, 9, 9))
    for options in ({"interpolation": "cubic"}, {"bands": "x"}):
        with pytest.raises(InputError, match="is not possible: it must be one of"):
            recapture(photos / "a.png", lens, Rectangle(0, 0, 9, 9), **options)
    with pytest.raises(InputError, match="there is no photograph"):
        recapture(photos / "absent.png", lens, Rectangle(0, 0, 9, 9))
