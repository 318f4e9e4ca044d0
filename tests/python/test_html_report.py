"""The report of a small workspace with exact depth maps and a cloud made of them."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import rasterio
from rasterio.io import MemoryFile
from sirpy import html_report, overview, synthetic
from sirpy.errors import InputError
from sirpy.filtering import Reason
from sirpy.native_images import LeftOut, NativeImage, SubImage
from sirpy.pictures import encoded_png
from sirpy.rectangle import Grid, Rectangle
from sirpy.windows import write_map
from sirpy.workspace import Workspace

SIZE = (240, 160)
OVERLAP = 8

pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform")


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """Three synthetic photographs cut 2x2 with overlap; a band of each depth map is missing."""
    scene = synthetic.render_scene(
        tmp_path_factory.mktemp("scene"), image_count=3, size=SIZE, camera_model="PINHOLE"
    )
    workspace = Workspace(tmp_path_factory.mktemp("out"))
    model = pycolmap.Reconstruction(str(scene / "sparse"))
    truth = synthetic.read_truth(scene)
    natives, clouds = [], []
    for image in sorted(model.images.values(), key=lambda image: image.name):
        pixels = read(scene / "images" / image.name)
        depth = truth.depth_map(image.camera, image.cam_from_world())
        depth[100:120] = 0
        natives.append(cut(workspace, image.name, pixels, depth))
        row, column = np.nonzero(depth)
        rays = image.camera.cam_from_img(np.stack([column + 0.5, row + 0.5], axis=1))
        points = image.cam_from_world().inverse() * (
            np.column_stack([rays, np.ones(len(rays))]) * depth[row, column, None]
        )
        clouds.append((points, pixels[row, column]))
    workspace.write_index(natives, [LeftOut("broken.jpg", "it is cut short")])
    workspace.native_model.mkdir()
    model.write_binary(str(workspace.native_model))
    write_cloud(workspace.fused, clouds)
    workspace.run.write_text(json.dumps(example_run(natives)))
    return workspace


def read(path: Path) -> np.ndarray:
    with rasterio.open(path) as file:
        return np.moveaxis(file.read(), 0, -1)


def cut(workspace: Workspace, name: str, pixels: np.ndarray, depth: np.ndarray) -> NativeImage:
    whole = Rectangle(0, 0, *SIZE)
    subs = []
    for row, column, core in Grid(2, 2).cores(*SIZE):
        stored = core.padded(OVERLAP).intersection(whole)
        sub = SubImage(f"{Path(name).stem}_r{row}_c{column}.png", row, column, core, stored)
        rows, columns = stored.slices_in(whole)
        for path in (workspace.image(sub), workspace.depth_map(sub, "geometric")):
            path.parent.mkdir(parents=True, exist_ok=True)
        workspace.image(sub).write_bytes(encoded_png(pixels[rows, columns]))
        header = f"{stored.width}&{stored.height}&1&".encode()
        stored_depth = depth[rows, columns].astype("<f4")
        workspace.depth_map(sub, "geometric").write_bytes(header + stored_depth.tobytes())
        reason = np.where(stored_depth > 0, 0, Reason.INCONSISTENT | Reason.NOT_SEEN)
        write_map(workspace.reason_map(sub), reason.astype(np.float32))
        subs.append(sub)
    return NativeImage(name, *SIZE, tuple(subs))


def write_cloud(path: Path, clouds: list[tuple[np.ndarray, np.ndarray]]) -> None:
    fields = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    fields += [(name, "u1") for name in ("red", "green", "blue")]
    rows = np.zeros(sum(len(points) for points, _ in clouds), fields)
    xyz = np.concatenate([points for points, _ in clouds])
    rgb = np.concatenate([colours for _, colours in clouds])
    rows["x"], rows["y"], rows["z"] = xyz.T
    rows["red"], rows["green"], rows["blue"] = rgb.T
    kinds = {"<f4": "float", "u1": "uchar"}
    header = "".join(f"property {kinds[kind]} {name}\n" for name, kind in fields)
    path.write_bytes(
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{header}"
        "end_header\n".encode()
        + rows.tobytes()
    )


def example_run(natives: list[NativeImage]) -> dict[str, object]:
    stages = [
        ("sparse", len(natives), "photograph", 0.2, 12.0, 20.4, 4e8, 3.1e8),
        ("cut", len(natives), "photograph", 0.1, 3.0, 4.4, 3e8, 2.5e8),
        ("stereo", 12, "sub-image", 0.5, 184.0, 350.7, 8.4e8, 7.9e8),
        ("fuse", 12, "sub-image", 0.3, 9.2, 15.0, 6e8, 4.4e8),
    ]
    return {
        "version": 1,
        "memory": 10**9,
        "stages": [
            {
                "name": name,
                "units": units,
                "unit": unit,
                "wall_s": wall,
                "cpu_s": cpu,
                "predicted_peak": int(predicted),
                "measured_peak": int(measured),
                "reused": name == "cut",
            }
            for name, units, unit, _, wall, cpu, predicted, measured in stages
        ],
        "left_out": [{"name": "broken.jpg", "reason": "it is cut short"}],
        "evaluation": {
            "thresholds": [1, 2],
            "accuracy": [0.7, 0.9],
            "completeness": [0.6, 0.8],
            "f1": [0.646, 0.847],
            "gsd": 0.1,
        },
    }


class Page(HTMLParser):
    """Collects tags that stay open, addresses and words."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.words = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img"):
            self.open.append(tag)
        self.addresses += [value or "" for key, value in attrs if key in ("src", "href")]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.addresses += [value or "" for key, value in attrs if key in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words += data


def test_the_page_is_whole_and_needs_nothing_else(workspace: Workspace) -> None:
    path = html_report.report(workspace)
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert path == workspace.report
    assert page.open == []
    assert len(page.addresses) == 1 + 1 + 2 * 3  # cloud, grid, three pairs
    assert all(address.startswith("data:image/") for address in page.addresses)
    assert "<script" not in text
    assert not re.search(r"https?://|url\(", text)
    for words in ("100,800", f"{1 - 20 / SIZE[1]:.1%}", "3 min 28 s", "790 MB", "1.00 GB"):
        assert words in page.words, words
    for words in ("broken.jpg", "it is cut short", "not seen", "done before", "0.847", "resolve"):
        assert words in page.words, words
    assert text.count("<rect ") == 4  # of the grid


def test_the_cloud_picture_shows_the_ground_from_above(workspace: Workspace) -> None:
    html_report.report(workspace)
    picture = read(workspace.cloud_picture)
    assert max(picture.shape[:2]) > 300
    assert np.mean((picture == [24, 27, 32]).all(axis=2)) < 0.35
    assert 60 < picture.mean() < 160


def test_overviews_are_the_photograph_and_its_depths(workspace: Workspace) -> None:
    """No pixel is missing or doubled where sub-images meet, whatever the decimation."""
    for factor in (1, 2, 3, 7):
        frame = overview.Frame.of_native(workspace.natives[1], -(-SIZE[0] // factor))
        assert frame.factor == factor
        image = overview.photograph(workspace, frame)
        depth = overview.depth_map(workspace, frame)
        assert abs(image.shape[0] - SIZE[1] / factor) < 1
        assert abs(image.shape[1] - SIZE[0] / factor) < 1
        assert depth.shape == image.shape[:2]
        assert image.any(axis=2).all()
        middle = np.arange(depth.shape[0]) * factor + factor // 2
        hole = (middle >= 100) & (middle < 120)
        assert not depth[hole].any()
        assert (depth[~hole] > 0).all()


def test_what_a_run_did_not_make_is_not_on_the_page(workspace: Workspace, tmp_path: Path) -> None:
    bare = Workspace(tmp_path)
    bare.write_index([], [])
    bare.run.write_text(json.dumps({"version": 1, "memory": None}))
    text = html_report.report(bare).read_text(encoding="utf-8")
    assert Page(text).open == []
    assert "Depth maps" not in text
    assert "<h2>" not in text


def test_damage_is_named(workspace: Workspace, tmp_path: Path) -> None:
    bare = Workspace(tmp_path)
    with pytest.raises(InputError, match="is not a sirpy workspace"):
        html_report.report(bare)
    bare.write_index([], [])
    bare.run.write_text("{")
    with pytest.raises(InputError, match=r"run\.json is damaged"):
        html_report.report(bare)
    sub = workspace.natives[0].sub_images[0]
    path = workspace.depth_map(sub, "geometric")
    whole = path.read_bytes()
    path.write_bytes(whole[:-4])
    try:
        with pytest.raises(InputError, match="r0_c0"):
            overview.depth_map(workspace, overview.Frame.of_native(workspace.natives[0], 120))
    finally:
        path.write_bytes(whole)


def test_a_png_survives_its_encoding() -> None:
    image = np.random.default_rng(1).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    with MemoryFile(encoded_png(image)) as memory, memory.open() as file:
        assert np.array_equal(np.moveaxis(file.read(), 0, -1), image)
