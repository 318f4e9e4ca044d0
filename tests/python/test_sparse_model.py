"""Structure from motion on a scene with exact cameras."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from bumpy_ground import FOCAL, HEIGHT, WIDTH, camera_centres, write_jpeg, write_photographs
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from sirpy.errors import BudgetError, InputError
from sirpy.model_files import model_identity, read_model
from sirpy.progress import Progress, Steps
from sirpy.sfm_options import SfmOptions
from sirpy.sparse_model import SparseResult, predicted_peak, sparse
from sirpy.workspace import Workspace

SMALL = SfmOptions(max_image_size=400)
NAMES = ["a flight/1.jpg", "a flight/2.jpg", "a flight/3.jpg", "a flight/4.jpg"]


class Recorder(Progress):
    """Remembers the stages with their totals and steps, and the notes."""

    def __init__(self) -> None:
        self.stages: dict[str, list[int]] = {}
        self.notes: list[str] = []

    @contextmanager
    def stage(self, name: str, total: int, unit: str) -> Iterator[Steps]:
        counts = self.stages[name] = [total, 0]

        class Counting(Steps):
            def advance(self, steps: int = 1) -> None:
                counts[1] += steps

        yield Counting()

    def note(self, text: str) -> None:
        self.notes.append(text)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four good photographs, one that was cut in half, one of something else."""
    folder = tmp_path_factory.mktemp("photographs")
    write_photographs(folder, NAMES)
    whole = (folder / NAMES[0]).read_bytes()
    (folder / "cut.jpg").write_bytes(whole[: len(whole) // 2])
    other = folder / "a flight" / "other.jpg"
    noise = np.random.default_rng(1).standard_normal((HEIGHT, WIDTH))
    write_jpeg(other, np.clip(128 + 300 * gaussian_filter(noise, 3), 0, 255).astype(np.uint8))
    return folder


@pytest.fixture(scope="module")
def recorder() -> Recorder:
    return Recorder()


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("output")


@pytest.fixture(scope="module")
def result(photographs: Path, output: Path, recorder: Recorder) -> SparseResult:
    return sparse(photographs, output, options=SMALL, threads=2, progress=recorder)


def similarity_residuals(
    source: NDArray[np.float64], target: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances of the points after the best similarity (Umeyama 1991); n x 3 each."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    u, singular, vt = np.linalg.svd(b.T @ a)
    signs = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = (singular * signs).sum() / (a**2).sum()
    return np.asarray(np.linalg.norm(b - scale * a @ (u @ np.diag(signs) @ vt).T, axis=1))


def test_the_cameras_are_those_of_the_scene(result: SparseResult) -> None:
    model = read_model(result.model)
    images = {model.image(i).name: model.image(i) for i in model.reg_image_ids()}
    assert sorted(images) == NAMES
    centres = np.array([images[name].projection_center() for name in NAMES])
    # The strip is 5 units long and the ground 10 away; a decimated pixel sees 2 hundredths of a
    # unit.
    assert similarity_residuals(centres, camera_centres(len(NAMES))).max() < 0.03
    (camera,) = model.cameras.values()  # one lens, one camera
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)
    assert camera.mean_focal_length() == pytest.approx(FOCAL, rel=0.05)


def test_observations_are_in_native_pixels(result: SparseResult) -> None:
    model = read_model(result.model)
    residuals = [
        np.linalg.norm(image.project_point(model.point3D(point.point3D_id).xyz) - point.xy)
        for image in model.images.values()
        for point in image.points2D
        if point.has_point3D()
    ]
    assert len(residuals) > 500
    assert np.median(residuals) < 0.5
    furthest = max(point.xy[0] for image in model.images.values() for point in image.points2D)
    assert 400 < furthest < WIDTH


def test_photographs_that_cannot_be_used_are_reported(
    result: SparseResult, recorder: Recorder
) -> None:
    reasons = {out.name: out.reason for out in result.left_out}
    assert sorted(reasons) == ["a flight/other.jpg", "cut.jpg"]
    assert "oriented" in reasons["a flight/other.jpg"]
    assert result.components == [NAMES]
    for name in reasons:
        assert any(note.startswith(f"{name} is left out") for note in recorder.notes)


def test_progress_ends_at_its_totals(result: SparseResult, recorder: Recorder) -> None:
    assert recorder.stages["decimating"] == [6, 6]
    assert recorder.stages["finding features"] == [5, 5]
    assert recorder.stages["matching"] == [10, 10]
    total, done = recorder.stages["orienting"]
    assert total == 5 and 2 <= done <= 5


def test_the_same_again_is_not_computed_again(
    result: SparseResult, photographs: Path, output: Path
) -> None:
    before = {path: path.stat().st_mtime_ns for path in Workspace(output).sfm.rglob("*")}
    again = sparse(photographs, output, options=SMALL, threads=1)
    assert again == result
    assert {path: path.stat().st_mtime_ns for path in Workspace(output).sfm.rglob("*")} == before


def test_killed_with_its_caller_and_continued_to_the_same_model(
    result: SparseResult, photographs: Path, tmp_path: Path
) -> None:
    program = (
        "import sys; from pathlib import Path; from sirpy.sparse_model import sparse; "
        "from sirpy.sfm_options import SfmOptions; "
        "sparse(Path(sys.argv[1]), Path(sys.argv[2]), options=SfmOptions(max_image_size=400))"
    )
    caller = subprocess.Popen([sys.executable, "-c", program, str(photographs), str(tmp_path)])
    workspace = Workspace(tmp_path)
    deadline = time.monotonic() + 60
    while not workspace.sfm_database.is_file() and time.monotonic() < deadline:
        time.sleep(0.01)
    caller.kill()
    caller.wait()
    while _users_of(workspace.sfm_task) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not _users_of(workspace.sfm_task)
    # Other threads and memory too: neither shows in the model.
    continued = sparse(photographs, tmp_path, options=SMALL, threads=1, memory=4_000_000_000)
    assert model_identity(continued.model) == model_identity(result.model)


def _users_of(task: Path) -> list[int]:
    """Processes that were started with this task."""
    users = []
    for entry in Path("/proc").iterdir():
        try:
            arguments = (
                (entry / "cmdline").read_bytes().split(b"\0") if entry.name.isdigit() else []
            )
        except OSError:
            continue  # it has ended meanwhile
        if os.fsencode(task) in arguments:
            users.append(int(entry.name))
    return users


def test_an_abort_of_the_child_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_photographs(tmp_path / "in", ["1.jpg", "2.jpg"])
    killer = tmp_path / "killer"
    killer.write_text(f"#!/bin/sh\nkill -{int(signal.SIGABRT)} $$\n")
    killer.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(killer))
    with pytest.raises(InputError, match=r"SIGABRT: .*log\.txt says why"):
        sparse(tmp_path / "in", tmp_path / "out", options=SMALL)


def test_one_photograph_is_not_enough(tmp_path: Path) -> None:
    write_photographs(tmp_path / "in", ["only.jpg"])
    with pytest.raises(InputError, match="at least two"):
        sparse(tmp_path / "in", tmp_path / "out")


def test_a_budget_that_cannot_do_says_what_can(photographs: Path, tmp_path: Path) -> None:
    with pytest.raises(BudgetError, match=r"needs 0\.\d\d GB"):
        sparse(photographs, tmp_path, options=SMALL, memory=100_000_000)


def test_predicted_peak_grows_with_threads_and_never_with_native_size_alone() -> None:
    assert predicted_peak(3072, 2048, 11, 2) > predicted_peak(3072, 2048, 11, 1)
    assert predicted_peak(3072, 2048, 11, 2) == predicted_peak(6144, 4096, 11, 2)
    assert predicted_peak(4000, 3000, 5, 2) < 4e9
