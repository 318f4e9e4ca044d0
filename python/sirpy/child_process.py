"""Processes that run COLMAP apart: what they tell, and how they end."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, TypeVar

T = TypeVar("T")


def run_apart(
    module: str, task: Path, log: IO[bytes], follow: Callable[[IO[str]], T], *, omp_threads: int
) -> tuple[T, str | None]:
    """`python -m module`, whose main() begins with `begin`: what `follow` made of its messages, and how it ended if
    not well.

    Args:
        log: takes what the process prints.
        follow: reads the messages, one JSON object a line, until there are no more.
        omp_threads: VLFeat's own threads would multiply with COLMAP's.
    """
    reading, writing = os.pipe()
    with os.fdopen(reading, encoding="utf-8") as messages:
        process = subprocess.Popen(
            [sys.executable, "-m", module, str(task), str(os.getpid()), str(writing)],
            pass_fds=(writing,),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, "OMP_NUM_THREADS": str(omp_threads)},
        )
        os.close(writing)
        try:
            made = follow(messages)
            status = process.wait()
        finally:
            process.kill()  # only SIGKILL is sure to end a process with COLMAP in it
            process.wait()
    return made, how_it_ended(status)


def how_it_ended(status: int) -> str | None:
    """For a sentence whose subject is the process; None where it ended well."""
    if status == 0:
        return None
    if status > 0:
        return f"failed (exit status {status})"
    name = signal.Signals(-status).name
    return f"was ended by {name}" + (" (out of memory?)" if name == "SIGKILL" else "")


class Caller:
    """The process that follows this one."""

    def __init__(self, descriptor: int) -> None:
        self._pipe = os.fdopen(descriptor, "w", encoding="utf-8")

    def say(self, **message: Any) -> None:
        self._pipe.write(json.dumps(message) + "\n")
        self._pipe.flush()


def begin() -> tuple[Path, Caller]:
    """The task of a process that `run_apart` started, and who waits for it."""
    import pycolmap

    serve(int(sys.argv[2]))
    # glog's log files in /tmp would stay behind.
    pycolmap.logging.logtostderr = True
    return Path(sys.argv[1]), Caller(int(sys.argv[3]))


def serve(parent: int) -> None:
    """Ends this process with the one that started it, even when that was killed with SIGKILL; and lets signals end
    it: glog's handlers may hang in an abort."""
    pr_set_pdeathsig = 1
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)
    if os.getppid() != parent:
        sys.exit(1)
    for number in (signal.SIGABRT, signal.SIGSEGV, signal.SIGTERM, signal.SIGBUS, signal.SIGFPE):
        signal.signal(number, signal.SIG_DFL)
