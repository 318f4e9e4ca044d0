import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from sirpy.errors import InputError, OutputError
from sirpy.photographs import (
    check_names,
    decimate,
    find_photographs,
    open_photograph,
    photograph_size,
    recapture_to_array,
    recapture_to_files,
    white_level,
)
from sirpy.rectangle import Rectangle
from sub_image_scenes import noise, read_image, write_image, write_raster


def copied(path: Path, folder: Path) -> np.ndarray:
    """The pixels as the C++ core takes them from `path`, through a lossless file."""
    photograph = open_photograph(path)
    size = photograph.width, photograph.height
    output = folder / f"{path.name}.copied.png"
    recapture_to_files(photograph, None, size, [(output, Rectangle(0, 0, *size))])
    return read_image(output)


def test_finds_photographs_by_extension_in_all_folders(tmp_path: Path) -> None:
    for name in ["b/2.JPG", "b/10.jpeg", "a.tif", "c/d/e.Png", "notes.txt", ".hidden.jpg"]:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "c" / "round").symlink_to(tmp_path, target_is_directory=True)
    (tmp_path / "linked.jpg").symlink_to(tmp_path / "b" / "2.JPG")
    assert find_photographs(tmp_path) == [
        "a.tif",
        "b/10.jpeg",
        "b/2.JPG",
        "c/d/e.Png",
        "linked.jpg",
    ]


def test_missing_and_empty_folders_are_errors(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no folder"):
        find_photographs(tmp_path / "absent")
    with pytest.raises(InputError, match="holds no photographs"):
        find_photographs(tmp_path)


@pytest.mark.parametrize(
    "name",
    [
        "./a.jpg",
        "b//a.jpg",
        "/etc/a.jpg",
        "../a.jpg",
        "a/../../b.jpg",
        "C:\\a.jpg",
        "..\\a.jpg",
        "",
        "a\nb.jpg",
    ],
)
def test_names_that_leave_the_folder_are_refused(name: str) -> None:
    check_names(["a.jpg", "b/c d.jpg", "..a.jpg"])
    with pytest.raises(InputError):
        check_names(["a.jpg", name])


@pytest.mark.parametrize("shape", [(70, 90), (70, 90, 3)])
@pytest.mark.parametrize("extension", ["png", "tif", "bmp"])
def test_rows_of_every_format_are_the_pixels(
    tmp_path: Path, shape: tuple[int, ...], extension: str
) -> None:
    pixels = noise(shape)
    path = tmp_path / f"a.{extension}"
    write_image(path, pixels)
    assert photograph_size(path) == (90, 70)
    np.testing.assert_array_equal(copied(path, tmp_path), pixels)


def test_tiled_tiff_is_read_by_rows_of_tiles(tmp_path: Path) -> None:
    pixels = noise((150, 100, 3))
    write_raster(tmp_path / "a.tif", pixels, tiled=True, blockxsize=32, blockysize=32)
    np.testing.assert_array_equal(copied(tmp_path / "a.tif", tmp_path), pixels)


def test_alpha_is_left_out_and_said_so(tmp_path: Path) -> None:
    pixels = noise((20, 30, 4))
    for name, note in (("a.png", "alpha channel"), ("a.tif", "first three bands of 4")):
        write_raster(tmp_path / name, pixels)
        assert note in open_photograph(tmp_path / name).note
        np.testing.assert_array_equal(copied(tmp_path / name, tmp_path), pixels[..., :3])


@pytest.mark.parametrize("kind", ["png", "tif", "tiled", "jp2"])
@pytest.mark.parametrize("count", [1, 3, 4])
def test_16_bit_rows_are_the_pixels(tmp_path: Path, kind: str, count: int) -> None:
    pixels = noise((150, 100, 2 * count)).view(np.uint16)
    path = tmp_path / f"a.{'tif' if kind == 'tiled' else kind}"
    options = {
        "tiled": {"tiled": True, "blockxsize": 32, "blockysize": 32, "compress": "lzw"},
        "jp2": {"QUALITY": 100, "REVERSIBLE": "YES"},
    }
    write_raster(path, pixels, **options.get(kind, {}))
    photograph = open_photograph(path, "all")
    assert (photograph.bits, photograph.channels) == (16, count)
    for window in (Rectangle(0, 0, 100, 150), Rectangle(7, 71, 30, 40), Rectangle(99, 149, 1, 1)):
        part = recapture_to_array(photograph, None, (100, 150), window)
        rows, columns = window.slices_in(Rectangle(0, 0, 100, 150))
        np.testing.assert_array_equal(part, pixels[rows, columns])
    if count == 4:
        assert open_photograph(path).channels == 3


def test_what_a_reader_holds_is_known(tmp_path: Path) -> None:
    pixels = noise((2400, 2000, 3))

    def held(name: str, **options: object) -> int:
        write_raster(tmp_path / name, pixels, **options)
        return open_photograph(tmp_path / name).held_bytes

    cache = pixels.size  # less than GDAL's bound
    strips = held("strips.tif", compress="lzw")
    assert cache < strips < cache + 3_000_000  # some rows of 6000 bytes
    tiles = held("tiles.tif", tiled=True, blockxsize=512, blockysize=512)
    assert tiles - strips == pytest.approx(3 * (512 - 64) * 6000, rel=0.2)
    tall = held("tall.tif", compress="lzw", blockysize=1200)
    assert 3 * (1200 - 64) * 6000 < tall - strips < 3 * 1200 * 6000 + 12_000_000
    # GDAL reads a lone strip by rows, but holds what is compressed.
    stored = held("strip.tif", compress="lzw", blockysize=2400) - strips
    assert stored == pytest.approx((tmp_path / "strip.tif").stat().st_size, rel=0.01)
    assert held("plain.jpg") == 0
    # Two bytes for each coefficient: of the luma, and of two chroma planes of a quarter each.
    assert held("progressive.jpg", PROGRESSIVE="YES") == 3 * 2400 * 2000


def test_white_does_not_count_alpha(tmp_path: Path) -> None:
    for channels in (2, 4):
        pixels = np.full((20, 30, channels), 65535, np.uint16)
        pixels[..., :-1] = 3998
        for name in ("a.tif", "a.png"):
            write_raster(tmp_path / name, pixels, alpha="unspecified" if name == "b" else "yes")
            for bands in ("color", "all"):
                assert white_level(open_photograph(tmp_path / name, bands)) == 3998, (name, bands)


@pytest.mark.parametrize("kind", ["float32", "int16", "uint32"])
def test_other_samples_are_refused(tmp_path: Path, kind: str) -> None:
    write_raster(tmp_path / "a.tif", noise((20, 30, 1)).astype(kind))
    with pytest.raises(InputError, match=f"samples of type {kind}: convert them"):
        photograph_size(tmp_path / "a.tif")


def test_16_bit_photographs_are_decimated_to_their_own_white(tmp_path: Path) -> None:
    # 12 bits of data in 16, and one hot pixel.
    pixels = np.tile(np.linspace(0, 4095, 300).astype(np.uint16)[:, None], (200, 1, 1))
    pixels[0, 0, 0] = 65535
    for name in ("a.png", "a.tif"):
        write_raster(tmp_path / name, pixels)
        assert 4070 < white_level(open_photograph(tmp_path / name)) <= 4095
        decimate(tmp_path / name, tmp_path / "small.jpg", 100)
        small = read_image(tmp_path / "small.jpg").astype(int)
        assert np.abs(small[33] - np.linspace(0.5, 254.5, 100)).max() < 3


@pytest.mark.parametrize("extension", ["jpg", "png", "tif"])
def test_damage_is_found(tmp_path: Path, extension: str) -> None:
    path = tmp_path / f"a.{extension}"
    write_image(path, noise((300, 200, 3)))
    whole = path.read_bytes()
    output = tmp_path / "small.jpg"
    for size in (len(whole) // 2, len(whole) - len(whole) // 20, 0):
        path.write_bytes(whole[:size])
        with pytest.raises(InputError, match=str(path)):
            decimate(path, output, 1000)
    assert os.listdir(tmp_path) == [path.name]
    with pytest.raises(InputError, match="there is no photograph"):
        decimate(tmp_path / "absent.jpg", output, 100)


def test_random_bytes_inside_a_jpeg_are_found(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    write_image(path, noise((300, 200, 3)))
    damaged = bytearray(path.read_bytes())
    middle = len(damaged) // 2
    damaged[middle : middle + 512] = noise((512,)).tobytes()
    path.write_bytes(bytes(damaged))
    with pytest.raises(InputError, match="damaged"):
        decimate(path, tmp_path / "small.jpg", 100)


def area_mean(pixels: np.ndarray, length: int) -> np.ndarray:
    """Along the first axis, in exact fractions."""
    size = len(pixels)
    weights = np.array(
        [
            [
                max(
                    Fraction(0),
                    min(Fraction((i + 1) * size, length), j + 1)
                    - max(Fraction(i * size, length), j),
                )
                for j in range(size)
            ]
            for i in range(length)
        ]
    )
    return np.einsum("ij,j...->i...", weights, pixels) * Fraction(length, size)


@pytest.mark.parametrize("size", [(7, 5), (13, 9), (19, 11), (1, 1)])
def test_shrinking_is_the_mean_over_the_footprint(tmp_path: Path, size: tuple[int, int]) -> None:
    pixels = noise((11, 19, 3))
    write_image(tmp_path / "a.png", pixels)
    output = tmp_path / "small.png"
    photograph = open_photograph(tmp_path / "a.png")
    recapture_to_files(photograph, None, size, [(output, Rectangle(0, 0, *size))])
    exact = area_mean(pixels.astype(object), size[1])
    exact = area_mean(exact.transpose(1, 0, 2), size[0]).transpose(1, 0, 2)
    np.testing.assert_array_equal(read_image(output), np.floor(exact + Fraction(1, 2)).astype(int))


def test_decimation_fits_the_longest_side(tmp_path: Path) -> None:
    y, x = np.mgrid[0:200, 0:301]
    pixels = np.stack([x * 255 // 300, y * 255 // 199, (x + y) * 255 // 499], -1).astype(np.uint8)
    write_image(tmp_path / "a.png", pixels)
    factor = decimate(tmp_path / "a.png", tmp_path / "deep" / "small.jpg", 100)
    assert factor == 301 / 100
    small = read_image(tmp_path / "deep" / "small.jpg")
    assert small.shape == (66, 100, 3)
    # Of a plane the mean over a footprint is the value at its middle.
    assert np.abs(small[33, 50] - pixels[100:101, 151:153].mean(axis=(0, 1))).max() < 3
    assert np.abs(small[5, 90] - pixels[16:17, 271:273].mean(axis=(0, 1))).max() < 3
    assert decimate(tmp_path / "a.png", tmp_path / "same.jpg", 301) == 1
    assert photograph_size(tmp_path / "same.jpg") == (301, 200)


def test_a_folder_that_cannot_be_written_is_an_output_error(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", noise((20, 30)))
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write"):
        decimate(tmp_path / "a.png", tmp_path / "file" / "small.jpg", 100)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_an_output_error(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", noise((200, 300)))
    for name in ("small.jpg", "small.png", "small.tif"):
        # What the writer opens is the temporary name; here it leads to a disk without space.
        temporary = tmp_path / f".small.{os.getpid()}.tmp.{name[-3:]}"
        temporary.symlink_to("/dev/full")
        photograph = open_photograph(tmp_path / "a.png")
        with pytest.raises(OutputError, match="No space left on device; free some space"):
            recapture_to_files(
                photograph, None, (300, 200), [(tmp_path / name, Rectangle(0, 0, 300, 200))]
            )
        assert not (tmp_path / name).exists()


MEASURED = r"""
import re, sys
from pathlib import Path
from sirpy.photographs import open_photograph, recapture_to_files
from sirpy.rectangle import Rectangle
photograph = open_photograph(Path(sys.argv[1]))
size = photograph.width, photograph.height
recapture_to_files(photograph, None, size, [(Path(sys.argv[2]), Rectangle(0, 0, *size))])
print(re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text()).group(1))
"""


@pytest.mark.parametrize("extension", ["jpg", "png", "tif"])
def test_memory_does_not_grow_with_the_height(tmp_path: Path, extension: str) -> None:
    peaks = []
    for height in (3000, 30_000):
        path = tmp_path / f"{height}.{extension}"
        write_raster(path, np.broadcast_to(noise((height, 1, 3)), (height, 900, 3)))
        command = [sys.executable, "-c", MEASURED, path, tmp_path / f"out.{extension}"]
        peaks.append(1024 * int(subprocess.check_output(command)))
    assert peaks[1] - peaks[0] < 8_000_000  # ten times as many pixels: 73 MB more of them
