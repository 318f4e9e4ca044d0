"""Names in COLMAP's lists: patch-match.cfg (a name a line, below it a line of its sources), fusion.cfg,
lists of images.

COLMAP drops the blanks around a line, takes a line that begins with # for a comment, so that the lines after it
change their roles, and a comma or semicolon for the end of a source's name.
"""

from __future__ import annotations

from collections.abc import Iterable

from sirpy.errors import first_few

_BLANKS = " \t\n\v\f\r"  # C's isspace


def is_listable(name: str) -> bool:
    """Whether COLMAP reads this name from a line that holds it."""
    return name == name.strip(_BLANKS) and not name.startswith("#")


def is_source(name: str) -> bool:
    """Whether COLMAP reads this name from a line of sources."""
    return is_listable(name) and not {",", ";"} & set(name)


def names_note(names: Iterable[str], *, sources: bool) -> str:
    """What to know where lists cannot hold all of these names; empty if they can.

    Args:
        sources: the lists name sources.
    """
    lost = [name for name in names if not (is_source if sources else is_listable)(name)]
    if not lost:
        return ""
    shown = first_few([repr(name) for name in lost])
    commas = ", or of sources with a comma or semicolon" if sources else ""
    return (
        f"COLMAP's lists cannot hold the names of {len(lost)} sub-images ({shown}), and leave them "
        f"out: it takes none that begins with # or a blank{commas}; rename the photographs, in the "
        "model too"
    )
