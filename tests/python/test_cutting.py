import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sirpy.cutting import cut, of_one_size
from sirpy.errors import InputError, OutputError
from sirpy.lens import UndistortOptions, moved_between
from sirpy.progress import Progress
from sirpy.rectangle import Grid
from sirpy.windows import read_window
from sirpy.workspace import NativeImage, SubImage, Workspace
from sub_image_scenes import HEIGHT, WIDTH, camera, model_of, noise, read_image, write_image


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


@pytest.fixture(scope="module", params=["PINHOLE", "OPENCV"])
def uncut(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, pycolmap.Reconstruction, np.ndarray]:
    folder = tmp_path_factory.mktemp("uncut")
    photos, model = scene(folder, request.param, ("a.png",))
    workspace = cut(photos, model, folder / "out", identity="", grid=Grid(1, 1))
    return photos, model, read_image(workspace.image(workspace.natives[0].sub_images[0]))


@given(columns=st.integers(1, 20), rows=st.integers(1, 20), overlap=st.integers(0, 40))
@settings(max_examples=12, deadline=None)
def test_any_grid_put_together_is_the_uncut_image(
    uncut: tuple[Path, pycolmap.Reconstruction, np.ndarray],
    tmp_path_factory: pytest.TempPathFactory,
    columns: int,
    rows: int,
    overlap: int,
) -> None:
    photos, model, whole = uncut
    output = tmp_path_factory.mktemp("grid") / "out"
    workspace = cut(photos, model, output, identity="", grid=Grid(columns, rows), overlap=overlap)
    (native,) = workspace.natives
    together = np.zeros_like(whole)
    owners = np.zeros(whole.shape[:2], int)
    for sub in native.sub_images:
        pixels = read_image(workspace.image(sub)).reshape(sub.stored.height, sub.stored.width, 3)
        np.testing.assert_array_equal(pixels, whole[sub.stored.slices_in(native.rectangle)])
        together[sub.core.slices_in(native.rectangle)] = pixels[sub.core.slices_in(sub.stored)]
        owners[sub.core.slices_in(native.rectangle)] += 1
    np.testing.assert_array_equal(together, whole)
    assert (owners == 1).all()


def test_pinhole_pixels_are_those_of_the_photograph(
    uncut: tuple[Path, pycolmap.Reconstruction, np.ndarray],
) -> None:
    photos, model, whole = uncut
    if model.camera(1).model_name == "PINHOLE":
        np.testing.assert_array_equal(whole, read_image(photos / "a.png"))


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
    refuse("jpeg_quality = 0", jpeg_quality=0)
    refuse("format = 'gif'", format="gif")
    refuse("no folder", images=tmp_path / "absent")
    refuse("no image with a pose", model=pycolmap.Reconstruction())
    refuse("outside the folder", model=model_of(["../a.png"], [camera("PINHOLE")]))
    write_image(photos / "b.png", noise((HEIGHT, WIDTH + 1, 3)))
    refuse(r"b\.png has 91x70 pixels, but its camera 1 in the model 90x70")


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
            read_window(workspace, native, native.rectangle, color=True),
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
    workspace = cut(photos, model, tmp_path / "out", identity="", grid=Grid(1, 1), format=format)
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


SCRIPT_THAT_DIES = """
import os, signal, sys
from pathlib import Path
import pycolmap
from sirpy.cutting import cut, of_one_size
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


@given(
    grid=st.tuples(st.integers(1, 7), st.integers(1, 7)),
    overlap=st.integers(0, 30),
    multiple=st.sampled_from([1, 8, 32]),
    sizes=st.lists(st.tuples(st.integers(7, 200), st.integers(7, 200)), min_size=1, max_size=3),
)
def test_sub_images_of_one_size_hold_what_they_held(
    grid: tuple[int, int], overlap: int, multiple: int, sizes: list[tuple[int, int]]
) -> None:
    natives = []
    for width, height in sizes:
        whole = NativeImage("", width, height, ())
        subs = tuple(
            SubImage("", row, column, core, core.padded(overlap).intersection(whole.rectangle))
            for row, column, core in Grid(*grid).cores(width, height)
        )
        natives.append(NativeImage("", width, height, subs))
    before = [sub.stored for native in natives for sub in native.sub_images]
    largest = [max(one.width for one in before), max(one.height for one in before)]
    wanted = [-(-side // multiple) * multiple for side in largest]
    for old, new in zip(natives, of_one_size(natives, multiple), strict=True):
        size = min(wanted[0], old.width), min(wanted[1], old.height)
        for one, other in zip(old.sub_images, new.sub_images, strict=True):
            assert (other.stored.width, other.stored.height) == size
            assert other.core == one.core
            assert other.stored.contains(one.stored)
            assert new.rectangle.contains(other.stored)


def test_sub_images_with_few_points_are_left_out_and_named(tmp_path: Path) -> None:
    photos, model = scene(tmp_path, "PINHOLE")
    everything = cut(photos, model, tmp_path / "all", identity="", grid=Grid(3, 3))
    full = pycolmap.Reconstruction(everything.sparse)
    seen = {full.image(i).name: full.image(i).num_points3D for i in full.reg_image_ids()}
    least = sorted(seen.values())[5]
    notes = Notes()
    some = cut(
        photos,
        model,
        tmp_path / "some",
        identity="",
        grid=Grid(3, 3),
        min_points=least,
        progress=notes,
    )
    expected = sorted(name for name, n in seen.items() if n >= least)
    assert len(expected) < len(seen)
    assert sorted(sub.name for _, sub in some.sub_images()) == expected
    assert sorted(path.name for path in some.images.iterdir()) == expected
    kept = pycolmap.Reconstruction(some.sparse)
    assert sorted(kept.image(i).name for i in kept.reg_image_ids()) == expected
    dropped = sorted(seen.keys() - set(expected))
    # What nobody owns is black.
    for full_native, native in zip(everything.natives, some.natives, strict=True):
        for sub in full_native.sub_images:
            if sub.name in dropped:
                assert not read_window(some, native, sub.core).any()
    (note,) = [text for text in notes.notes if "fewer than" in text]
    assert note.startswith(f"{len(dropped)} sub-images see fewer than {least} sparse points")
    assert dropped[0] in note
    with pytest.raises(InputError, match="no sub-image sees 1000 sparse points"):
        cut(photos, model, tmp_path / "none", identity="", grid=Grid(3, 3), min_points=1000)
