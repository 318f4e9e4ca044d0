"""The whole pipeline on a small synthetic scene: quality, determinism, resume, what COLMAP makes of it."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rasterio
from sirpy.area import Area
from sirpy.cloud import POINT
from sirpy.colmap_launcher import installed_colmap
from sirpy.cutting import cut as cut_photographs
from sirpy.dense_stereo import stereo
from sirpy.errors import InputError
from sirpy.filtering import Reason
from sirpy.layout import Region
from sirpy.model_arrays import read_arrays
from sirpy.pipeline import reconstruct
from sirpy.ply import read_vertices
from sirpy.rectangle import Grid, Rectangle
from sirpy.stereo_backend import StereoOptions
from sirpy.synthetic import evaluate
from sirpy.view_selection import views
from sirpy.windows import read_map
from sirpy.workspace import Workspace
from sub_image_scenes import write_image


@pytest.fixture(scope="module")
def whole(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scene reconstructed without cutting, on one thread."""
    output = tmp_path_factory.mktemp("whole") / "out"
    reconstruct(town / "images", output, model=town / "sparse", grid=Grid(1, 1), threads=1)
    return output


@pytest.fixture(scope="module")
def cut(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("cut") / "out"
    # Paths may be strings.
    images, model = str(town / "images"), str(town / "sparse")
    reconstruct(images, str(output), model=model, grid=Grid(2, 2), threads=2)
    return output


def test_cutting_costs_no_quality(town: Path, whole: Path, cut: Path) -> None:
    of_whole = evaluate(town, whole / "fused.ply", thresholds=(2,))
    of_cut = evaluate(town, cut / "fused.ply", thresholds=(2,))
    assert of_whole.accuracy[0] > 0.85 and of_whole.completeness[0] > 0.75
    assert abs(of_whole.completeness[0] - of_cut.completeness[0]) < 0.02
    assert abs(of_whole.accuracy[0] - of_cut.accuracy[0]) < 0.02


def test_products_are_made_of_what_is_there(
    town: Path, cut: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = tmp_path / "out"
    shutil.copytree(cut, output)

    def fails(*_: object, **__: object) -> Path:
        raise InputError("no tile has a surface")

    monkeypatch.setattr("sirpy.mesh.mesh", fails)
    made = reconstruct(
        town / "images",
        output,
        model=town / "sparse",
        grid=Grid(2, 2),
        products=("cloud", "dsm", "mesh", "ortho"),
        model_crs="EPSG:32632",
    )
    # One that fails does not keep the others from being made.
    assert [out.name for out in made.failed] == ["mesh"]
    assert set(made.products) == {"cloud", "dsm", "ortho"}
    with (
        rasterio.open(made.products["dsm"]) as heights,
        rasterio.open(made.products["ortho"]) as photo,
    ):
        assert heights.crs.to_epsg() == photo.crs.to_epsg() == 32632
        assert heights.transform == photo.transform
    assert {"cloud", "dsm", "ortho"} <= {
        stage["name"] for stage in json.loads((output / "run.json").read_text())["stages"]
    }
    assert (output / "report.html").exists()


def test_products_that_cannot_be_are_refused_first(town: Path, tmp_path: Path) -> None:
    for options, said in (({"products": ["dtm"]}, "dtm"), ({"model_crs": "EPSG:4326"}, "4326")):
        with pytest.raises(InputError, match=said):
            reconstruct(town / "images", tmp_path / "out", model=town / "sparse", **options)
        assert not (tmp_path / "out").exists()


def test_overlap_that_reaches_out_of_an_area_has_depth_too(town: Path, tmp_path: Path) -> None:
    model = read_arrays(town / "sparse")
    low, high = (np.percentile(model.points[:, :2], q, axis=0) for q in (48, 52))
    corners = [low, [high[0], low[1]], high, [low[0], high[1]], low]
    workspace = cut_photographs(
        town / "images",
        town / "sparse",
        tmp_path / "out",
        grid=Grid(4, 4),
        overlap=20,
        region=Region(area=Area(((np.array(corners, float),),))),
    )
    views(workspace)
    stereo(workspace)
    for native, sub in workspace.sub_images():
        depth = read_map(workspace.depth_map(sub, "geometric"))
        assert depth.shape == (sub.stored.height, sub.stored.width)
        assert native.covered.contains(sub.stored)


def test_masked_pixels_have_no_depth(town: Path, tmp_path: Path) -> None:
    for path in (town / "images").iterdir():
        mask = np.full((240, 360), 255, np.uint8)
        mask[:, :180] = 0
        write_image(tmp_path / "masks" / f"{path.name}.png", mask)
    made = reconstruct(
        town / "images",
        tmp_path / "out",
        model=town / "sparse",
        grid=Grid(2, 1),
        region=Region(roi=Rectangle(60, 40, 240, 160)),
        masks=tmp_path / "masks",
    )
    for _, sub in made.workspace.sub_images():
        depth = read_map(made.workspace.depth_map(sub, "geometric"))
        reason = read_map(made.workspace.reason_map(sub)).astype(int)
        masked = reason & Reason.MASKED != 0
        known = reason & Reason.NO_SOURCES == 0
        # The lens bends the border of the mask by a pixel or two.
        assert (masked == (known & (sub.column == 0))).mean() > 0.95
        assert not depth[masked].any()
    assert made.points > 500


def test_an_area_alone_is_as_dense_as_in_the_whole(town: Path, cut: Path, tmp_path: Path) -> None:
    everything = read_vertices(cut / "fused.ply")
    low, high = (np.percentile([everything["x"], everything["y"]], q, axis=1) for q in (45, 55))
    corners = [low, [high[0], low[1]], high, [low[0], high[1]], low]
    area = Area(((np.array(corners, float),),))
    # Also without the outermost pixels of the photographs.
    region = Region(roi=Rectangle(10, 10, 330, 210), area=area)
    made = reconstruct(
        town / "images", tmp_path / "out", model=town / "sparse", grid=Grid(4, 3), region=region
    )
    kept = [sub for native in made.workspace.natives for sub in native.sub_images]
    assert 0 < len(kept) < 6 * 12 / 2
    assert made.workspace.report.exists()

    def inside(points: np.ndarray) -> int:
        return int(area.contains(np.column_stack([points["x"], points["y"]])).sum())

    assert inside(read_vertices(made.workspace.fused)) > 0.9 * inside(everything) > 100


def test_every_missing_pixel_has_a_reason(cut: Path) -> None:
    workspace = Workspace(cut)
    for _, sub_image in workspace.sub_images():
        depth = read_map(workspace.depth_map(sub_image, "geometric"))
        reason = read_map(workspace.reason_map(sub_image))
        normal = read_map(workspace.normal_map(sub_image, "geometric"))
        assert ((depth > 0) == (reason == 0)).all()
        assert depth.shape == (sub_image.stored.height, sub_image.stored.width)
        length = np.linalg.norm(normal, axis=0)
        np.testing.assert_allclose(length[depth > 0], 1, atol=1e-5)
        assert (length[depth == 0] == 0).all()


def test_the_cloud_is_binary_with_normals_and_colours(cut: Path) -> None:
    points = read_vertices(cut / "fused.ply")
    assert points.dtype == POINT
    assert ((points["confidence"] > 0) & (points["confidence"] <= 1)).all()
    assert len(points) > 10_000
    assert all(np.isfinite(points[name]).all() for name in ("x", "y", "z", "nx", "ny", "nz"))


def _killed_after(command: list[str], folder: Path, count: int) -> None:
    """Runs the command, and kills it when there are so many maps in a folder."""
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and len(_whole(folder)) < count:
        time.sleep(0.005)
    run.send_signal(signal.SIGKILL)
    run.wait()
    assert len(_whole(folder)) >= count


def _whole(folder: Path) -> dict[Path, int]:
    """The maps below a folder and when they were written."""
    maps = [*folder.rglob("*.bin"), *folder.rglob("*.npy")]
    return {path: path.stat().st_mtime_ns for path in maps if not path.name.startswith(".")}


def test_a_killed_run_goes_on_where_it_was_and_ends_the_same(
    town: Path, cut: Path, tmp_path: Path
) -> None:
    workspace = Workspace(tmp_path / "out")
    command = [sys.executable, "-m", "sirpy", "reconstruct", str(town / "images")]
    command += ["--output", str(workspace.folder), "--model", str(town / "sparse")]
    command += ["--columns", "2", "--rows", "2", "--threads", "1", "--quiet"]
    depth_maps = workspace.stereo_folder("depth_maps")

    _killed_after(command, workspace.passes / "level2.photometric", 2)
    coarse = _whole(workspace.stereo)
    assert not _whole(depth_maps)
    _killed_after(command, depth_maps, 3)
    finished = _whole(depth_maps)
    assert coarse.items() <= _whole(workspace.stereo).items()
    assert not workspace.fused.exists()

    again = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert again.returncode == 0, again.stderr
    assert finished.items() <= _whole(depth_maps).items()
    assert not workspace.passes.exists()
    assert workspace.fused.read_bytes() == (cut / "fused.ply").read_bytes()
    assert not list(workspace.folder.rglob("*.tmp*"))


def test_other_options_do_the_stage_again(town: Path, tmp_path: Path) -> None:
    output = tmp_path / "out"
    more = StereoOptions(geometric_iterations=2)
    arguments = {"model": town / "sparse", "grid": Grid(1, 1), "num_sources": 2}
    reconstruct(town / "images", output, stereo_options=more, **arguments)
    first = (output / "fused.ply").read_bytes()
    reconstruct(town / "images", output, stereo_options=StereoOptions(), **arguments)
    assert (output / "fused.ply").read_bytes() != first


def test_pycolmap_fuses_the_workspace(town: Path, cut: Path, tmp_path: Path) -> None:
    # In a process of its own: an abort inside COLMAP must not end the tests.
    cloud = tmp_path / "colmap.ply"
    code = (
        "import sys, pycolmap;"
        "pycolmap.stereo_fusion(sys.argv[1], sys.argv[2], workspace_format='COLMAP',"
        "input_type='geometric', output_type='PLY')"
    )
    subprocess.run([sys.executable, "-c", code, str(cloud), str(cut)], check=True, timeout=120)
    assert evaluate(town, cloud, thresholds=(5,)).accuracy[0] > 0.8


COLMAP = installed_colmap(os.environ.get("PATH", os.defpath))


@pytest.mark.skipif(COLMAP is None, reason="no COLMAP program is installed")
def test_the_installed_colmap_fuses_the_workspace(town: Path, cut: Path, tmp_path: Path) -> None:
    workspace = tmp_path / "copy"
    shutil.copytree(cut, workspace)
    cloud = tmp_path / "colmap.ply"
    command = [str(COLMAP), "stereo_fusion", "--workspace_path", str(workspace)]
    command += ["--input_type", "geometric", "--output_path", str(cloud)]
    subprocess.run(command, check=True, timeout=120, capture_output=True)
    assert evaluate(town, cloud, thresholds=(5,)).accuracy[0] > 0.8
