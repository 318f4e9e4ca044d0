"""How commands report what is missing from their result."""

from __future__ import annotations

from collections.abc import Sequence

from sirpy.errors import InputError
from sirpy.native_images import LeftOut


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
