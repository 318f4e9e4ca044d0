from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sirpy import windows
from sirpy.cutting import cut
from sirpy.errors import InputError
from sirpy.layout import Region
from sirpy.rectangle import Grid, Rectangle
from sirpy.windows import read_map, read_map_window, read_window, write_map
from sirpy.workspace import Workspace
from sub_image_scenes import HEIGHT, WIDTH, camera, model_of, noise, write_image

rectangles = st.builds(
    Rectangle.from_corners,
    st.integers(0, WIDTH // 2),
    st.integers(0, HEIGHT // 2),
    st.integers(WIDTH // 2 + 1, WIDTH),
    st.integers(HEIGHT // 2 + 1, HEIGHT),
)


@pytest.fixture(scope="module")
def pixels() -> np.ndarray:
    return noise((HEIGHT, WIDTH, 3))


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory, pixels: np.ndarray) -> Workspace:
    folder = tmp_path_factory.mktemp("windows")
    write_image(folder / "photos" / "a.png", pixels)
    model = model_of(["a.png"], [camera("PINHOLE")])
    return cut(folder / "photos", model, folder / "out", identity="", grid=Grid(4, 3), overlap=5)


@given(rectangle=rectangles)
@settings(
    max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_windows_across_borders_are_the_uncut_image(
    workspace: Workspace, pixels: np.ndarray, rectangle: Rectangle
) -> None:
    native = workspace.natives[0]
    part = pixels[rectangle.slices_in(native.rectangle)]
    np.testing.assert_array_equal(read_window(workspace, native.name, rectangle, "color"), part)
    red, green, blue = np.moveaxis(part.astype(int), 2, 0)
    grey = (4899 * red + 9617 * green + 1868 * blue + 8192) >> 14
    np.testing.assert_array_equal(read_window(workspace, native.name, rectangle), grey)


def test_jpeg_windows_are_parts_of_the_whole(tmp_path: Path, pixels: np.ndarray) -> None:
    write_image(tmp_path / "photos" / "a.jpg", pixels)
    for shape in ((HEIGHT, WIDTH, 3), (HEIGHT, WIDTH)):
        write_image(tmp_path / "photos" / "a.jpg", noise(shape))
        workspace = cut(
            tmp_path / "photos",
            model_of(["a.jpg"], [camera("PINHOLE")]),
            tmp_path / "out",
            identity="",
            grid=Grid(2, 2),
        )
        native = workspace.natives[0]
        whole = read_window(workspace, native.name, native.rectangle, "color")
        rectangle = Rectangle(13, 21, 61, 40)
        part = read_window(workspace, native.name, rectangle, "color")
        np.testing.assert_array_equal(part, whole[rectangle.slices_in(native.rectangle)])


def test_windows_beyond_the_image_are_refused(workspace: Workspace) -> None:
    native = workspace.natives[0]
    for rectangle in (Rectangle(-1, 0, 5, 5), Rectangle(0, 60, 5, 11), Rectangle(3, 3, 0, 4)):
        with pytest.raises(ValueError, match="is not inside"):
            read_window(workspace, native.name, rectangle)


@pytest.mark.parametrize("kind", ["depth", "normal"])
def test_map_windows_across_borders_are_the_uncut_map(workspace: Workspace, kind: str) -> None:
    native = workspace.natives[0]
    shape = ((3,) if kind == "normal" else ()) + (HEIGHT, WIDTH)
    whole = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    path_of = workspace.depth_map if kind == "depth" else workspace.normal_map
    for sub in native.sub_images:
        write_map(path_of(sub, "geometric"), whole[(..., *sub.stored.slices_in(native.rectangle))])
    rectangle = Rectangle(10, 5, 70, 60)
    window = read_map_window(workspace, native, rectangle, kind)
    part = whole[(..., *rectangle.slices_in(native.rectangle))]
    np.testing.assert_array_equal(window, part)
    with pytest.raises(InputError, match="there is no map"):
        read_map_window(workspace, native, rectangle, kind, "photometric")


def test_maps_are_in_colmaps_format(tmp_path: Path) -> None:
    path = tmp_path / "map.bin"
    normals = np.arange(2 * 3 * 3, dtype=np.float32).reshape(3, 2, 3)
    write_map(path, normals)
    data = path.read_bytes()
    assert data.startswith(b"3&2&3&")
    # The x of all pixels comes first, row by row.
    np.testing.assert_array_equal(np.frombuffer(data[6:], "<f4", 6), normals[0].ravel())
    np.testing.assert_array_equal(read_map(path), normals)
    write_map(path, normals[1].copy())
    assert path.read_bytes().startswith(b"3&2&1&")
    np.testing.assert_array_equal(read_map(path), normals[1])


@pytest.mark.parametrize("damage", ["short", "long", "header", "empty", "zero"])
def test_damaged_maps_are_refused(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "map.bin"
    write_map(path, np.ones((4, 5), np.float32))
    data = path.read_bytes()
    path.write_bytes(
        {
            "short": data[:-1],
            "long": data + b"\0",
            "header": b"five&4&1&" + data[6:],
            "empty": b"",
            "zero": b"0&4&1&",
        }[damage]
    )
    with pytest.raises(InputError, match="run the stereo again"):
        read_map(path)


def test_a_map_of_another_size_is_refused(workspace: Workspace) -> None:
    native = workspace.natives[0]
    sub = native.sub_images[0]
    write_map(workspace.depth_map(sub, "photometric"), np.ones((4, 5), np.float32))
    with pytest.raises(InputError, match="delete it and run the stereo again"):
        read_map_window(workspace, native, sub.core, "depth", "photometric")


def test_pixels_that_no_sub_image_holds_are_0(tmp_path: Path, pixels: np.ndarray) -> None:
    write_image(tmp_path / "photos" / "a.png", pixels)
    model = model_of(["a.png"], [camera("PINHOLE")])
    roi = Rectangle(20, 10, 50, 40)
    workspace = cut(
        tmp_path / "photos",
        model,
        tmp_path / "out",
        identity="",
        grid=Grid(3, 2),
        region=Region(roi=roi),
    )
    whole = Rectangle(0, 0, WIDTH, HEIGHT)
    expected = np.zeros_like(pixels)
    expected[roi.slices_in(whole)] = pixels[roi.slices_in(whole)]
    for kind in ("color", "all"):
        np.testing.assert_array_equal(read_window(workspace, "a.png", whole, kind), expected)
    assert not read_window(workspace, "a.png", Rectangle(0, 0, 5, 5)).any()
    with pytest.raises(InputError, match=r"has no photograph b\.png"):
        read_window(workspace, "b.png", whole)


def test_pixels_without_an_owner_come_from_the_overlap(tmp_path: Path, pixels: np.ndarray) -> None:
    write_image(tmp_path / "photos" / "a.png", pixels)
    workspace = cut(
        tmp_path / "photos",
        model_of(["a.png"], [camera("PINHOLE")]),
        tmp_path / "out",
        identity="",
        grid=Grid(2, 2),
        region=Region(roi=Rectangle(30, 20, 20, 20)),
        same_size=16,  # larger than the region: 16 x 16 of 10 x 10
    )
    native = workspace.natives[0]
    assert native.covered.contains(Rectangle(29, 19, 22, 22))
    whole = native.rectangle
    part = pixels[native.covered.slices_in(whole)]
    np.testing.assert_array_equal(read_window(workspace, "a.png", native.covered, "color"), part)


def test_the_cache_is_bounded_and_sees_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads: list[Path] = []

    def read_file(path: Path, window: Rectangle, kind: str, white: int) -> np.ndarray:
        reads.append(path)
        value = int(path.read_text())
        return np.full((window.height, window.width), value, np.uint8)

    monkeypatch.setattr(windows, "_read_file", read_file)
    cache = windows._ImageCache(4000)
    paths = [tmp_path / str(i) for i in range(8)]
    for i, path in enumerate(paths):
        path.write_text(str(i))

    def value(i: int, side: int = 30) -> int:
        part = (slice(1, 3), slice(2, 5))
        seen = cache.read(paths[i], Rectangle(0, 0, side, side), part, "grey", 255)
        assert seen.shape == (2, 3)
        return int(seen[0, 0])

    assert [value(i % 4) for i in range(12)] == [0, 1, 2, 3] * 3
    assert len(reads) == 4  # 4 of 900 bytes fit
    assert [value(i) for i in range(8)] == list(range(8))
    assert len(reads) == 8
    assert value(0) == 0 and len(reads) == 9  # the oldest had to go
    paths[0].write_text("77")
    assert value(0) == 77
    paths[7].write_text("70")
    assert value(7, side=40) == 70 and value(7, side=40) == 70
    assert len(reads) == 12  # more than a quarter of the bound is never kept
