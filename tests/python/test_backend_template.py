"""The template of a backend (docs/backend-template): installed by pip, found by its name, and right."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray
from sirpy.cut_tasks import PixelOptions
from sirpy.cutting import cut
from sirpy.rectangle import Grid
from sirpy.synthetic import read_truth, render_scene
from sirpy.view_selection import views
from sirpy.windows import read_map
from sirpy.workspace import Workspace

TEMPLATE = Path(__file__).parents[2] / "docs" / "backend-template"
needs_torch = pytest.mark.skipif(
    importlib.util.find_spec("torch") is None, reason="torch is not installed"
)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that pip has installed the template into."""
    folder = tmp_path_factory.mktemp("installed")
    copy = shutil.copytree(TEMPLATE, tmp_path_factory.mktemp("copy") / TEMPLATE.name)
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    command += ["--no-build-isolation", "--target", str(folder), str(copy)]
    subprocess.run(command, check=True, timeout=120)
    return folder


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scene")
    return render_scene(folder, image_count=4, size=(280, 200), camera_model="PINHOLE", seed=3)


def run(installed: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join(filter(None, [str(installed), os.environ.get("PYTHONPATH")]))
    return subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=120,
    )


def workspace_of(scene: Path, output: Path, grid: Grid) -> Workspace:
    workspace = cut(
        scene / "images",
        scene / "sparse",
        output,
        grid=grid,
        pixels=PixelOptions(format="png"),  # JPEG compresses other sub-images to other pixels
    )
    views(workspace, num_sources=3)
    return workspace


def depth_maps(workspace: Workspace) -> dict[str, NDArray[np.float32]]:
    """Of each native image, put together of its sub-images."""
    maps = {}
    for native in workspace.natives:
        whole = np.empty((native.height, native.width), np.float32)
        for sub in native.sub_images:
            depth = read_map(workspace.depth_map(sub, "geometric"))
            whole[sub.stored.slices_in(native.rectangle)] = depth
        maps[native.name] = whole
    return maps


@needs_torch
def test_a_plane_sweep_finds_the_town_whatever_the_grid(
    installed: Path, scene: Path, tmp_path: Path
) -> None:
    found = []
    for grid in (Grid(1, 1), Grid(2, 2)):
        workspace = workspace_of(scene, tmp_path / str(grid), grid)
        command = ["-m", "sirpy", "stereo", str(workspace.folder), "--stereo", "plane_sweep"]
        made = run(installed, *command, "--device", "cpu", "--threads", "1")
        assert made.returncode == 0, made.stderr
        found.append(depth_maps(workspace))
    whole, cut_up = found
    truth, model = read_truth(scene), pycolmap.Reconstruction(workspace.native_model)
    kept = np.concatenate([depth.ravel() > 0 for depth in whole.values()])
    assert kept.mean() > 0.45
    for image in model.images.values():
        depth, camera = whole[image.name], model.cameras[image.camera_id]
        exact = truth.depth_map(camera, image.cam_from_world())
        error = np.abs(depth - exact)[depth > 0] / exact[depth > 0]
        assert (error < 0.01).mean() > 0.97
        # Its margin is its patch, which the halo holds: what is left is the rounding of other windows.
        other = cut_up[image.name]
        assert ((depth > 0) == (other > 0)).mean() > 0.999
        assert (np.abs(depth - other) <= 1e-3 * depth).mean() > 0.999


def test_without_torch_it_says_what_to_install(
    installed: Path, scene: Path, tmp_path: Path
) -> None:
    workspace = workspace_of(scene, tmp_path, Grid(1, 1))
    without = "import sys; sys.modules['torch'] = None; from sirpy.cli import main; main()"
    made = run(installed, "-c", without, "stereo", str(workspace.folder), "--stereo", "plane_sweep")
    assert made.returncode == 2
    said = "the stereo backend plane_sweep needs torch: pip install 'sirpy[learned]'"
    assert " ".join(made.stderr.split()) == f"sirpy: {said}"
