"""Tables as people keep them."""

from __future__ import annotations

from pathlib import Path

import pytest
from sirpy.errors import InputError
from sirpy.point_tables import Table, read_table

NAME, X = ("name", "image"), ("x", "easting")


def table(folder: Path, text: str, encoding: str = "utf-8") -> Table:
    path = folder / "t.csv"
    path.write_bytes(text.encode(encoding))
    return read_table(path)


@pytest.mark.parametrize(
    "text",
    [
        "name,x\na.jpg,1.5\nb.jpg,-2\n",
        "\ufeffImage;Easting (m)\r\na.jpg;1,5\r\n\r\nb.jpg;-2\r\n",
        "# Name\tX [m]\n# measured in spring\na.jpg\t1.5\nb.jpg\t-2",
        'name,x\n"a.jpg", 1.5\n b.jpg ,-2e0\n',
    ],
)
def test_delimiters_headers_and_comments(tmp_path: Path, text: str) -> None:
    found = table(tmp_path, text)
    found.need(NAME, X)
    rows = [(name, row.number(X)) for name, row in found.by_name(NAME)]
    assert rows == [("a.jpg", 1.5), ("b.jpg", -2)]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "t.csv is empty"),
        ("\n\n", "t.csv is empty"),
        ("name,x\n", "no rows"),
        ("name,x\na.jpg\n", "line 2 of .* has 1 fields where the header has 2"),
        ("name,x\na.jpg,1,2\n", "line 2 of .* has 3 fields"),
        ("name,x,X\na.jpg,1,2\n", "names a column twice"),
        ("name,x\na.jpg,1\n\n,2\n", "line 4 of .* has no name"),
        ("name,x\na.jpg,1\na.jpg,2\n", "line 3 of .* names a.jpg again, after line 2"),
        ("name,x\na.jpg,one\n", "line 2 of .* has 'one' for x"),
        ("name,x\na.jpg,nan\n", "line 2 of .* has 'nan' for x"),
        ("name,x\na.jpg,1e999\n", "line 2 of .* has '1e999' for x"),
        ("name;x\na.jpg;1,2,3\n", "line 2 of .* has '1,2,3' for x"),
        ("a.jpg,1\nb.jpg,2\n", "no column name .*its header has a.jpg, 1"),
    ],
)
def test_what_is_wrong_and_where(tmp_path: Path, text: str, why: str) -> None:
    with pytest.raises(InputError, match=why):
        found = table(tmp_path, text)
        found.need(NAME, X)
        for _, row in found.by_name(NAME):
            row.number(X)


def test_no_file_and_no_text(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_table(tmp_path / "none.csv")
    with pytest.raises(InputError, match="cannot be read"):
        table(tmp_path, "name,x\nä.jpg,1\n", "latin-1")
