"""The measured cost of a stage: wall time, CPU time and peak memory of the whole process tree."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path
from types import TracebackType

_INTERVAL = 0.1  # between samples of memory, s
_PROC = Path("/proc")


class Meter:
    """Measures what happens inside its `with` block, in this process and all its descendants.

    The fields are those of the block when it has ended, and of the time since its beginning before
    that. Memory is the sum of the proportional set sizes (PSS: shared pages are counted once) of
    all processes, sampled every 0.1 s. A process of many gigabytes is sampled less often, since the
    kernel walks its pages; the high-water mark of this process, where the kernel lets us reset it,
    catches peaks between two samples. That mark is the process's only one: of nested meters the
    outer may miss a short peak that the inner sees.
    """

    def __init__(self) -> None:
        self._begin_wall = time.monotonic()
        self._begin_cpu = _cpu_seconds()
        self._end: tuple[float, float] | None = None
        self._peak: int | None = None
        self._stop = threading.Event()
        self._sampler = threading.Thread(target=self._sample_until_stopped, daemon=True)
        self._own_peak_is_fresh = False

    def __enter__(self) -> Meter:
        self._begin_wall, self._begin_cpu = time.monotonic(), _cpu_seconds()
        self._own_peak_is_fresh = _reset_own_peak()
        self._sample()
        self._sampler.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._sampler.join()
        self._sample()
        if self._own_peak_is_fresh:
            self._note(_own_peak())
        self._end = time.monotonic(), _cpu_seconds()

    @property
    def wall_s(self) -> float:
        return (self._end[0] if self._end else time.monotonic()) - self._begin_wall

    @property
    def cpu_s(self) -> float:
        """Of this process and of its children that have ended and been waited for."""
        return (self._end[1] if self._end else _cpu_seconds()) - self._begin_cpu

    @property
    def peak_bytes(self) -> int | None:
        """None where the system has no /proc."""
        return self._peak

    def _sample_until_stopped(self) -> None:
        pause = _INTERVAL
        while not self._stop.wait(pause):
            begin = time.monotonic()
            self._sample()
            # At most a twentieth of one processor goes into measuring.
            pause = max(_INTERVAL, 19 * (time.monotonic() - begin))

    def _sample(self) -> None:
        self._note(tree_memory())

    def _note(self, memory: int | None) -> None:
        if memory is not None:
            self._peak = max(self._peak or 0, memory)


def tree_memory() -> int | None:
    """Bytes that this process and its descendants hold now (sum of PSS); None without /proc."""
    sizes = [_proportional_size(process) for process in _tree(os.getpid())]
    known = [size for size in sizes if size is not None]
    return sum(known) if known else None


def _cpu_seconds() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _tree(root: int) -> list[int]:
    processes = [root]
    for process in processes:  # grows while it is walked
        for task in _names(_PROC / str(process) / "task"):
            children = _text(_PROC / str(process) / "task" / task / "children")
            processes.extend(int(child) for child in (children or "").split())
    return processes


def _proportional_size(process: int) -> int | None:
    folder = _PROC / str(process)
    return _kilobytes(_text(folder / "smaps_rollup"), "Pss:") or _kilobytes(
        _text(folder / "status"), "VmRSS:"
    )


def _reset_own_peak() -> bool:
    try:
        (_PROC / "self" / "clear_refs").write_text("5")
    except OSError:
        return False
    return True


def _own_peak() -> int | None:
    return _kilobytes(_text(_PROC / "self" / "status"), "VmHWM:")


def _kilobytes(text: str | None, key: str) -> int | None:
    for line in (text or "").splitlines():
        if line.startswith(key):
            return int(line.split()[1]) * 1024
    return None


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="ascii", errors="replace")
    except OSError:  # the process has ended, or there is no /proc
        return None


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []
