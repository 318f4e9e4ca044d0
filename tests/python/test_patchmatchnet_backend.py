"""PatchmatchNet from the command line to the cloud, on a small scene."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from PIL import Image
from sirpy.cutting import cut
from sirpy.dense_stereo import stereo
from sirpy.errors import InputError
from sirpy.layout import Region
from sirpy.rectangle import Grid, Rectangle
from sirpy.stereo_backend import DepthMap, Setup, StereoOptions, View, make_backends
from sirpy.stereo_passes import write_planes
from sirpy.synthetic import read_truth
from sirpy.view_selection import views
from sirpy.windows import read_map
from sirpy.workspace import Workspace
from tele_scene import wide_and_tele

torch = pytest.importorskip("torch", reason="torch, of the extra `learned`, is not installed")

from engine_scenes import cut_town  # noqa: E402
from sirpy.mvsnet import SIZE_MULTIPLE, write_mvsnet  # noqa: E402
from sirpy.patchmatchnet import PatchmatchNet  # noqa: E402
from sirpy.patchmatchnet.windows import FeatureStore  # noqa: E402
from sirpy.pipeline import reconstruct  # noqa: E402
from test_mvsnet import read_camera, read_pairs  # noqa: E402

WEIGHTS = Path(__file__).parents[3] / "shared" / "weights"
needs_weights = pytest.mark.skipif(
    not WEIGHTS.exists(), reason="the weights of PatchmatchNet are not beside the checkout"
)
OPTIONS = StereoOptions(backend="patchmatchnet")


@pytest.fixture
def random_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    torch.manual_seed(1)
    path = tmp_path / "random.ckpt"
    torch.save({"model": {f"module.{k}": v for k, v in PatchmatchNet().state_dict().items()}}, path)
    monkeypatch.setattr("sirpy.patchmatchnet.backend.weights_file", lambda name: path)


def run(town: Path, output: Path, threads: int = 2) -> Workspace:
    options = StereoOptions(backend="patchmatchnet", threads=threads)
    return reconstruct(
        town / "images",
        output,
        model=town / "sparse",
        grid=Grid(2, 1),
        stereo_options=options,
        threads=threads,
    ).workspace


def test_threads_and_a_second_run_change_nothing(
    town: Path, tmp_path: Path, random_weights: None
) -> None:
    one, other = run(town, tmp_path / "1", threads=1), run(town, tmp_path / "3", threads=3)
    files = [path for _, sub in one.sub_images() for path in one.stereo_maps(sub)]
    assert len(files) == 12 * 6 and not one.passes.exists()
    for path in files:
        assert path.read_bytes() == (other.folder / path.relative_to(one.folder)).read_bytes()
    written = {path: path.stat().st_mtime_ns for path in files}
    run(town, one.folder)
    assert written == {path: path.stat().st_mtime_ns for path in files}
    # What is lost is made again, the same.
    lost = files[3]
    before = lost.read_bytes()
    lost.unlink()
    run(town, one.folder)
    assert lost.read_bytes() == before
    noted = json.loads(one.run.read_text())
    assert noted["stereo"] == "patchmatchnet"
    assert any(
        "PatchmatchNet, cpu: 0 of 12" in note or "11 of 12" in note for note in noted["notes"]
    )


def test_a_region_of_any_corner_with_a_finer_source_reads_no_more_than_there_is(
    tmp_path: Path, random_weights: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The source is read at level 1, where the region begins inside a pixel."""
    scene = wide_and_tele(tmp_path / "scene")
    kept: list[float] = []

    def recorded(path: Path, found: DepthMap, *more: Any) -> None:
        kept.extend(found.depth.ravel())
        write_planes(path, found, *more)

    monkeypatch.setattr("sirpy.dense_stereo.write_planes", recorded)
    empty, read = torch.empty, FeatureStore.read

    def filled(store: FeatureStore, view: View, stage: int) -> Any:
        with monkeypatch.context() as patch:
            patch.setattr(torch, "empty", lambda *a, **k: empty(*a, **k).fill_(float("nan")))
            features = read(store, view, stage)
        assert features.isfinite().all()  # all of it was found before
        return features

    monkeypatch.setattr(FeatureStore, "read", filled)
    workspace = cut(
        scene / "images",
        scene / "sparse",
        tmp_path / "out",
        grid=Grid(2, 1),
        region=Region(roi=Rectangle(31, 31, 200, 140)),
    )
    found = views(workspace, num_sources=2)
    assert [source.level for source in found.fields["wide.png"].sources] == [1]
    stereo(workspace, options=OPTIONS)
    assert len(kept) > 2 * 200 * 140 and np.isfinite(kept).all()


@needs_weights
def test_depths_are_right(town: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SIRPY_WEIGHTS", str(WEIGHTS))
    workspace = run(town, tmp_path / "out")
    truth = read_truth(town)
    model = pycolmap.Reconstruction(str(workspace.native_model))
    images = {image.name: image for image in model.images.values()}
    errors = []
    for native, sub in workspace.sub_images():
        image = images[native.name]
        depth = read_map(workspace.depth_map(sub, "geometric"))
        expected = truth.depth_map(image.camera, image.cam_from_world())
        expected = expected[sub.stored.slices_in(native.rectangle)]
        both = (depth > 0) & (expected > 0)
        errors.append(np.abs(depth / np.where(both, expected, 1) - 1)[both])
    found = np.concatenate(errors)
    assert len(found) > 100_000
    # Of photographs of 360 pixels; a wrong half pixel or transform is far beyond.
    assert np.median(found) < 0.008 and (found < 0.02).mean() > 0.8


@needs_weights
def test_the_network_as_published_reads_the_mvsnet_folder(town: Path, tmp_path: Path) -> None:
    """As its own reader does: by number, whole images, one depth range."""
    workspace = cut_town(town, tmp_path / "out", same_size=SIZE_MULTIPLE)
    write_mvsnet(workspace, most_sources=4)
    net = PatchmatchNet.from_checkpoint(WEIGHTS / "params_000007.ckpt")
    truth = read_truth(town)
    model = pycolmap.Reconstruction(str(workspace.native_model))
    images = {image.name: image for image in model.images.values()}
    subs = list(workspace.sub_images())
    errors = []
    for reference, sources in read_pairs(workspace.folder / "pair.txt")[::6]:
        views = [reference, *sources]
        cameras = [read_camera(workspace.folder / "cams" / f"{v:08}_cam.txt") for v in views]
        pixels = [np.array(Image.open(workspace.images / f"{v:08}.jpg")) for v in views]
        found = net(
            [torch.from_numpy(one).permute(2, 0, 1) for one in pixels],
            torch.from_numpy(np.stack([one.intrinsics for one in cameras])),
            torch.from_numpy(np.stack([one.extrinsics for one in cameras])),
            *cameras[0].depths,
        )
        native, sub = subs[reference]
        image = images[native.name]
        expected = truth.depth_map(image.camera, image.cam_from_world())
        expected = expected[sub.stored.slices_in(native.rectangle)]
        seen = expected > 0
        errors.append(np.abs(found.depth.numpy() / np.where(seen, expected, 1) - 1)[seen])
    assert np.median(np.concatenate(errors)) < 0.02


def test_what_is_missing_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SIRPY_WEIGHTS", str(tmp_path))
    with pytest.raises(InputError, match="sirpy weights download patchmatchnet"):
        make_backends(Setup(2, OPTIONS, None))
    if not torch.cuda.is_available():
        with pytest.raises(InputError, match="--device cuda: torch sees no GPU"):
            make_backends(Setup(2, StereoOptions(backend="patchmatchnet", device="cuda"), None))


def test_without_torch_it_says_what_to_install(town: Path, tmp_path: Path) -> None:
    program = "import sys; sys.modules['torch'] = None; from sirpy.cli import main; main()"
    arguments = ["reconstruct", str(town / "images"), "-o", str(tmp_path / "out")]
    found = subprocess.run(
        [sys.executable, "-c", program, *arguments, "--stereo", "patchmatchnet"],
        capture_output=True,
        text=True,
        env=os.environ,
    )
    assert found.returncode == 2
    assert "needs torch: pip install 'sirpy[learned]'" in found.stderr.replace("\n", " ")
    assert not (tmp_path / "out").exists()
