"""Bands of rows: memory that does not grow with the map, threads that change nothing.

Torch rounds differently with the number of threads of an operation. Here the operations of a band have one thread,
and threads work on different bands, so the bytes of a result do not depend on how many there are.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import torch

T = TypeVar("T")

CPU_BYTES = 16_000_000  # of one band's largest array: about what the caches of a processor hold
GPU_BYTES = 512_000_000  # enough to keep all of a GPU busy


class Bands:
    """Works on maps band by band.

    Args:
        device: on a GPU the bands follow each other.
        threads: 0 for one on each core.
        most_bytes: of one band's largest array.
    """

    def __init__(
        self, device: torch.device, threads: int = 0, most_bytes: int | None = None
    ) -> None:
        self._on_gpu = device.type != "cpu"
        self.most_bytes = most_bytes or (GPU_BYTES if self._on_gpu else CPU_BYTES)
        self.threads = 1 if self._on_gpu else threads or os.cpu_count() or 1

    def run(self, function: Callable[[slice], None], height: int, bytes_per_row: int) -> None:
        """Calls `function` with the rows of each band; together they are all rows of a map."""
        rows = max(1, self.most_bytes // max(bytes_per_row, 1))
        self.map(function, [slice(y, min(y + rows, height)) for y in range(0, height, rows)])

    def map(self, function: Callable[[T], None], parts: list[T]) -> None:
        """Calls `function` with each of the parts."""
        with self._exact():
            if self.threads == 1 or len(parts) <= 1:
                for part in parts:
                    _inferred(function, part)
                return
            with ThreadPoolExecutor(min(self.threads, len(parts))) as pool:
                for _ in pool.map(lambda part: _inferred(function, part), parts):
                    pass

    @contextmanager
    def _exact(self) -> Iterator[None]:
        if self._on_gpu:  # where convolutions would otherwise round to 10 bits
            with torch.backends.cudnn.flags(allow_tf32=False):
                yield
            return
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            yield
        finally:
            torch.set_num_threads(before)


def _inferred(function: Callable[[T], None], part: T) -> None:
    with torch.inference_mode():  # a mode of the thread
        function(part)
