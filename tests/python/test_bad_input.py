"""A user's mistake: one sentence that says what and how to mend it, exit status 2, nothing half-written."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest


def _reconstruct(images: Path, output: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "sirpy", "reconstruct", str(images), "--output", str(output)]
    return subprocess.run(
        [*command, "--quiet", *options], capture_output=True, text=True, timeout=300
    )


def _assert_refused(run: subprocess.CompletedProcess[str], output: Path, *words: str) -> None:
    assert run.returncode == 2, run.stderr
    lines = run.stderr.strip().splitlines()
    assert len(lines) == 1, run.stderr
    assert lines[0].startswith("sirpy: ")
    for word in words:
        assert word in lines[0]
    assert not output.exists() or not any(output.iterdir())


@pytest.fixture
def output(tmp_path: Path) -> Path:
    return tmp_path / "out"


def test_missing_folder(tmp_path: Path, output: Path) -> None:
    _assert_refused(_reconstruct(tmp_path / "nowhere", output), output, "nowhere")


def test_no_images(tmp_path: Path, output: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "notes.txt").write_text("no photograph")
    _assert_refused(_reconstruct(tmp_path / "empty", output), output, "empty")


def test_missing_model(town: Path, tmp_path: Path, output: Path) -> None:
    run = _reconstruct(town / "images", output, "--model", str(tmp_path / "none"))
    _assert_refused(run, output, "none")


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
@pytest.mark.parametrize("damage", ["empty", "random", "half", "huge"])
def test_corrupt_model(town: Path, tmp_path: Path, output: Path, name: str, damage: str) -> None:
    model = tmp_path / "sparse"
    shutil.copytree(town / "sparse", model)
    content = (model / name).read_bytes()
    (model / name).write_bytes(
        {
            "empty": b"",
            "random": bytes(range(7, 251)) * 9,
            "half": content[: len(content) // 2],
            "huge": (2**60).to_bytes(8, "little") + content[8:],
        }[damage]
    )
    run = _reconstruct(town / "images", output, "--model", str(model))
    _assert_refused(run, output, str(model))


def test_grid_larger_than_the_image(town: Path, output: Path) -> None:
    options = ("--model", str(town / "sparse"), "--columns", "4000", "--rows", "2")
    _assert_refused(_reconstruct(town / "images", output, *options), output, "4000x2")


def test_columns_without_rows(town: Path, output: Path) -> None:
    run = _reconstruct(town / "images", output, "--model", str(town / "sparse"), "--columns", "2")
    _assert_refused(run, output, "--rows")


def test_budget_that_no_plan_meets(town: Path, output: Path) -> None:
    run = _reconstruct(town / "images", output, "--model", str(town / "sparse"), "--memory", "50MB")
    _assert_refused(run, output, "0.05 GB", "least that would do")


def test_output_that_cannot_be_written(town: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    output = tmp_path / "file" / "out"
    run = _reconstruct(town / "images", output, "--model", str(town / "sparse"))
    assert run.returncode == 2
    assert "cannot be written" in run.stderr and len(run.stderr.strip().splitlines()) == 1
    assert (tmp_path / "file").read_text() == "in the way"


def test_images_of_another_size_than_their_camera(town: Path, tmp_path: Path, output: Path) -> None:
    from sirpy.synthetic import render_scene

    other = render_scene(tmp_path / "other", image_count=2, size=(120, 90))
    images = tmp_path / "images"
    shutil.copytree(town / "images", images)
    names = sorted(path.name for path in images.iterdir())
    for name in names:
        shutil.copy(next(iter(sorted((other / "images").iterdir()))), images / name)
    run = _reconstruct(images, output, "--model", str(town / "sparse"))
    _assert_refused(run, output, names[0], "120x90", "360x240")


def test_truncated_photograph_is_left_out_and_reported(
    town: Path, tmp_path: Path, output: Path
) -> None:
    images = tmp_path / "images"
    shutil.copytree(town / "images", images)
    victim = sorted(images.iterdir())[2]
    victim.write_bytes(victim.read_bytes()[: victim.stat().st_size // 2])
    options = ("--model", str(town / "sparse"), "--columns", "1", "--rows", "1")
    run = _reconstruct(images, output, *options)
    assert run.returncode == 2
    lines = run.stderr.strip().splitlines()
    assert len(lines) == 1 and victim.name in lines[0]
    assert (output / "fused.ply").exists()
    assert victim.name in (output / "report.html").read_text()
    assert not list((output / "images").glob(f"{victim.stem}_*"))


def test_photographs_and_output_in_one_folder(town: Path, tmp_path: Path) -> None:
    images = tmp_path / "images"
    shutil.copytree(town / "images", images)
    run = _reconstruct(images, images)
    assert run.returncode == 2 and "--output" in run.stderr
    assert sorted(path.name for path in images.iterdir()) == sorted(
        path.name for path in (town / "images").iterdir()
    )


@pytest.mark.parametrize("stage", ["views", "stereo", "fuse", "report"])
def test_a_stage_on_a_folder_that_is_no_workspace(tmp_path: Path, stage: str) -> None:
    folder = tmp_path / "nowhere"
    command = [sys.executable, "-m", "sirpy", stage, str(folder)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60)
    _assert_refused(run, folder, "nowhere")
    assert not folder.exists()


def test_an_option_out_of_range_writes_nothing(town: Path, output: Path) -> None:
    model = ("--model", str(town / "sparse"))
    for option, words in (
        (("--num-sources", "0"), "--num-sources 0 is not possible"),
        (("--threads", "-2"), "threads = -2 is not possible"),
    ):
        _assert_refused(_reconstruct(town / "images", output, *model, *option), output, words)


def test_a_workspace_below_the_photographs_holds_no_photographs(town: Path, tmp_path: Path) -> None:
    from sirpy.photographs import find_photographs

    images = tmp_path / "images"
    shutil.copytree(town / "images", images)
    before = find_photographs(images)
    (images / "out" / "images").mkdir(parents=True)
    (images / "out" / "stages.json").write_text("{}")
    shutil.copy(images / before[0], images / "out" / "images")
    assert find_photographs(images) == before
