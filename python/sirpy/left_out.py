"""Photographs that cannot be used: named when it shows, and at the end of the command."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sirpy.errors import InputError
from sirpy.native_images import LeftOut
from sirpy.photographs import find_photographs, photograph_size
from sirpy.progress import Progress


def leave_out(name: str, reason: str, left_out: list[LeftOut], progress: Progress) -> None:
    left_out.append(LeftOut(name, reason))
    progress.note(f"{name} is left out: {reason}")


def sizes_of_photographs(
    images: Path, progress: Progress
) -> tuple[dict[str, tuple[int, int]], list[LeftOut]]:
    """(width, height) by name of each photograph in a folder that has a header. Raises InputError where there
    are no photographs."""
    sizes: dict[str, tuple[int, int]] = {}
    left_out: list[LeftOut] = []
    for name in find_photographs(images):
        try:
            sizes[name] = photograph_size(images / name)
        except InputError as error:
            leave_out(name, str(error), left_out, progress)
    return sizes, left_out


def report_left_out(
    left_out: Sequence[LeftOut], what: str = "photographs", failed: Sequence[LeftOut] = ()
) -> None:
    """The exit status says that something is missing, although the rest is done.

    Raises:
        InputError: anything is left out, or any product failed.
    """
    missing = [
        f"without {len(some)} of the {of_what} ({_reasons(some)})"
        for some, of_what in ((left_out, what), (failed, "products"))
        if some
    ]
    if missing:
        raise InputError(f"the result is made {' and '.join(missing)}")


def _reasons(left_out: Sequence[LeftOut]) -> str:
    more = f"; and {len(left_out) - 3} more" if len(left_out) > 3 else ""
    return "; ".join(f"{out.name}: {out.reason}" for out in left_out[:3]) + more
