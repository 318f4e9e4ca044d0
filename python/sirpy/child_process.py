"""How a process behaves that was started to run COLMAP apart."""

from __future__ import annotations

import ctypes
import os
import signal
import sys


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
