"""Progress of the stages, on stderr: a live display on a terminal, plain lines elsewhere, or
nothing.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.console import Console


class Steps:
    """Counts the finished steps of one stage. May be advanced from several threads."""

    def advance(self, steps: int = 1) -> None:
        """`steps` more are done."""


class Progress:
    """Says nothing; the base of the displays."""

    @contextmanager
    def stage(self, name: str, total: int, unit: str) -> Iterator[Steps]:
        """A stage of `total` steps, each one `unit` (singular: "sub-image")."""
        yield Steps()

    def note(self, text: str) -> None:
        """Something that the user should read: a photograph left out, a stage that was already
        done.
        """


def make_progress(quiet: bool) -> Progress:
    """The display that fits where stderr leads; with `quiet`, none."""
    if quiet:
        return Progress()
    return TerminalProgress() if sys.stderr.isatty() else PlainProgress()


class PlainProgress(Progress):
    """Lines for logs: at the start of a stage, about every tenth of it or every 30 s, and at its
    end.
    """

    def __init__(self, stream: TextIO | None = None, interval: float = 30.0) -> None:
        self._stream = stream
        self._interval = interval  # s

    @contextmanager
    def stage(self, name: str, total: int, unit: str) -> Iterator[Steps]:
        self._say(f"{name}: {_count(total, unit)}")
        steps = _PlainSteps(self, name, total, unit, self._interval)
        yield steps
        self._say(f"{name}: done, {steps.summary()}")

    def note(self, text: str) -> None:
        self._say(text)

    def _say(self, text: str) -> None:
        # The stream of the moment: a caller may have redirected stderr since.
        print(text, file=self._stream or sys.stderr, flush=True)


class _PlainSteps(Steps):
    def __init__(
        self, display: PlainProgress, name: str, total: int, unit: str, interval: float
    ) -> None:
        self._display, self._name, self._total, self._unit = display, name, total, unit
        self._interval = interval
        self._begin = self._last_time = time.monotonic()
        self._done = self._last_tenth = 0
        self._lock = threading.Lock()

    def advance(self, steps: int = 1) -> None:
        with self._lock:
            self._done += steps
            now = time.monotonic()
            tenth = 10 * self._done // max(self._total, 1)
            due = tenth > self._last_tenth or now - self._last_time >= self._interval
            if not due or self._done >= self._total:
                return
            self._last_tenth, self._last_time = tenth, now
            seconds = now - self._begin
            left = seconds / self._done * (self._total - self._done)
            self._display.note(
                f"{self._name}: {self._done} of {self._total} ({self._done / self._total:.0%}), "
                f"{_rate(self._done, seconds, self._unit)}, {duration(left)} left"
            )

    def summary(self) -> str:
        seconds = time.monotonic() - self._begin
        return (
            f"{_count(self._done, self._unit)} in {duration(seconds)}, "
            f"{_rate(self._done, seconds, self._unit)}"
        )


class TerminalProgress(Progress):
    """A bar for each stage with its rate and the time that is left; notes stay above it."""

    def __init__(self, console: Console | None = None) -> None:
        from rich.console import Console

        self._console = console or Console(stderr=True)

    @contextmanager
    def stage(self, name: str, total: int, unit: str) -> Iterator[Steps]:
        import rich.progress as bars

        display = bars.Progress(
            bars.TextColumn("{task.description:<18}"),
            bars.BarColumn(bar_width=28),
            bars.TextColumn("{task.completed:>5.0f} of {task.total:.0f}"),
            bars.TextColumn("{task.fields[rate]:>18}"),
            bars.TimeElapsedColumn(),
            bars.TextColumn("left"),
            bars.TimeRemainingColumn(),
            console=self._console,
        )
        with display:
            task = display.add_task(name, total=total, rate="")
            begin = time.monotonic()
            lock = threading.Lock()
            done = 0

            class Bar(Steps):
                def advance(self, steps: int = 1) -> None:
                    nonlocal done
                    with lock:
                        done += steps
                        rate = _rate(done, time.monotonic() - begin, unit)
                    display.update(task, advance=steps, rate=rate)

            yield Bar()

    def note(self, text: str) -> None:
        self._console.print(text, highlight=False, markup=False)


class LoggedProgress(Progress):
    """Shows what another display shows, and keeps it in a log file with the time of day.

    The log does not make its folder: what is said before a stage has made it is written then.
    """

    def __init__(self, shown: Progress, path: Path) -> None:
        self.notes: list[str] = []
        self._shown = shown
        self._path = path
        self._unwritten = ""

    @contextmanager
    def stage(self, name: str, total: int, unit: str) -> Iterator[Steps]:
        begin = time.monotonic()
        self._log(f"{name}: {_count(total, unit)}")
        with self._shown.stage(name, total, unit) as steps:
            yield steps
        self._log(f"{name}: done in {duration(time.monotonic() - begin)}")

    def note(self, text: str) -> None:
        self.notes.append(text)
        self._log(text)
        self._shown.note(text)

    def _log(self, text: str) -> None:
        self._unwritten += f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n"
        if self._path.parent.is_dir():
            with self._path.open("a", encoding="utf-8") as file:
                file.write(self._unwritten)
            self._unwritten = ""


def duration(seconds: float) -> str:
    """8.3 s, 4 min 05 s, 2 h 03 min."""
    if seconds < 59.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min"


def _count(number: int, unit: str) -> str:
    return f"{number} {unit}" if number == 1 else f"{number} {unit}s"


def _rate(done: int, seconds: float, unit: str) -> str:
    """Per second where that is above one, else the time that one takes."""
    if done == 0 or seconds <= 0:
        return f"no {unit} yet"
    if done >= seconds:
        return f"{done / seconds:.1f} {unit}s/s"
    return f"{duration(seconds / done)} per {unit}"
