"""Files that are either whole or not there: written to a temporary name, renamed when complete."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from sirpy.engine_options import CopyPolicy
from sirpy.errors import InputError, OutputError, SirpyError

_T = TypeVar("_T")

_LONGEST_NAME = 255  # bytes, of Linux' file systems


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yields a temporary path beside `path`; renamed to `path` when the block ends well, else removed.

    Raises:
        OutputError: the file cannot be written (no permission, no space left).
    """
    temporary = _temporary(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(
            f"cannot write {path}: {error.strerror or error}; {_remedy(error)}, "
            "then run the same command again"
        ) from error
    finally:
        with suppress(OSError):  # also when its folder could not be made: the error above says more
            temporary.unlink()


@contextmanager
def folder_written_whole(path: Path) -> Iterator[Path]:
    """Yields an empty folder beside `path`; it takes the place of `path` when the block ends well, else it is
    removed.

    Raises:
        OutputError: the folder cannot be written (no permission, no space left).
    """
    with written_whole(path) as temporary:
        try:
            temporary.mkdir()
            yield temporary
            if path.exists():
                shutil.rmtree(path)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise


def _temporary(path: Path) -> Path:
    """`.STEM.PROCESS.tmp.EXTENSION` beside `path`, as the C++ core names it too.

    A long stem is shortened, so that every name a file system takes can be written.
    """
    stem, tail = os.fsencode(path.stem), f".{os.getpid()}.tmp{path.suffix}"
    too_long = 1 + len(stem) + len(os.fsencode(tail)) - _LONGEST_NAME
    if too_long > 0:
        mark = f"-{fingerprint(path.stem)}"  # names that begin alike stay apart
        kept = max(len(stem) - too_long - len(mark), 0)
        while kept and stem[kept] & 0xC0 == 0x80:  # no character in half
            kept -= 1
        return path.with_name(f".{os.fsdecode(stem[:kept])}{mark}{tail}")
    return path.with_name(f".{path.stem}{tail}")


def _remedy(error: OSError) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return "free some space or choose another output folder"
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return "choose another output folder"
    return "mend that"


def place(source: Path, target: Path, policy: CopyPolicy) -> None:
    """Makes `target` a second name of the file `source`, or a copy of it.

    Where the file system has no links of the kind, or `source` lies on another one, it is a copy.

    Raises:
        OutputError: the file cannot be written.
    """
    with written_whole(target) as temporary:
        try:
            if policy == "hard-link":
                os.link(source, temporary)
            elif policy == "soft-link":
                temporary.symlink_to(os.path.relpath(source, target.parent))
        except OSError as error:
            if error.errno == errno.ENOSPC:
                raise
        if not os.path.lexists(temporary):
            shutil.copyfile(source, temporary)


def write_text(path: Path, text: str, *, executable: bool = False) -> None:
    with written_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
        if executable:
            temporary.chmod(0o755)


def write_json(path: Path, value: Any) -> None:
    write_text(path, json.dumps(value, indent=1, sort_keys=True) + "\n")


def read_json(path: Path, parse: Callable[[Any], _T], mend: str) -> _T:
    """What `parse` makes of the value in a JSON file.

    Args:
        parse: may fail in any way on a value that is not as it should be.
        mend: the end of the sentence about a damaged file.

    Raises:
        FileNotFoundError: there is no such file.
        InputError: it is no JSON, or nothing that `parse` understands.
    """
    try:
        return parse(json.loads(path.read_text(encoding="utf-8")))
    except (FileNotFoundError, SirpyError):
        raise
    except (
        *(OSError, LookupError, TypeError, ValueError),
        *(AttributeError, ArithmeticError, RecursionError),
    ) as error:
        what = f"it has no {error}" if isinstance(error, KeyError) else error
        raise InputError(f"{path} is damaged ({what}): {mend}") from None


def fingerprint(*parts: Any) -> str:
    """A hash of JSON-able values: equal inputs and options give equal fingerprints."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def file_identity(path: Path) -> tuple[str, int, int]:
    """(name, bytes, time of last change in ns): what tells whether an input file has changed."""
    status = path.stat()
    return path.name, status.st_size, status.st_mtime_ns
