"""The cases in which COLMAP fails (docs/robustness.md): each ends in one sentence, with nothing half-written."""

from __future__ import annotations

import os
import resource
import shutil
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import sirpy
from sirpy.errors import InputError
from sirpy.workspace import Workspace
from sub_image_scenes import (
    HEIGHT,
    WIDTH,
    camera,
    model_of,
    noise,
    read_raster,
    write_image,
    write_raster,
)

NAMES = ("a.jpg", "b.jpg", "c.png", "d.tif")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Good photographs of three formats, and their model."""
    for seed, name in enumerate(NAMES):
        write_image(tmp_path / "photos" / name, noise((HEIGHT, WIDTH, 3), seed))
    write_model(tmp_path, NAMES)
    return tmp_path


def write_model(folder: Path, names: tuple[str, ...]) -> None:
    (folder / "sparse").mkdir(exist_ok=True)
    model_of(list(names), [camera("OPENCV")] * len(names)).write_binary(folder / "sparse")


def cut(
    folder: Path, *options: str, output: str = "out", limit: Callable[[], None] | None = None
) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "sirpy", "cut", folder / "photos", "--quiet"]
    command += ["--model", folder / "sparse", "--output", folder / output]
    command += ["--columns", "2", "--rows", "2", *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, preexec_fn=limit)


def sentence(run: subprocess.CompletedProcess[str]) -> str:
    assert run.returncode == 2, run.stderr
    (line,) = run.stderr.strip().splitlines()
    assert line.startswith("sirpy: ")
    return line


def everything(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def png_header(width: int, height: int) -> bytes:
    fields = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunk = b"IHDR" + fields
    return (
        b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))
    )


def jpeg_header(width: int, height: int) -> bytes:
    frame = struct.pack(">BHHB", 8, height, width, 1) + b"\x01\x11\x00"
    return b"\xff\xd8\xff\xc0" + struct.pack(">H", len(frame) + 2) + frame


def tiff_header(width: int, height: int) -> bytes:
    """One strip of everything that lies far beyond the end of the file."""
    entries = [(256, width), (257, height), (258, 8), (259, 1), (262, 1), (273, 4000)]
    entries += [(277, 1), (278, height), (279, min(width * height, 2**32 - 1))]
    directory = struct.pack("<H", len(entries))
    directory += b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in entries)
    return b"II*\0" + struct.pack("<I", 8) + directory + bytes(4)


def tiff_of_one_tile(width: int, height: int) -> bytes:
    """Of a few bytes, as Deflate may make them of nothing."""
    tile = -(-max(width, height) // 16) * 16
    entries = [(256, width), (257, height), (258, 8), (259, 8), (262, 1), (277, 1)]
    entries += [(322, tile), (323, tile), (324, 160), (325, 30)]
    directory = struct.pack("<H", len(entries))
    directory += b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in entries)
    head = b"II*\0" + struct.pack("<I", 8) + directory + bytes(4)
    return head.ljust(160, b"\0") + zlib.compress(bytes(3000))


def corrupt_tiff_directory(content: bytes) -> bytes:
    at = struct.unpack_from("<I", content, 4)[0]
    return content[:at] + b"\xff\xff" + content[at + 2 :]


def overwrite(name: str, change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        path = folder / "photos" / name
        path.write_bytes(change(path.read_bytes()))

    return damage


DAMAGES = {
    "JPEG cut in half": ("b.jpg", overwrite("b.jpg", lambda c: c[: len(c) // 2])),
    "PNG cut in half": ("c.png", overwrite("c.png", lambda c: c[: len(c) // 2])),
    "TIFF cut in half": ("d.tif", overwrite("d.tif", lambda c: c[: len(c) // 2])),
    "zero bytes": ("b.jpg", overwrite("b.jpg", lambda c: b"")),
    "text": ("b.jpg", overwrite("b.jpg", lambda c: b"no photograph at all\n" * 9)),
    "missing": ("b.jpg", lambda folder: (folder / "photos" / "b.jpg").unlink()),
    "a folder": (
        "b.jpg",
        lambda folder: ((folder / "photos/b.jpg").unlink(), (folder / "photos/b.jpg").mkdir()),
    ),
    "a link to nowhere": (
        "b.jpg",
        lambda folder: (
            (folder / "photos/b.jpg").unlink(),
            (folder / "photos/b.jpg").symlink_to("nowhere"),
        ),
    ),
    "another size": (
        "b.jpg",
        lambda folder: write_image(folder / "photos/b.jpg", noise((HEIGHT, WIDTH + 1, 3))),
    ),
    "PNG header of 60000x60000": ("c.png", overwrite("c.png", lambda c: png_header(60000, 60000))),
    "JPEG header of 60000x60000": (
        "b.jpg",
        overwrite("b.jpg", lambda c: jpeg_header(60000, 60000)),
    ),
    "TIFF header of 60000x60000": (
        "d.tif",
        overwrite("d.tif", lambda c: tiff_header(60000, 60000)),
    ),
    "corrupt TIFF directory": ("d.tif", overwrite("d.tif", corrupt_tiff_directory)),
    "PNG of the right size without pixels": (
        "c.png",
        overwrite("c.png", lambda c: png_header(WIDTH, HEIGHT)),
    ),
}


@pytest.mark.parametrize("case", DAMAGES)
def test_one_bad_photograph_is_left_out_and_the_others_go_on(folder: Path, case: str) -> None:
    victim, damage = DAMAGES[case]
    damage(folder)
    line = sentence(cut(folder, limit=lambda: limit_memory(1_500_000_000)))
    assert victim in line and "made without 1 of the photographs" in line
    workspace = Workspace(folder / "out")
    good = [name for name in NAMES if name != victim]
    assert [native.name for native in workspace.natives] == good
    expected = {sub.name for native in workspace.natives for sub in native.sub_images}
    assert set(everything(workspace.images)) == expected
    model = pycolmap.Reconstruction(workspace.sparse)
    assert {model.image(i).name for i in model.reg_image_ids()} == expected


def limit_memory(size: int) -> None:
    resource.setrlimit(resource.RLIMIT_DATA, (size, size))


@pytest.mark.parametrize("case", ["JPEG", "TIFF", "TIFF of one tile"])
def test_a_hostile_header_that_its_camera_confirms(folder: Path, case: str) -> None:
    """The model says 60000x60000 too: rows are read until they end, in little memory."""
    name, content = {
        "JPEG": ("a.jpg", jpeg_header(60000, 60000)),
        "TIFF": ("a.tif", tiff_header(60000, 60000)),
        "TIFF of one tile": ("a.tif", tiff_of_one_tile(60000, 60000)),
    }[case]
    (folder / "photos" / name).write_bytes(content)
    wide = pycolmap.Camera(
        model="PINHOLE", width=60000, height=60000, params=[5e4, 5e4, 3e4, 3e4], camera_id=1
    )
    model_of([name], [wide]).write_binary(folder / "sparse")
    line = sentence(cut(folder, limit=lambda: limit_memory(1_000_000_000)))
    assert name in line and "damaged" in line
    assert not list((folder / "out").rglob("*.png")) and not list((folder / "out").rglob("*.jpg"))


def test_files_are_known_by_their_content(folder: Path) -> None:
    shutil.copy(folder / "photos" / "c.png", folder / "photos" / "a.jpg")
    assert cut(folder).returncode == 0
    workspace = Workspace(folder / "out")
    assert {sub.name[-4:] for sub in workspace.native("a.jpg").sub_images} == {".png"}


@pytest.mark.parametrize(
    "name", ["../../escape.jpg", "ABSOLUTE", "..\\escape.jpg", "a/../../b.jpg"]
)
def test_names_that_lead_outside_are_neither_read_nor_written(folder: Path, name: str) -> None:
    outside = folder / "escape.jpg"
    shutil.copy(folder / "photos" / "a.jpg", outside)
    write_model(folder, (str(outside) if name == "ABSOLUTE" else name, "b.jpg"))
    before = outside.read_bytes()
    line = sentence(cut(folder))
    assert "lies outside the folder of the photographs" in line
    assert not (folder / "out").exists()
    assert outside.read_bytes() == before


def test_linked_photographs_are_read_and_never_written(folder: Path) -> None:
    (folder / "elsewhere").mkdir()
    for name in NAMES:
        (folder / "photos" / name).rename(folder / "elsewhere" / name)
    (folder / "photos" / "linked").symlink_to(folder / "elsewhere", target_is_directory=True)
    write_model(folder, tuple(f"linked/{name}" for name in NAMES))
    before = {path: path.read_bytes() for path in (folder / "elsewhere").iterdir()}
    assert cut(folder).returncode == 0
    assert {path: path.read_bytes() for path in (folder / "elsewhere").iterdir()} == before
    assert len(list((folder / "out" / "images" / "linked").iterdir())) == 4 * len(NAMES)


MODEL_DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda content: b"",
    "cut in half": lambda content: content[: len(content) // 2],
    "random": lambda content: bytes(np.random.default_rng(0).bytes(len(content))),
    "a count of 2^60": lambda content: struct.pack("<Q", 2**60) + content[8:],
}


@pytest.mark.parametrize("damage", MODEL_DAMAGES)
@pytest.mark.parametrize("file", ["cameras.bin", "images.bin", "points3D.bin"])
def test_a_damaged_model_is_named_and_nothing_is_written(
    folder: Path, file: str, damage: str
) -> None:
    path = folder / "sparse" / file
    path.write_bytes(MODEL_DAMAGES[damage](path.read_bytes()))
    with pytest.raises(InputError, match=f"^{path} is damaged .*: export the model again$"):
        sirpy.cut(folder / "photos", folder / "sparse", folder / "out", grid=sirpy.Grid(2, 2))
    assert not (folder / "out").exists()


def test_16_bit_stays_16_bit(folder: Path) -> None:
    deep = noise((HEIGHT, WIDTH, 6)).view(np.uint16)
    write_raster(folder / "photos" / "c.png", deep)
    assert cut(folder).returncode == 0
    workspace = Workspace(folder / "out")
    pieces = [read_raster(workspace.image(sub)) for sub in workspace.native("c.png").sub_images]
    assert {piece.dtype for piece in pieces} == {np.dtype(np.uint16)}
    assert max(piece.max() for piece in pieces) > 60000


def test_exif_orientation_is_not_applied_and_not_kept(folder: Path) -> None:
    """Cameras are solved on pixels as they are stored; a kept tag would turn the sub-images."""
    path = folder / "photos" / "a.jpg"
    content = path.read_bytes()
    tag = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 274, 3, 1, 6, 0, 0)
    exif = b"Exif\0\0" + tag
    turned = content[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + content[2:]
    assert cut(folder, output="plain").returncode == 0
    path.write_bytes(turned)
    assert cut(folder, output="turned").returncode == 0
    for name in everything(folder / "plain" / "images"):
        plain = (folder / "plain" / "images" / name).read_bytes()
        assert (folder / "turned" / "images" / name).read_bytes() == plain


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=128k", "tmpfs", str(disk)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("mounting a small disk needs root")
    yield disk
    subprocess.run(["umount", str(disk)], check=True)


def test_a_full_disk_is_said_and_more_space_continues(folder: Path, small_disk: Path) -> None:
    line = sentence(cut(folder, output="disk/out", limit=None))
    assert "No space left on device" in line and "free some space" in line
    assert not [name for name in everything(folder / "disk") if ".tmp" in name]
    kept = {path: path.stat().st_mtime_ns for path in small_disk.rglob("*.png")}
    subprocess.run(["mount", "-o", "remount,size=8m", str(small_disk)], check=True)
    assert cut(folder, output="disk/out").returncode == 0
    assert cut(folder, output="large").returncode == 0
    assert everything(small_disk / "out") == everything(folder / "large")
    assert {path: path.stat().st_mtime_ns for path in kept} == kept


def test_a_file_that_may_not_grow_is_said(folder: Path) -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4000, 4000))

    line = sentence(cut(folder, limit=limit))
    assert "cannot write" in line and "File too large" in line
    left = [path for path in (folder / "out" / "images").rglob("*")]
    assert not [path for path in left if ".tmp" in path.name]
    for path in left:
        read_raster(path)  # what is there is whole


def test_an_unreadable_folder_is_said(folder: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may read everything")
    (folder / "photos").chmod(0)
    line = sentence(cut(folder))
    (folder / "photos").chmod(0o755)
    assert "photos" in line


def test_a_folder_that_is_a_file_is_said(folder: Path) -> None:
    shutil.rmtree(folder / "photos")
    (folder / "photos").write_text("a file")
    assert "there is no folder" in sentence(cut(folder))
    assert not (folder / "out").exists()
