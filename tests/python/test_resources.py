import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from sirpy import resources
from sirpy.resources import Meter

needs_proc = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc here")
MEGABYTE = 2**20


def test_times_are_those_of_the_block() -> None:
    with Meter() as sleeping:
        time.sleep(0.2)
    assert 0.19 < sleeping.wall_s < 2
    assert sleeping.cpu_s < 0.15
    with Meter() as working:
        end = time.process_time() + 0.2
        while time.process_time() < end:
            pass
    assert 0.19 < working.cpu_s < 0.5  # two clocks: each may round its way


def test_children_count() -> None:
    work = "import time\nwhile time.process_time() < 0.4: pass"
    with Meter() as meter:
        subprocess.run([sys.executable, "-c", work], check=True)
    assert 0.39 < meter.cpu_s < 1.5


@needs_proc
def test_memory_of_a_child_adds_to_our_own() -> None:
    hold = f"import time; a = bytearray({200 * MEGABYTE}); time.sleep(1.5)"
    before = resources.tree_memory()
    assert before is not None
    with Meter() as meter:
        subprocess.run([sys.executable, "-c", hold], check=True)
    after = resources.tree_memory()
    assert meter.peak_bytes is not None and after is not None
    assert meter.peak_bytes - min(before, after) > 195 * MEGABYTE  # this process may have shrunk
    assert meter.peak_bytes - max(before, after) < 300 * MEGABYTE


@needs_proc
def test_a_peak_between_two_samples_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resources, "_INTERVAL", 60.0)
    with Meter() as meter:
        if not meter._own_peak_is_fresh:
            pytest.skip("the kernel does not let us reset the high-water mark")
        before = resources.tree_memory() or 0
        block = np.ones(100 * MEGABYTE, np.uint8)
        del block
    assert meter.peak_bytes is not None
    assert meter.peak_bytes - before > 95 * MEGABYTE


def test_without_proc_there_is_no_memory(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(resources, "_PROC", tmp_path / "none")
    with Meter() as meter:
        pass
    assert meter.peak_bytes is None
    assert meter.wall_s >= 0
