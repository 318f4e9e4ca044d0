"""Progress of the stages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class Steps:
    """Counts the finished steps of one stage."""

    def advance(self, steps: int = 1) -> None:
        """`steps` more are done."""


class Progress:
    """Says nothing; the base of the displays."""

    @contextmanager
    def stage(self, name: str, total: int, unit: str) -> Iterator[Steps]:
        """A stage of `total` steps, each one `unit` (singular: "sub-image")."""
        yield Steps()

    def note(self, text: str) -> None:
        """Something that the user should read: a photograph left out, a stage that was already done."""
