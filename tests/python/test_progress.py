import io
import re
import time
from pathlib import Path

import pytest
from rich.console import Console
from sirpy.progress import (
    LoggedProgress,
    PlainProgress,
    Progress,
    TerminalProgress,
    duration,
    make_progress,
)


def test_plain_lines_tell_start_tenths_and_end() -> None:
    stream = io.StringIO()
    with PlainProgress(stream).stage("stereo", 200, "sub-image") as steps:
        for _ in range(200):
            steps.advance()
    lines = stream.getvalue().splitlines()
    assert lines[0] == "stereo: 200 sub-images"
    assert [line.split(",")[0] for line in lines[1:-1]] == [
        f"stereo: {20 * i} of 200 ({10 * i}%)" for i in range(1, 10)
    ]
    assert re.fullmatch(r"stereo: done, 200 sub-images in .* s, .* sub-images/s", lines[-1])


def test_plain_lines_come_after_the_interval_too() -> None:
    stream = io.StringIO()
    with PlainProgress(stream, interval=0.01).stage("stereo", 1000, "sub-image") as steps:
        for _ in range(2):
            time.sleep(0.02)
            steps.advance()
    assert "stereo: 1 of 1000 (0%)" in stream.getvalue()
    assert "stereo: 2 of 1000 (0%)" in stream.getvalue()


def test_a_failed_stage_is_not_called_done() -> None:
    stream = io.StringIO()
    with pytest.raises(KeyError), PlainProgress(stream).stage("cut", 3, "photograph"):
        raise KeyError
    assert "done" not in stream.getvalue()


def test_one_is_not_plural_and_slow_steps_give_the_time_of_one() -> None:
    stream = io.StringIO()
    with PlainProgress(stream).stage("cut", 1, "photograph") as steps:
        time.sleep(0.02)
        steps.advance()
    assert stream.getvalue().startswith("cut: 1 photograph\n")
    assert duration(8.26) == "8.3 s"
    assert duration(59.96) == "1 min 00 s"
    assert duration(245) == "4 min 05 s"
    assert duration(2 * 3600 + 3 * 60) == "2 h 03 min"


def test_the_terminal_shows_count_and_note() -> None:
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=110)
    progress = TerminalProgress(console)
    with progress.stage("stereo", 9, "sub-image") as steps:
        steps.advance(9)
        progress.note("[b] left out")
    assert "9 of 9" in stream.getvalue()
    assert "sub-images/s" in stream.getvalue()
    assert "[b] left out" in stream.getvalue()  # a file name is not markup


def test_quiet_is_silent_and_a_pipe_gets_lines(capfd: pytest.CaptureFixture[str]) -> None:
    quiet = make_progress(quiet=True)
    assert type(quiet) is Progress
    with quiet.stage("cut", 2, "photograph") as steps:
        steps.advance()
        quiet.note("nothing")
    assert capfd.readouterr() == ("", "")
    make_progress(quiet=False).note("read me")
    assert capfd.readouterr() == ("", "read me\n")


def test_a_log_keeps_what_was_shown_with_the_time(tmp_path: Path) -> None:
    shown = io.StringIO()
    progress = LoggedProgress(PlainProgress(shown), tmp_path / "out" / "log.txt")
    with progress.stage("stereo", 2, "sub-image") as steps:
        steps.advance(2)
        assert not (tmp_path / "out").exists()
        (tmp_path / "out").mkdir()
    progress.note("a.jpg is left out")
    lines = (tmp_path / "out" / "log.txt").read_text(encoding="utf-8").splitlines()
    assert all(re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d ", line) for line in lines)
    assert [line[20:] for line in lines[::2]] == ["stereo: 2 sub-images", "a.jpg is left out"]
    assert "a.jpg is left out" in shown.getvalue()
