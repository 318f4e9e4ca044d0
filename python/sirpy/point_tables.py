"""Tables of points as people keep them: text with a header, divided by commas, semicolons or tabs."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from sirpy.errors import InputError


@dataclass(frozen=True)
class Row:
    """A line of a table: `where` names file and line, `texts` the fields by header, which is in small letters
    without what stands in brackets."""

    where: str
    texts: dict[str, str]
    decimal_comma: bool

    def text(self, names: Sequence[str]) -> str:
        """The field under the first of these headers that the table has; empty when it has none."""
        return next((self.texts[name] for name in names if name in self.texts), "")

    def number(self, names: Sequence[str]) -> float:
        """Raises InputError where the field is no finite number."""
        text = self.text(names)
        try:
            value = float(text.replace(",", ".") if self.decimal_comma else text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InputError(
                f"{self.where} has {text!r} for {names[0]}: give a number, or remove the line"
            )
        return value


@dataclass(frozen=True)
class Table:
    """The rows of a file, and the headers that all of them have."""

    path: Path
    headers: tuple[str, ...]
    rows: tuple[Row, ...]

    def need(self, *columns: Sequence[str]) -> None:
        """Raises InputError unless there is a header for each column, under one of its names."""
        for names in columns:
            if not any(name in self.headers for name in names):
                raise InputError(
                    f"{self.path} has no column {names[0]} (its header has {', '.join(self.headers)}): "
                    f"the first line names the columns, one of them {' or '.join(names[:3])}"
                )

    def by_name(self, names: Sequence[str]) -> Iterator[tuple[str, Row]]:
        """The rows with their names; raises InputError where one is missing or comes twice."""
        seen: dict[str, str] = {}
        for row in self.rows:
            name = row.text(names)
            if not name:
                raise InputError(f"{row.where} has no {names[0]}: give it, or remove the line")
            if name in seen:
                raise InputError(
                    f"{row.where} names {name} again, after {seen[name]}: keep one of them"
                )
            seen[name] = row.where
            yield name, row


def read_table(path: Path) -> Table:
    """Reads a table; empty lines, and comments after #, are passed over.

    The delimiter is what the header has most of. Where it is not the comma, numbers may have decimal commas.

    Raises:
        InputError: it cannot be read, has no rows, or a row has not as many fields as the header.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise InputError(f"the table {path} cannot be read as text ({error})") from None
    numbered = [(number, line.strip()) for number, line in enumerate(lines, 1) if line.strip()]
    if not numbered:
        raise InputError(f"the table {path} is empty: its first line names the columns")
    header = numbered[0][1].lstrip("#")
    delimiter = max(",;\t", key=header.count)
    headers = tuple(
        name.split("(")[0].split("[")[0].strip().lower() for name in _fields(header, delimiter)
    )
    if len(set(headers)) < len(headers):
        raise InputError(f"{path} names a column twice ({', '.join(headers)}): keep one of them")
    rows = []
    for number, line in numbered[1:]:
        if line.startswith("#"):
            continue
        where, fields = f"line {number} of {path}", _fields(line, delimiter)
        if len(fields) != len(headers):
            raise InputError(
                f"{where} has {len(fields)} fields where the header has {len(headers)}: mend the line"
            )
        rows.append(Row(where, dict(zip(headers, fields, strict=True)), delimiter != ","))
    if not rows:
        raise InputError(f"the table {path} has a header and no rows")
    return Table(path, headers, tuple(rows))


def _fields(line: str, delimiter: str) -> list[str]:
    return [field.strip() for field in next(csv.reader([line], delimiter=delimiter))]
