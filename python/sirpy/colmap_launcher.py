"""The `colmap` command: `colmap sir_undistorter` is ours, everything else goes to the COLMAP that
is installed.

That is the first `colmap` on PATH that is no launcher like this one; it takes over the process, so
streams, signals and exit status are its own. Where there is none the exit status is 127, a shell's
"command not found". Nothing heavy is imported on that way.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

_MARK = b"sirpy.colmap_launcher"  # in the script that pip makes for this entry point
_NOT_FOUND = 127


def main() -> None:
    arguments = sys.argv[1:]
    if arguments[:1] == ["sir_undistorter"]:
        from sirpy.sir_undistorter import main as sir_undistorter

        sys.exit(sir_undistorter(arguments[1:]))
    colmap = installed_colmap(os.environ.get("PATH", os.defpath))
    if colmap is None:
        print(
            "colmap: no COLMAP is installed, and only `colmap sir_undistorter` works without it: "
            "install it (Debian, Ubuntu: apt-get install colmap) or put it on PATH",
            file=sys.stderr,
        )
        sys.exit(_NOT_FOUND)
    try:
        os.execv(colmap, [str(colmap), *arguments])
    except OSError as error:
        print(f"colmap: {colmap} cannot be started ({error.strerror}): mend it", file=sys.stderr)
        sys.exit(126)


def installed_colmap(search_path: str) -> Path | None:
    """The first executable `colmap` in the folders of `search_path` that is not a launcher of
    sirpy."""
    for folder in search_path.split(os.pathsep):
        candidate = Path(folder or ".") / "colmap"
        if candidate.is_file() and os.access(candidate, os.X_OK) and not _is_launcher(candidate):
            return candidate
    return None


def _is_launcher(file: Path) -> bool:
    try:
        with file.open("rb") as stream:
            return stream.read(2) == b"#!" and _MARK in stream.read(4096)
    except OSError:
        return False  # executable but not readable: a program all the same
