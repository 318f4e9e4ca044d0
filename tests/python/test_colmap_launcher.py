"""`colmap` hands every command but ours to the COLMAP that is installed, unchanged."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from sirpy.colmap_launcher import installed_colmap

LAUNCHER = (
    f"#!{sys.executable}\nimport sys\nfrom sirpy.colmap_launcher import main\nsys.exit(main())\n"
)
FAKE = """#!/bin/sh
for argument in "$@"; do printf '[%s]' "$argument"; done
cat
echo problem >&2
exit 42
"""


def executable(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)
    return path


def run(launcher: Path, *arguments: str, path: str, given: str = "") -> tuple[int, str, str]:
    """(exit status, stdout, stderr) of the launcher with PATH = `path`."""
    done = subprocess.run(
        [launcher, *arguments],
        input=given,
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "PATH": path},
    )
    return done.returncode, done.stdout, done.stderr


def test_arguments_streams_and_status_pass_through(tmp_path: Path) -> None:
    launcher = executable(tmp_path / "venv" / "colmap", LAUNCHER)
    # Another launcher, of another environment, stands in between; so does the folder of this one.
    executable(tmp_path / "other" / "colmap", LAUNCHER)
    executable(tmp_path / "real" / "colmap", FAKE)
    path = f"{tmp_path}/venv:{tmp_path}/other:{tmp_path}/real:/usr/bin:/bin"
    arguments = ("mapper", "--a path", "with space", "", "--x=*")
    status, out, err = run(launcher, *arguments, path=path, given="typed\n")
    assert (status, err) == (42, "problem\n")
    assert out == "[mapper][--a path][with space][][--x=*]typed\n"
    assert run(launcher, path=path)[0] == 42  # no command at all is COLMAP's to answer


def test_a_link_to_a_launcher_is_a_launcher(tmp_path: Path) -> None:
    launcher = executable(tmp_path / "venv" / "colmap", LAUNCHER)
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "colmap").symlink_to(launcher)
    assert installed_colmap(str(tmp_path / "bin")) is None


def test_without_colmap_one_sentence_and_status_127(tmp_path: Path) -> None:
    launcher = executable(tmp_path / "colmap", LAUNCHER)
    (tmp_path / "folder" / "colmap").mkdir(parents=True)  # a folder of that name is no program
    status, out, err = run(launcher, "mapper", path=f"{tmp_path}:{tmp_path}/folder")
    assert (status, out) == (127, "")
    assert "apt-get install colmap" in err and err.count("\n") == 1


def test_the_way_through_imports_nothing_heavy(tmp_path: Path) -> None:
    executable(tmp_path / "colmap", "#!/bin/sh\n")
    program = (
        "import os, sys; os.execv = lambda *_: print(*sys.modules); "
        "sys.argv = ['colmap', 'mapper']; from sirpy.colmap_launcher import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "PATH": str(tmp_path)},
    )
    assert done.returncode == 0, done.stderr
    assert not {"numpy", "pycolmap", "rasterio", "argparse"} & set(done.stdout.split())


def test_our_command_does_not_need_colmap(tmp_path: Path) -> None:
    launcher = executable(tmp_path / "colmap", LAUNCHER)
    status, out, _ = run(launcher, "sir_undistorter", "--help", path=str(tmp_path))
    assert status == 0
    assert "--sub_image_columns" in out
    status, _, err = run(launcher, "sir_undistorter", path=str(tmp_path))
    assert (status, err.count("\n")) == (2, 1)
    assert "--image_path is missing" in err


@pytest.mark.skipif(installed_colmap(os.environ["PATH"]) is None, reason="no COLMAP is installed")
def test_the_installed_colmap_answers_byte_for_byte(tmp_path: Path) -> None:
    launcher = executable(tmp_path / "colmap", LAUNCHER)
    real = installed_colmap(os.environ["PATH"])
    assert real is not None
    for arguments in (["help"], ["model_analyzer", "--path", str(tmp_path / "no model")]):
        direct = subprocess.run([real, *arguments], capture_output=True, timeout=60)
        through = subprocess.run(
            [launcher, *arguments],
            capture_output=True,
            timeout=60,
            env={**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"},
        )
        assert through.returncode == direct.returncode
        assert through.stdout == direct.stdout
    assert shutil.which("colmap", path=str(tmp_path)) == str(launcher)
