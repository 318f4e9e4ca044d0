"""The folder of PMVS, read by the rules of its option, camera and vis.dat readers."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from engine_scenes import (
    assert_numbered_images_are,
    cut_town,
    expected_pixels,
    write_plane_maps,
)
from sirpy.colmap_launcher import installed_colmap
from sirpy.errors import InputError
from sirpy.ply import read_vertices
from sirpy.pmvs import write_pmvs
from sirpy.workspace import Workspace

COLMAP = installed_colmap(os.environ.get("PATH", os.defpath))
KNOWN = {
    *("level", "csize", "threshold", "wsize", "minImageNum", "CPU", "setEdge", "useBound"),
    *("useVisData", "sequence", "maxAngle", "quad"),
}


def read_options(path: Path) -> tuple[dict[str, float], list[int], list[int]]:
    """The options, timages and oimages, word by word as PMVS takes them."""
    words = iter(path.read_text().split())
    options: dict[str, float] = {}
    images: dict[str, list[int]] = {}
    for word in words:
        if word in ("timages", "oimages"):
            images[word] = [int(next(words)) for _ in range(int(next(words)))]
        else:
            assert word in KNOWN
            options[word] = float(next(words))
    return options, images["timages"], images["oimages"]


def read_visibility(path: Path) -> list[set[int]]:
    words = iter(path.read_text().split())
    assert next(words) == "VISDATA"
    seen = []
    for index in range(int(next(words))):
        assert int(next(words)) == index
        seen.append({int(next(words)) for _ in range(int(next(words)))})
    assert next(words, None) is None
    return seen


@pytest.fixture(scope="module")
def workspace(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    made = cut_town(town, tmp_path_factory.mktemp("pmvs") / "out")
    names = [sub.name for _, sub in made.sub_images()]
    write_pmvs(made, clusters=[names[:4], names[9:2:-2]])
    return made


def test_projection_matrices_are_of_whole_number_pixel_centres(workspace: Workspace) -> None:
    for number, (world, pixels) in enumerate(expected_pixels(workspace)):
        words = (workspace.folder / "pmvs" / "txt" / f"{number:08}.txt").read_text().split()
        assert words[0] == "CONTOUR"
        projection = np.array(words[1:], float).reshape(3, 4)
        seen = np.column_stack([world, np.ones(len(world))]) @ projection.T
        np.testing.assert_allclose(seen[:, :2] / seen[:, 2:] + 0.5, pixels, atol=1e-6)
        # COLMAP's decomposition and PMVS's depths take the third row for a unit vector.
        np.testing.assert_allclose(np.linalg.norm(projection[2, :3]), 1)


def test_images_have_their_numbers(workspace: Workspace) -> None:
    folder = workspace.folder / "pmvs" / "visualize"
    assert_numbered_images_are(workspace, [folder / f"{number:08}.jpg" for number in range(36)])
    assert len(list(folder.iterdir())) == 36
    assert (workspace.folder / "pmvs" / "models").is_dir()
    assert not (workspace.folder / "pmvs" / "bundle.rd.out").exists()


def test_masks_are_binary_pgm_where_there_are_some(town: Path, tmp_path: Path) -> None:
    name = min(path.name for path in (town / "images").iterdir())
    width, height = pycolmap.Bitmap.read(town / "images" / name, True).to_array().shape[1::-1]
    mask = np.full((height, width), 255, np.uint8)
    mask[:, : width // 2] = 0
    (tmp_path / "masks").mkdir()
    assert pycolmap.Bitmap.from_array(mask).write(tmp_path / "masks" / f"{name}.png")
    made = cut_town(town, tmp_path / "out", masks=tmp_path / "masks")
    write_pmvs(made)
    masks = sorted((made.folder / "pmvs" / "masks").iterdir())
    assert [path.name for path in masks] == [f"{number:08}.pgm" for number in range(6)]
    for path, sub in zip(masks, made.natives[0].sub_images, strict=True):
        magic, size, white, pixels = path.read_bytes().split(b"\n", 3)
        assert (magic, white) == (b"P5", b"255")
        assert size == f"{sub.stored.width} {sub.stored.height}".encode()
        seen = np.frombuffer(pixels, np.uint8).reshape(sub.stored.height, sub.stored.width)
        written = np.asarray(pycolmap.Bitmap.read(made.mask(sub), False).to_array())
        np.testing.assert_array_equal(seen, written.reshape(seen.shape))


def test_visibility_is_symmetric_and_between_photographs(workspace: Workspace) -> None:
    seen = read_visibility(workspace.folder / "pmvs" / "vis.dat")
    photograph = [native.name for native, _ in workspace.sub_images()]
    assert len(seen) == 36 and all(seen)
    for number, others in enumerate(seen):
        assert all(number in seen[other] for other in others)
        assert all(photograph[other] != photograph[number] for other in others)


def test_options_are_of_full_resolution_and_of_each_cluster(workspace: Workspace) -> None:
    folder = workspace.folder / "pmvs"
    options, timages, oimages = read_options(folder / "option-all")
    assert (options["level"], options["useVisData"]) == (0, 1)
    assert (timages, oimages) == (list(range(36)), [])
    assert read_options(folder / "option-0000")[1] == [0, 1, 2, 3]
    assert read_options(folder / "option-0001")[1] == [3, 5, 7, 9]


def _runs_of(workspace: Workspace, tmp_path: Path) -> list[str]:
    fake = tmp_path / "fake pmvs"
    fake.write_text('#!/bin/sh\necho "$1|$2"\n')
    fake.chmod(0o755)
    done = subprocess.run(
        [workspace.folder / "run-pmvs.sh"],
        cwd="/",
        env={**os.environ, "PMVS2": str(fake)},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    return done.stdout.splitlines()


def test_the_script_runs_the_clusters_or_everything(workspace: Workspace, tmp_path: Path) -> None:
    prefix = f"{workspace.folder}/pmvs/"
    assert _runs_of(workspace, tmp_path) == [f"{prefix}|option-0000", f"{prefix}|option-0001"]
    write_pmvs(workspace)
    assert _runs_of(workspace, tmp_path) == [f"{prefix}|option-all"]


def test_a_cluster_of_other_names_is_refused(workspace: Workspace) -> None:
    with pytest.raises(InputError, match=r"a cluster lists 'x\.jpg', which is no sub-image"):
        write_pmvs(workspace, clusters=[["x.jpg"]])


@pytest.mark.skipif(COLMAP is None, reason="no COLMAP is installed")
def test_colmap_fuses_it_with_every_principal_point_in_its_place(
    town: Path, tmp_path: Path
) -> None:
    made = cut_town(town, tmp_path / "out")
    write_pmvs(made, copy_policy="copy")
    folder = made.folder / "pmvs"
    stereo = folder / "stereo-option-all"
    names = [f"{number:08}.jpg" for number in range(36)]
    write_plane_maps(made, stereo, names)
    (stereo / "fusion.cfg").write_text("\n".join(names) + "\n")
    command = [str(COLMAP), "stereo_fusion", "--workspace_path", folder]
    command += ["--workspace_format", "PMVS", "--output_path", tmp_path / "cloud.ply"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    points = read_vertices(tmp_path / "cloud.ply")
    assert len(points) > 20_000
    np.testing.assert_allclose(points["z"], 0, atol=1e-3)
