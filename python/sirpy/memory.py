"""Amounts of memory as users write and read them; powers of ten, as on the box."""

from __future__ import annotations

import ctypes
import re
from contextlib import suppress

from sirpy.errors import InputError

IMAGE_CACHE_BYTES = 64_000_000  # of decoded sub-images, in each process


def parse_memory(text: str) -> int:
    """Bytes of "8GB", "512MB", "1.5 GB" (powers of ten), "8GiB" (powers of two) or "8000000000".

    Raises:
        InputError: it is none of these.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kKmMgGtT]?)(i?)[bB]?\s*", text)
    if not match:
        raise InputError(
            f'--memory "{text}" is not an amount of memory: write it like 8GB or 500MB'
        )
    number, prefix, binary = match.groups()
    power = " kmgt".index(prefix.lower() or " ")
    return int(float(number) * (1024 if binary else 1000) ** power)


def give_back() -> None:
    """Returns what this process has freed to the system: glibc keeps some of it, for each thread, for the rest
    of the run."""
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)


def gigabytes(size: float) -> str:
    """ "1.5 GB", rounded up so that what is printed is enough."""
    return f"{-(-size // 10_000_000) / 100:.2f} GB"
