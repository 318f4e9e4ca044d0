from pathlib import Path

import numpy as np
import pytest
import rasterio
from sirpy.cloud_picture import draw_cloud
from sirpy.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform")


def write(path: Path, points: np.ndarray, colours: np.ndarray) -> Path:
    fields = [(name, "<f4") for name in "xyz"] + [(n, "u1") for n in ("red", "green", "blue")]
    rows = np.zeros(len(points), fields)
    rows["x"], rows["y"], rows["z"] = points.T
    rows["red"], rows["green"], rows["blue"] = colours.T
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n"
        + "".join(f"property float {name}\n" for name in "xyz")
        + "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
        + "end_header\n"
    )
    path.write_bytes(header.encode() + rows.tobytes())
    return path


def plane(z: float, count: int = 300) -> np.ndarray:
    axis = np.linspace(-1, 1, count)
    x, y = np.meshgrid(axis, axis)
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1)


def colours_of(picture: Path) -> np.ndarray:
    with rasterio.open(picture) as file:
        return np.moveaxis(file.read(), 0, -1)


def test_the_nearer_point_hides_the_farther(tmp_path: Path) -> None:
    """A red plane above a green one; east is right, north is up."""
    red, green = np.array([[200, 0, 0]]), np.array([[0, 200, 0]])
    upper = plane(1)
    upper = upper[(upper[:, 0] > 0) & (upper[:, 1] > 0)]  # the north-eastern quarter
    points = np.concatenate([upper, plane(0)])
    colours = np.concatenate([np.repeat(red, len(upper), 0), np.repeat(green, 90_000, 0)])
    for order in (slice(None), slice(None, None, -1)):
        cloud = write(tmp_path / "cloud.ply", points[order], colours[order])
        image = colours_of(draw_cloud(cloud, tmp_path / "cloud.png", size=200))
        quarter, three = len(image) // 4, 3 * len(image) // 4
        assert tuple(image[quarter, three]) == (200, 0, 0)
        assert tuple(image[three, three]) == (0, 200, 0)
        assert tuple(image[quarter, quarter]) == (0, 200, 0)
        assert tuple(image[0, 0]) == (24, 27, 32)
    below = draw_cloud(cloud, tmp_path / "below.png", forward=(0, 0, 1), size=200)
    assert not (colours_of(below)[..., 0] == 200).any()


def test_far_outliers_and_broken_points_do_not_shrink_the_scene(tmp_path: Path) -> None:
    points = np.concatenate([plane(0), [[1e6, 0, 0], [np.nan, 0, 0]]])
    cloud = write(tmp_path / "cloud.ply", points, np.full((len(points), 3), 90))
    image = colours_of(draw_cloud(cloud, tmp_path / "cloud.png", size=100))
    assert np.mean(image == 90) > 0.85


def test_nothing_to_draw_is_said(tmp_path: Path) -> None:
    cloud = write(tmp_path / "cloud.ply", np.empty((0, 3)), np.empty((0, 3)))
    with pytest.raises(InputError, match="no points"):
        draw_cloud(cloud, tmp_path / "cloud.png")
    assert not (tmp_path / "cloud.png").exists()
