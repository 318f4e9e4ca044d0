"""The errors that sirpy raises for a user's mistake. The command line prints their one sentence, exit status 2."""

from __future__ import annotations

from collections.abc import Sequence


def first_few(names: Sequence[str]) -> str:
    """What a sentence shows of many names: "a, b, c ..."."""
    return ", ".join(names[:3]) + (" ..." if len(names) > 3 else "")


class SirpyError(Exception):
    """Root of all errors of this package: one sentence that says what, where and how to mend it."""


class InputError(SirpyError, ValueError):
    """A photograph, model or option that cannot be used."""


class OutputError(SirpyError, OSError):
    """The output folder cannot be written, or its disk is full."""


class BudgetError(SirpyError, MemoryError):
    """No plan meets the memory budget."""
