"""Weights of trained networks: named in the manifest `weights.toml`, downloaded once, used only with their sha256.

They are kept in the user's cache folder (XDG Base Directory Specification) or where SIRPY_WEIGHTS says.
"""

from __future__ import annotations

import hashlib
import os
import tomllib
from dataclasses import dataclass
from http.client import HTTPException
from importlib import resources
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

from sirpy.errors import InputError, OutputError
from sirpy.files import written_whole
from sirpy.progress import Progress

MANIFEST = resources.files("sirpy").joinpath("weights.toml")

_TIMEOUT = 30.0  # s without a byte
_PIECE = 1 << 16  # bytes


@dataclass(frozen=True)
class Weights:
    """One entry of the manifest."""

    name: str
    what: str  # network, paper, training data
    file: str  # name of the file
    url: str  # names a commit, so that it stays the same file
    size: int  # bytes
    sha256: str
    licence: str
    copyright: str
    source: str  # page of its authors

    @property
    def path(self) -> Path:
        """Where the file is, or will be."""
        return weights_folder() / self.file


def manifest() -> dict[str, Weights]:
    """All weights that can be downloaded, by name."""
    entries = tomllib.loads(MANIFEST.read_text(encoding="utf-8"))
    return {name: Weights(name=name, **entry) for name, entry in entries.items()}


def find(name: str) -> Weights:
    """The entry `name` of the manifest.

    Raises:
        InputError: there is none.
    """
    known = manifest()
    if name not in known:
        raise InputError(f"there are no weights named {name}: choose among {', '.join(known)}")
    return known[name]


def weights_folder() -> Path:
    """Where weights are kept: $SIRPY_WEIGHTS, $XDG_CACHE_HOME/sirpy/weights or ~/.cache/sirpy/weights.

    Raises:
        InputError: none of them is known.
    """
    try:
        if named := os.environ.get("SIRPY_WEIGHTS"):
            return Path(named).expanduser()
        cache = Path(os.environ.get("XDG_CACHE_HOME", ""))
        # The specification has a relative path ignored.
        return (cache if cache.is_absolute() else Path.home() / ".cache") / "sirpy" / "weights"
    except RuntimeError as error:
        raise InputError(
            f"there is no folder for weights ({error}): let SIRPY_WEIGHTS name one"
        ) from None


def weights_file(name: str) -> Path:
    """The downloaded file of the weights `name`: its size and sha256 are those of the manifest.

    Raises:
        InputError: there are no such weights, or their file is not there or damaged.
    """
    entry = find(name)
    if found := problem(entry):
        raise InputError(
            f"{found}: run `sirpy weights download {name}`, or let SIRPY_WEIGHTS name a folder that "
            f"holds {entry.file}"
        )
    return entry.path


def problem(entry: Weights) -> str | None:
    """Why the file of `entry` cannot be used; None if it can."""
    path = entry.path
    try:
        with path.open("rb") as file:
            damage = _damage(entry, file.read(entry.size + 1))
    except NotADirectoryError:
        return f"{path.parent}, where weights are looked for, is no folder"
    except FileNotFoundError:
        return f"{entry.file} of {entry.name} is not downloaded to {path.parent}"
    except OSError as error:
        return f"{path} cannot be read ({error.strerror})"
    return damage and f"{path} is damaged ({damage})"


def download(name: str, progress: Progress) -> Path:
    """The file of the weights `name`, downloaded if it is not there yet; a damaged one is replaced.

    Raises:
        InputError: there are no such weights, or their address does not give what the manifest says.
        OutputError: the file cannot be written.
    """
    entry = find(name)
    path = entry.path
    found = problem(entry)
    if found is None:
        progress.note(f"{path} is there already")
        return path
    if os.path.lexists(path):
        progress.note(f"{found}, and is replaced")
    # Held, not streamed into a file: what is killed while it waits for the network leaves nothing.
    content = _fetch(entry, progress)
    if damage := _damage(entry, content):
        raise InputError(
            f"{entry.url} sent something else than {entry.file} ({damage}): try again, or put the "
            f"file by hand at {path}"
        )
    try:
        with written_whole(path) as temporary:
            temporary.write_bytes(content)
    except OutputError as error:
        raise OutputError(f"{error} (SIRPY_WEIGHTS names the folder)") from error
    return path


def _fetch(entry: Weights, progress: Progress) -> bytes:
    """What the address sends, little more than `entry.size` of it at most."""
    content = bytearray()
    try:
        with (
            urlopen(entry.url, timeout=_TIMEOUT) as response,
            progress.stage(f"download {entry.file}", entry.size // 1000, "kilobyte") as steps,
        ):
            while len(content) <= entry.size and (piece := response.read1(_PIECE)):
                before = len(content)
                content += piece
                steps.advance(len(content) // 1000 - before // 1000)
    except (OSError, HTTPException) as error:
        raise InputError(
            f"cannot download {entry.url} ({_reason(error)}): try again, or put the file by hand at "
            f"{entry.path}"
        ) from error
    return bytes(content)


def _reason(error: Exception) -> str:
    if isinstance(error, HTTPError):
        error.close()  # it holds the connection
        return str(error)
    reason = str(getattr(error, "reason", error))  # without the wrapping of URLError
    return " ".join(reason.split())  # what is no HTTP is quoted, line ends and all


def _damage(entry: Weights, content: bytes) -> str | None:
    """What tells `content` from the published file; None if nothing does."""
    if len(content) > entry.size:
        return f"more than {entry.size:,} bytes"
    if len(content) < entry.size:
        return f"{len(content):,} of {entry.size:,} bytes"
    sha256 = hashlib.sha256(content).hexdigest()
    return None if sha256 == entry.sha256 else f"sha256 {sha256} instead of {entry.sha256}"
