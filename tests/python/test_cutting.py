import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from sirpy.area import Area
from sirpy.cut_tasks import PixelOptions
from sirpy.cutting import cut
from sirpy.errors import InputError, OutputError
from sirpy.layout import Region
from sirpy.lens import UndistortOptions, moved_between, undistorted_camera
from sirpy.progress import Progress
from sirpy.rectangle import Grid, Rectangle
from sirpy.windows import read_mask_window, read_window
from sirpy.workspace import Workspace
from sub_image_scenes import (
    HEIGHT,
    LENSES,
    WIDTH,
    camera,
    model_of,
    noise,
    read_image,
    read_raster,
    write_image,
    write_raster,
)


class Notes(Progress):
    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


def scene(
    folder: Path, lens: str = "OPENCV", names: tuple[str, ...] = ("a.png", "b.png", "c.png")
) -> tuple[Path, pycolmap.Reconstruction]:
    """Photographs of noise and a model of them, all with one lens."""
    for seed, name in enumerate(names):
        write_image(folder / "photos" / name, noise((HEIGHT, WIDTH, 3), seed))
    return folder / "photos", model_of(list(names), [camera(lens)] * len(names))


def files(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


# A lens, a photograph's name and the type of its samples: every lens, then every kind of file.
KINDS = [(lens, "a.png", "uint8") for lens in LENSES] + [
    (lens, name, bits)
    for lens in ("PINHOLE", "OPENCV")
    for name, bits in (
        ("a.jpg", "uint8"),
        ("a.tif", "uint8"),
        ("a.png", "uint16"),
        ("a.tif", "uint16"),
    )
]
# Without loss whatever the input.
LOSSLESS = PixelOptions(format="png")


@pytest.fixture(scope="module", params=KINDS, ids="-".join)
def uncut(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, pycolmap.Reconstruction, np.ndarray]:
    """Photographs, their model, and the undistorted image in one piece."""
    lens, name, bits = request.param
    folder = tmp_path_factory.mktemp("uncut")
    if name == "a.jpg":
        write_image(folder / "photos" / name, noise((HEIGHT, WIDTH, 3)))
    else:
        samples = noise((HEIGHT, WIDTH, 6)).view(np.uint16)
        write_raster(
            folder / "photos" / name, (samples % 256 if bits == "uint8" else samples).astype(bits)
        )
    model = model_of([name], [camera(lens)])
    workspace = cut(
        folder / "photos", model, folder / "out", identity="", grid=Grid(1, 1), pixels=LOSSLESS
    )
    whole = read_raster(workspace.image(workspace.natives[0].sub_images[0]))
    assert whole.dtype == bits
    return folder / "photos", model, whole


@given(columns=st.integers(1, 20), rows=st.integers(1, 20), overlap=st.integers(0, 40))
@example(columns=90, rows=1, overlap=0)  # one pixel wide
@settings(max_examples=2, deadline=None)
def test_any_grid_put_together_is_the_uncut_image(
    uncut: tuple[Path, pycolmap.Reconstruction, np.ndarray],
    tmp_path_factory: pytest.TempPathFactory,
    columns: int,
    rows: int,
    overlap: int,
) -> None:
    photos, model, whole = uncut
    columns = min(columns, whole.shape[1])
    output = tmp_path_factory.mktemp("grid") / "out"
    grid = Grid(columns, rows)
    workspace = cut(photos, model, output, identity="", grid=grid, overlap=overlap, pixels=LOSSLESS)
    (native,) = workspace.natives
    together = np.zeros_like(whole)
    owners = np.zeros(whole.shape[:2], int)
    for sub in native.sub_images:
        pixels = read_raster(workspace.image(sub))
        np.testing.assert_array_equal(pixels, whole[sub.stored.slices_in(native.rectangle)])
        together[sub.core.slices_in(native.rectangle)] = pixels[sub.core.slices_in(sub.stored)]
        owners[sub.core.slices_in(native.rectangle)] += 1
    np.testing.assert_array_equal(together, whole)
    assert (owners == 1).all()


def test_cameras_of_sub_images_see_what_the_native_camera_sees(
    uncut: tuple[Path, pycolmap.Reconstruction, np.ndarray],
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    photos, model, _ = uncut
    output = tmp_path_factory.mktemp("cameras") / "out"
    workspace = cut(photos, model, output, identity="", grid=Grid(7, 5), pixels=LOSSLESS)
    natives = pycolmap.Reconstruction(workspace.native_model)
    native = natives.camera(1)
    target = undistorted_camera(model.camera(1))
    assert native.params.tolist() == target.params.tolist()
    subs = pycolmap.Reconstruction(workspace.sparse)
    rays = np.column_stack([np.random.default_rng(0).uniform(-9, 9, (50, 2)), np.ones(50)])
    for image_id, sub in enumerate(workspace.natives[0].sub_images, 1):
        sub_camera = subs.camera(image_id)
        origin = [sub.stored.x0, sub.stored.y0]
        np.testing.assert_array_equal(
            sub_camera.params[2:], native.params[2:] - np.array(origin, float)
        )
        moved = native.img_from_cam(rays) - origin
        np.testing.assert_allclose(sub_camera.img_from_cam(rays), moved, atol=1e-9)


def test_pinhole_pixels_are_those_of_the_photograph(
    uncut: tuple[Path, pycolmap.Reconstruction, np.ndarray],
) -> None:
    photos, model, whole = uncut
    if model.camera(1).model_name == "PINHOLE":
        (photograph,) = photos.iterdir()
        expected = (
            read_image(photograph) if photograph.suffix == ".jpg" else read_raster(photograph)
        )
        np.testing.assert_array_equal(whole, expected)


def bilinear(pixels: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """COLMAP's rule: black beyond the outermost pixel centres."""
    x, y = np.moveaxis(positions - 0.5, -1, 0)
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    height, width = pixels.shape[:2]
    inside = (x0 >= 0) & (y0 >= 0) & (x0 + 1 < width) & (y0 + 1 < height)
    x0, y0 = np.where(inside, x0, 0), np.where(inside, y0, 0)
    dx, dy = (x - x0)[..., None], (y - y0)[..., None]
    p = pixels.astype(float)
    value = (1 - dy) * ((1 - dx) * p[y0, x0] + dx * p[y0, x0 + 1])
    value += dy * ((1 - dx) * p[y0 + 1, x0] + dx * p[y0 + 1, x0 + 1])
    return np.where(inside[..., None], value, 0)


@pytest.mark.parametrize("blank_pixels", [0, 1])
@pytest.mark.parametrize("lens", ["OPENCV", "OPENCV_FISHEYE", "SIMPLE_FISHEYE"])
def test_undistortion_is_bilinear_at_the_exact_positions(
    tmp_path: Path, lens: str, blank_pixels: float
) -> None:
    photos, model = scene(tmp_path, lens, ("a.png",))
    options = UndistortOptions(blank_pixels=blank_pixels)
    workspace = cut(
        photos, model, tmp_path / "out", identity="", grid=Grid(1, 1), undistort=options
    )
    whole = read_image(workspace.image(workspace.natives[0].sub_images[0]))
    target = pycolmap.Reconstruction(workspace.sparse).camera(1)
    y, x = np.mgrid[0 : target.height, 0 : target.width]
    centres = np.stack([x.ravel(), y.ravel()], -1) + 0.5
    positions = moved_between(target, model.camera(1), centres).reshape(*whole.shape[:2], 2)
    expected = bilinear(read_image(photos / "a.png"), positions)
    assert (np.abs(whole - expected) <= 1).mean() > 0.999


def test_uncut_agrees_with_pycolmap(tmp_path: Path) -> None:
    # At an equal size COLMAP warps once; elsewhere releases before the direct warp resample twice.
    photos, model = scene(tmp_path, "OPENCV", ("a.png",))
    scales = {"min_scale": 1.0, "max_scale": 1.0}
    (tmp_path / "model").mkdir()
    model.write(tmp_path / "model")
    pycolmap.undistort_images(
        tmp_path / "colmap",
        tmp_path / "model",
        photos,
        undistort_options=pycolmap.UndistortCameraOptions(**scales),
    )
    workspace = cut(
        photos,
        model,
        tmp_path / "out",
        identity="",
        grid=Grid(1, 1),
        undistort=UndistortOptions(**scales),
    )
    ours = read_image(workspace.image(workspace.natives[0].sub_images[0]))
    theirs = read_image(tmp_path / "colmap" / "images" / "a.png")
    assert (np.abs(ours.astype(int) - theirs).max(axis=-1) <= 1).mean() > 0.999
    our_camera = pycolmap.Reconstruction(workspace.sparse).camera(1)
    their_camera = pycolmap.Reconstruction(tmp_path / "colmap" / "sparse").camera(1)
    assert (our_camera.model, our_camera.width, our_camera.height) == (
        their_camera.model,
        their_camera.width,
        their_camera.height,
    )
    np.testing.assert_array_equal(our_camera.params, their_camera.params)


def test_the_number_of_threads_changes_nothing(tmp_path: Path) -> None:
    _, model = scene(tmp_path, "OPENCV", ("a.jpg", "b.png"))
    model.write(tmp_path)
    script = (
        "import sys, pathlib, pycolmap;"
        "from sirpy.cutting import cut; from sirpy.rectangle import Grid;"
        "p = pathlib.Path(sys.argv[1]);"
        "cut(p / 'photos', pycolmap.Reconstruction(p), pathlib.Path(sys.argv[2]), identity='',"
        "grid=Grid(3, 2))"
    )
    outputs = []
    for threads in ("1", "2"):
        subprocess.run(
            [sys.executable, "-c", script, tmp_path, tmp_path / threads],
            env={**os.environ, "OMP_NUM_THREADS": threads},
            check=True,
            timeout=60,
        )
        outputs.append(files(tmp_path / threads / "images"))
    assert len(outputs[0]) == 12
    assert outputs[0] == outputs[1]


def test_photographs_that_cannot_be_used_are_left_out(tmp_path: Path) -> None:
    names = ("a.jpg", "b.jpg", "c.jpg", "d.jpg")
    photos, model = scene(tmp_path, "OPENCV", names)
    damaged = (photos / "b.jpg").read_bytes()
    (photos / "b.jpg").write_bytes(damaged[: len(damaged) * 2 // 3])
    (photos / "c.jpg").unlink()
    progress = Notes()
    workspace = cut(
        photos, model, tmp_path / "out", identity="", grid=Grid(1, 5), progress=progress
    )
    assert [native.name for native in workspace.natives] == ["a.jpg", "d.jpg"]
    assert [out.name for out in workspace.left_out] == ["b.jpg", "c.jpg"]
    assert "damaged" in workspace.left_out[0].reason
    assert "there is no photograph" in workspace.left_out[1].reason
    assert [note.split()[0] for note in progress.notes] == ["c.jpg", "b.jpg"]
    # Also the upper sub-images, which were whole before the damage was met, are gone.
    assert {path.name[0] for path in workspace.images.iterdir()} == {"a", "d"}
    for folder in (workspace.native_model, workspace.sparse):
        kept = pycolmap.Reconstruction(folder)
        assert {image.name[0] for image in kept.images.values()} == {"a", "d"}


def test_without_a_usable_photograph_nothing_is_written(tmp_path: Path) -> None:
    photos, model = scene(tmp_path)
    for path in photos.iterdir():
        path.write_bytes(b"")
    with pytest.raises(InputError, match="none of the 3 photographs"):
        cut(photos, model, tmp_path / "out", identity="", grid=Grid(2, 2))
    assert not (tmp_path / "out").exists()


def test_mistakes_are_found_before_anything_is_written(tmp_path: Path) -> None:
    photos, model = scene(tmp_path)
    output = tmp_path / "out"

    def refuse(match: str, **changed: object) -> None:
        arguments = {"images": photos, "model": model, "output": output, "grid": Grid(2, 2)}
        with pytest.raises(InputError, match=match):
            cut(identity="", **{**arguments, **changed})
        assert not output.exists()

    refuse("larger than an image of", grid=Grid(200, 1))
    refuse("overlap = -1", overlap=-1)
    refuse("outside the undistorted", region=Region(roi=Rectangle(0, 0, 1000, 10)))
    refuse("x.png, which is not among", region=Region(rois={"x.png": Rectangle(0, 0, 10, 10)}))
    refuse("column cut at 400 is outside", grid=Grid.with_cuts((400,)))
    refuse("no folder", images=tmp_path / "absent")
    refuse("no image with a pose", model=pycolmap.Reconstruction())
    refuse("outside the folder", model=model_of(["../a.png"], [camera("PINHOLE")]))
    for name in ("a.png", "b.png", "c.png"):
        write_image(photos / name, noise((HEIGHT, WIDTH + 1, 3)))
    refuse(r"none of the 3 .*a\.png has 91x70 pixels, but its camera 1 in the model 90x70")


def test_photographs_are_never_written_over(tmp_path: Path) -> None:
    _, model = scene(tmp_path)
    (tmp_path / "photos").rename(tmp_path / "images")
    before = files(tmp_path)
    for images in (tmp_path / "images", tmp_path):
        with pytest.raises((InputError, OutputError)):
            cut(images, model, tmp_path, identity="", grid=Grid(2, 2))
    assert files(tmp_path) == before


def test_photographs_of_one_stem_do_not_meet(tmp_path: Path) -> None:
    photos, model = scene(tmp_path, "PINHOLE", ("x/a.png", "x/a.bmp", "x/b.png"))
    workspace = cut(photos, model, tmp_path / "out", identity="", grid=Grid(1, 1))
    assert [sub.name for _, sub in workspace.sub_images()] == [
        "x/a.bmp_r00_c00.png",
        "x/a.png_r00_c00.png",
        "x/b_r00_c00.png",
    ]
    for native in workspace.natives:
        np.testing.assert_array_equal(
            read_window(workspace, native.name, native.rectangle, "color"),
            read_image(photos / native.name),
        )


@pytest.mark.parametrize(
    ("source", "format", "extension"),
    [("jpg", None, "jpg"), ("png", None, "png"), ("tif", None, "png"), ("png", "jpg", "jpg")],
)
def test_the_format_is_kept_where_it_can_be(
    tmp_path: Path, source: str, format: str | None, extension: str
) -> None:
    photos, model = scene(tmp_path, "PINHOLE", (f"a.{source}",))
    workspace = cut(
        photos,
        model,
        tmp_path / "out",
        identity="",
        grid=Grid(1, 1),
        pixels=PixelOptions(format=format),
    )
    (path,) = workspace.images.iterdir()
    assert path.suffix == f".{extension}"
    assert path.read_bytes()[:2] == {"jpg": b"\xff\xd8", "png": b"\x89P"}[extension]


def test_a_smaller_image_is_the_mean_of_the_undistorted_one(tmp_path: Path) -> None:
    photos, model = scene(tmp_path, "PINHOLE", ("a.png",))
    options = UndistortOptions(max_image_size=45)
    workspace = cut(
        photos, model, tmp_path / "out", identity="", grid=Grid(1, 1), undistort=options
    )
    small = read_image(workspace.image(workspace.natives[0].sub_images[0]))
    blocks = read_image(photos / "a.png").reshape(35, 2, 45, 2, 3).astype(int)
    np.testing.assert_array_equal(small, (blocks.sum(axis=(1, 3)) + 2) // 4)


@given(data=st.data(), overlap=st.integers(0, 20))
@settings(max_examples=2, deadline=None)
def test_any_region_is_that_part_of_the_uncut_image(
    uncut: tuple[Path, pycolmap.Reconstruction, np.ndarray],
    tmp_path_factory: pytest.TempPathFactory,
    data: st.DataObject,
    overlap: int,
) -> None:
    photos, model, whole = uncut
    height, width = whole.shape[:2]
    x0, y0 = data.draw(st.integers(0, width - 1)), data.draw(st.integers(0, height - 1))
    roi = Rectangle(
        x0, y0, data.draw(st.integers(1, width - x0)), data.draw(st.integers(1, height - y0))
    )
    cuts = data.draw(st.sets(st.integers(x0 + 1, roi.x1 - 1))) if roi.width > 1 else set()
    grid = Grid.with_cuts(tuple(sorted(cuts)), rows=data.draw(st.integers(1, min(roi.height, 5))))
    output = tmp_path_factory.mktemp("region") / "out"
    workspace = cut(
        photos,
        model,
        output,
        identity="",
        grid=grid,
        overlap=overlap,
        region=Region(roi=roi),
        pixels=LOSSLESS,
    )
    (native,) = workspace.natives
    expected = np.zeros_like(whole)
    expected[roi.slices_in(native.rectangle)] = whole[roi.slices_in(native.rectangle)]
    np.testing.assert_array_equal(
        read_window(workspace, native.name, native.rectangle, "all"), expected
    )
    cameras = pycolmap.Reconstruction(workspace.sparse).cameras
    centre = pycolmap.Reconstruction(workspace.native_model).camera(1).params[2:]
    for index, sub in enumerate(native.sub_images, start=1):
        moved = np.array([sub.stored.x0, sub.stored.y0])
        np.testing.assert_allclose(cameras[index].params[2:], centre - moved, atol=1e-9)
        assert cameras[index].width == sub.stored.width


def test_only_sub_images_that_see_the_area_are_cut(tmp_path: Path) -> None:
    photos, model = scene(tmp_path, "PINHOLE")
    # The points lie at z = 3 in front of the cameras; a strip at the left border of what they see.
    strip = Area((tuple([np.array([[-9, -9], [-1.2, -9], [-1.2, 9], [-9, 9], [-9, -9]], float)]),))
    nowhere = Area((tuple([np.array([[50, 0], [51, 0], [51, 1], [50, 0]], float)]),))
    with pytest.raises(InputError, match=r"no photograph of the model sees the area.*x from -"):
        cut(
            photos, model, tmp_path / "o", identity="", grid=Grid(4, 1), region=Region(area=nowhere)
        )
    assert not (tmp_path / "o").exists()
    progress = Notes()
    workspace = cut(
        photos,
        model,
        tmp_path / "out",
        identity="",
        grid=Grid(4, 1),
        region=Region(area=strip),
        progress=progress,
    )
    assert {sub.column for _, sub in workspace.sub_images()} == {0, 1}
    assert len(files(workspace.images)) == len(list(workspace.sub_images()))
    assert any(note.startswith("area: ") for note in progress.notes)
    # Another area is another cut; the same one is not.
    before = files(workspace.folder)
    cut(photos, model, tmp_path / "out", identity="", grid=Grid(4, 1), region=Region(area=strip))
    assert files(workspace.folder) == before
    workspace = cut(photos, model, tmp_path / "out", identity="", grid=Grid(4, 1))
    assert {sub.column for _, sub in workspace.sub_images()} == {0, 1, 2, 3}


SCRIPT_THAT_DIES = """
import os, signal, sys
from pathlib import Path
import pycolmap
from sirpy.cut_tasks import PixelOptions
from sirpy.cutting import cut
from sirpy.progress import Progress, Steps
from sirpy.rectangle import Grid

class Die(Steps):
    def advance(self, steps=1):
        (Path(sys.argv[1]) / "out" / "images" / ".half.1.tmp.png").touch()
        os.kill(os.getpid(), signal.SIGKILL)

class Dying(Progress):
    def stage(self, name, total, unit):
        from contextlib import nullcontext
        return nullcontext(Die())

p = Path(sys.argv[1])
cut(p / "photos", pycolmap.Reconstruction(p), p / "out", identity="", grid=Grid(3, 2),
    progress=Dying())
"""


def test_a_killed_run_is_continued(tmp_path: Path) -> None:
    photos, model = scene(tmp_path)
    model.write(tmp_path)
    model = pycolmap.Reconstruction(tmp_path)
    undisturbed = cut(photos, model, tmp_path / "other", identity="", grid=Grid(3, 2))
    died = subprocess.run([sys.executable, "-c", SCRIPT_THAT_DIES, tmp_path], timeout=60)
    assert died.returncode == -signal.SIGKILL
    workspace = Workspace(tmp_path / "out")
    assert not workspace.index.exists()
    first = {path: path.stat().st_mtime_ns for path in workspace.images.glob("a_*.png")}
    assert len(first) == 6

    cut(photos, model, tmp_path / "out", identity="", grid=Grid(3, 2))
    assert {path: path.stat().st_mtime_ns for path in first} == first
    assert files(tmp_path / "out") == files(undisturbed.folder)

    done = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*")}
    cut(photos, model, tmp_path / "out", identity="", grid=Grid(3, 2))
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*")} == done


def test_other_options_or_photographs_are_cut_again(tmp_path: Path) -> None:
    photos, model = scene(tmp_path, "PINHOLE", ("a.png",))
    output = tmp_path / "out"
    cut(photos, model, output, identity="", grid=Grid(2, 1))
    workspace = cut(photos, model, output, identity="", grid=Grid(1, 1))
    assert [path.name for path in workspace.images.iterdir()] == ["a_r00_c00.png"]
    write_image(photos / "a.png", noise((HEIGHT, WIDTH, 3), 9))
    workspace = cut(photos, model, output, identity="", grid=Grid(1, 1))
    np.testing.assert_array_equal(
        read_image(output / "images" / "a_r00_c00.png"), noise((HEIGHT, WIDTH, 3), 9)
    )
    (output / "images" / "a_r00_c00.png").unlink()
    cut(photos, model, output, identity="", grid=Grid(1, 1))
    assert (output / "images" / "a_r00_c00.png").exists()


def test_a_photograph_of_another_size_is_left_out(tmp_path: Path) -> None:
    photos, model = scene(tmp_path)
    write_image(photos / "b.png", noise((HEIGHT, WIDTH + 1, 3)))
    workspace = cut(photos, model, tmp_path / "out", identity="", grid=Grid(2, 2))
    assert [native.name for native in workspace.natives] == ["a.png", "c.png"]
    (left_out,) = workspace.left_out
    assert "b.png has 91x70 pixels, but its camera 1 in the model 90x70" in left_out.reason


# Half a pixel; rounding; and Lanczos does not keep a ramp.
@pytest.mark.parametrize(
    ("interpolation", "tolerance"),
    [("nearest", 201), ("bilinear", 2), ("bicubic", 2), ("lanczos", 12)],
)
def test_interpolations_agree_on_a_smooth_photograph(
    tmp_path: Path, interpolation: str, tolerance: float
) -> None:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    smooth = np.stack([x, y, (x + y) / 2], -1) * 400
    write_raster(tmp_path / "photos" / "a.tif", smooth.astype(np.uint16))
    model = model_of(["a.tif"], [camera("OPENCV")])
    pixels = PixelOptions(interpolation=interpolation)
    workspace = cut(
        tmp_path / "photos", model, tmp_path / "out", identity="", grid=Grid(1, 1), pixels=pixels
    )
    whole = read_raster(workspace.image(workspace.natives[0].sub_images[0]))
    target = undistorted_camera(model.camera(1))
    v, u = np.mgrid[0 : target.height, 0 : target.width]
    centres = np.stack([u.ravel(), v.ravel()], -1) + 0.5
    positions = moved_between(target, model.camera(1), centres).reshape(*whole.shape[:2], 2) - 0.5
    expected = np.dstack([positions, positions.mean(axis=2)]) * 400
    inner = (slice(4, -4), slice(4, -4))
    error = np.abs(whole[inner] - expected[inner]).max()
    assert error <= tolerance


def test_bands_and_bits_are_kept_on_request(tmp_path: Path) -> None:
    infrared = noise((HEIGHT, WIDTH, 8)).view(np.uint16)
    write_raster(tmp_path / "photos" / "a.tif", infrared, photometric="rgb", alpha="unspecified")
    model = model_of(["a.tif"], [camera("PINHOLE")])

    def stored(**options: object) -> tuple[str, np.ndarray]:
        workspace = cut(
            tmp_path / "photos",
            model,
            tmp_path / "out",
            identity="",
            grid=Grid(1, 1),
            pixels=PixelOptions(**options),
        )
        path = workspace.image(workspace.natives[0].sub_images[0])
        return path.suffix, read_raster(path)

    suffix, pixels = stored()
    assert suffix == ".png"
    np.testing.assert_array_equal(pixels, infrared[..., :3])
    suffix, pixels = stored(bands="all")  # a fourth channel that is not alpha: no PNG
    assert suffix == ".tif"
    np.testing.assert_array_equal(pixels, infrared)
    with pytest.raises(InputError, match=r"a\.tif has 4 channels, which a jpg cannot hold"):
        stored(format="jpg", bands="all")
    # 16 bit become 8 in a JPEG, the photograph's own white 255.
    suffix, pixels = stored(format="jpg")
    assert suffix == ".jpg" and pixels.dtype == np.uint8
    white = np.sort(infrared[..., :3], axis=None)[-int(infrared[..., :3].size * 0.001) - 1]
    shown = np.minimum(infrared[..., :3] / white, 1) * 255
    assert np.abs(pixels - shown).mean() < 8
    for options in ({"format": "gif"}, {"bands": "some"}, {"interpolation": "cubic"}):
        with pytest.raises(InputError, match=f"{next(iter(options))} = .* is not possible"):
            PixelOptions(**options)


def test_masks_are_cut_with_their_photographs(tmp_path: Path) -> None:
    photos, model = scene(tmp_path, "OPENCV", ("a.png", "deep/b.png"))
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[20:50, 30:60] = 0
    write_image(tmp_path / "masks" / "a.png.png", mask)
    workspace = cut(
        photos, model, tmp_path / "out", identity="", grid=Grid(3, 2), masks=tmp_path / "masks"
    )
    first, second = workspace.natives
    assert (first.masked, second.masked) == (True, False)
    masked = read_mask_window(workspace, first.name, first.rectangle)
    target, lens = undistorted_camera(model.camera(1)), model.camera(1)
    v, u = np.mgrid[0 : target.height, 0 : target.width]
    positions = moved_between(target, lens, np.stack([u.ravel(), v.ravel()], -1) + 0.5)
    x, y = np.floor(positions).astype(int).reshape(*masked.shape, 2).transpose(2, 0, 1)
    inside = (x >= 0) & (y >= 0) & (x < WIDTH) & (y < HEIGHT)
    expected = ~inside | (mask[np.where(inside, y, 0), np.where(inside, x, 0)] == 0)
    inner = (slice(2, -2), slice(2, -2))
    assert (masked[inner] != expected[inner]).sum() <= 2  # positions on a border of pixels
    assert masked.sum() > 500
    assert not read_mask_window(workspace, second.name, second.rectangle).any()
    assert {
        path.relative_to(workspace.masks).as_posix() for path in workspace.masks.rglob("*")
    } == {f"{sub.name}.png" for sub in first.sub_images}
    write_image(tmp_path / "masks" / "deep" / "b.png.png", mask[:-1])
    workspace = cut(
        photos, model, tmp_path / "out", identity="", grid=Grid(3, 2), masks=tmp_path / "masks"
    )
    (left_out,) = workspace.left_out
    assert left_out.name == "deep/b.png" and "b.png.png has 90x69 pixels" in left_out.reason


def test_masks_that_fit_no_photograph_are_refused(tmp_path: Path) -> None:
    photos, model = scene(tmp_path, "OPENCV", ("a.png", "b.png"))
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    masks, out = tmp_path / "masks", tmp_path / "out"
    write_image(masks / "a_mask.png", mask)
    with pytest.raises(InputError, match=r"none of the photographs has a mask .* like a\.png\.png"):
        cut(photos, model, out, identity="", grid=Grid(1, 1), masks=masks)
    assert not out.exists()
    write_image(masks / "a.png.png", mask)
    notes = Notes()
    cut(photos, model, out, identity="", grid=Grid(1, 1), masks=masks, progress=notes)
    assert any("1 of 2 photographs have no mask" in note for note in notes.notes)
    # Nor may masks lie where they would be written, or any input where it would be removed.
    with pytest.raises(InputError, match="masks lies where this workspace keeps its own files"):
        cut(photos, model, out, identity="", grid=Grid(1, 1), masks=out / "masks")
    with pytest.raises(InputError, match="sparse lies where this workspace keeps its own files"):
        cut(photos, out / "sparse", out, grid=Grid(1, 1))
    assert (out / "masks").exists() and (out / "sparse" / "images.bin").exists()


def test_models_that_were_removed_are_written_again(tmp_path: Path) -> None:
    photos, model = scene(tmp_path)
    workspace = cut(photos, model, tmp_path / "out", identity="", grid=Grid(2, 1))
    before = files(workspace.folder)
    shutil.rmtree(workspace.sparse)
    cut(photos, model, tmp_path / "out", identity="", grid=Grid(2, 1))
    assert files(workspace.folder) == before


def test_16_bit_workspaces_show_the_brightest_white_as_white(tmp_path: Path) -> None:
    ramp = np.tile(np.linspace(0, 3000, WIDTH).astype(np.uint16)[:, None], (HEIGHT, 1, 1))
    write_raster(tmp_path / "photos" / "a.tif", ramp)
    write_raster(tmp_path / "photos" / "b.tif", ramp // 2)
    model = model_of(["a.tif", "b.tif"], [camera("PINHOLE")] * 2)
    for format in ("png", "tif"):
        workspace = cut(
            tmp_path / "photos",
            model,
            tmp_path / "out",
            identity="",
            grid=Grid(4, 3),
            pixels=PixelOptions(format=format),
        )
        assert [native.white for native in workspace.natives] == [3000, 1500]
        whole = Rectangle(0, 0, WIDTH, HEIGHT)
        np.testing.assert_array_equal(read_window(workspace, "a.tif", whole, "all"), ramp)
        for name, top in (("a.tif", 255), ("b.tif", 127.5)):
            grey = read_window(workspace, name, whole)
            assert grey.dtype == np.uint8
            assert np.abs(grey - np.linspace(0, top, WIDTH)).max() <= 1
