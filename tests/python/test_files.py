"""Files under a second name: links where there can be some, copies elsewhere."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from sirpy.engine_options import CopyPolicy
from sirpy.errors import OutputError
from sirpy.files import place, write_text, written_whole


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "images" / "a.jpg"
    path.parent.mkdir()
    path.write_bytes(b"pixels")
    return path


@pytest.mark.parametrize("policy", ["copy", "hard-link", "soft-link"])
def test_the_second_name_has_the_content(source: Path, tmp_path: Path, policy: CopyPolicy) -> None:
    target = tmp_path / "pmvs" / "visualize" / "0.jpg"
    for _ in range(2):  # again over what is there
        place(source, target, policy)
        assert target.read_bytes() == b"pixels"
        assert [path.name for path in target.parent.iterdir()] == ["0.jpg"]
    assert target.is_symlink() == (policy == "soft-link")
    assert target.samefile(source) == (policy != "copy")
    # A link still holds when the folder is moved as a whole.
    source.parent.parent.joinpath("moved").mkdir()
    for name in ("images", "pmvs"):
        (tmp_path / name).rename(tmp_path / "moved" / name)
    assert (tmp_path / "moved" / "pmvs" / "visualize" / "0.jpg").read_bytes() == b"pixels"


@pytest.mark.parametrize("policy", ["hard-link", "soft-link"])
def test_where_there_are_no_links_it_is_a_copy(
    source: Path, tmp_path: Path, policy: CopyPolicy, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    monkeypatch.setattr(os, "symlink", refuse)
    place(source, tmp_path / "0.jpg", policy)
    assert (tmp_path / "0.jpg").read_bytes() == b"pixels"
    assert not (tmp_path / "0.jpg").samefile(source)


def test_a_folder_that_cannot_be_is_one_sentence(source: Path, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot write"):
        place(source, source / "0.jpg", "copy")
    assert source.read_bytes() == b"pixels"


@pytest.mark.parametrize("letter", ["n", "ä", "万"])
def test_names_as_long_as_the_file_system_takes(tmp_path: Path, letter: str) -> None:
    stem = letter * (250 // len(letter.encode()))
    paths = [tmp_path / f"{stem}{i}.jpg" for i in range(2)]
    with written_whole(paths[0]) as first, written_whole(paths[1]) as second:
        assert first != second
        for temporary in (first, second):
            assert len(os.fsencode(temporary.name)) <= 255
            assert temporary.name.startswith(f".{letter}")
            assert temporary.name.endswith(f".{os.getpid()}.tmp.jpg")
            temporary.write_text("pixels", encoding="utf-8")
    assert sorted(tmp_path.iterdir()) == paths


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.ENOSPC, "free some space or choose another output folder, then run"),
        (errno.EACCES, "Permission denied; choose another output folder, then run"),
        (errno.ENAMETOOLONG, "File name too long; mend that, then run"),
    ],
)
def test_the_advice_is_that_of_the_reason(tmp_path: Path, number: int, advice: str) -> None:
    with pytest.raises(OutputError, match=advice), written_whole(tmp_path / "a.jpg"):
        raise OSError(number, os.strerror(number))


def test_names_that_are_too_long_are_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="File name too long; mend that"):
        write_text(tmp_path / f"{'n' * 256}.txt", "text")
