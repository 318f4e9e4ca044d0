"""Files of arrays, sound and damaged."""

from __future__ import annotations

import resource
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sirpy.errors import InputError, OutputError
from sirpy.npy import open_npy, write_npy

ARRAY = np.arange(12, dtype=np.float32).reshape(3, 4)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    np.save(tmp_path / "a.npy", ARRAY)
    return tmp_path / "a.npy"


def test_what_is_opened_is_what_was_saved(path: Path) -> None:
    for shape in ((3, 4), (None, 4), (3, None)):
        np.testing.assert_array_equal(open_npy(path, np.float32, shape, "it"), ARRAY)


@pytest.mark.parametrize(
    "array",
    [
        ARRAY,
        ARRAY[1:, ::2],
        ARRAY[:0],
        np.array([(1, 2.5), (3, 4.5)], np.dtype([("a", "u1"), ("b", "<f4")])),
    ],
)
def test_files_are_those_of_numpy(tmp_path: Path, array: np.ndarray) -> None:
    write_npy(tmp_path / "made" / "a.npy", array)
    np.save(tmp_path / "a.npy", array)
    assert (tmp_path / "made" / "a.npy").read_bytes() == (tmp_path / "a.npy").read_bytes()
    np.testing.assert_array_equal(np.load(tmp_path / "made" / "a.npy"), array)
    opened = open_npy(tmp_path / "a.npy", array.dtype, (None,) * array.ndim, "it")
    np.testing.assert_array_equal(opened, array)


def test_why_a_file_cannot_be_written_is_said(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
        with pytest.raises(OutputError, match=r"a\.npy: File too large; free some space or choose"):
            write_npy(tmp_path / "a.npy", np.zeros(200_000, np.uint8))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:-1],
        lambda data: data[:60],
        lambda data: b"",
        lambda data: b"x" * 400,
        lambda data: data.replace(b"(3, 4)", b"(3, 5)"),
        lambda data: data.replace(b"(3, 4)", b"(4, 3)"),
        lambda data: data.replace(b"(3, 4)", b"(12,)"),
        lambda data: data.replace(b"(3, 4)", b"((((((")[:200],
        lambda data: data.replace(b"<f4", b"<i4"),
        lambda data: data.replace(b"<f4", b"|O "),
        lambda data: b"PK\3\4" + data,
    ],
)
def test_damage_is_said_with_what_mends_it(path: Path, damage: object) -> None:
    path.write_bytes(damage(path.read_bytes()))  # type: ignore[operator]
    with pytest.raises(InputError, match=r"a\.npy .*: delete it and run the test again$") as caught:
        open_npy(path, np.float32, (3, 4), "the test")
    assert "pickle" not in str(caught.value)
    path.unlink()
    with pytest.raises(InputError, match=r"there is no .*a\.npy: run the test again$"):
        open_npy(path, np.float32, (3, 4), "the test")


@pytest.mark.filterwarnings("ignore:invalid escape sequence")
@given(place=st.integers(0, 127), byte=st.integers(0, 255))
@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_other_byte_of_a_header_is_no_traceback(path: Path, place: int, byte: int) -> None:
    np.save(path, ARRAY)
    data = bytearray(path.read_bytes())
    data[place] = byte
    path.write_bytes(data)
    with suppress(InputError):
        assert open_npy(path, np.float32, (3, 4), "it").shape == ARRAY.shape
