"""Results for people: Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping


def print_table(rows: Iterable[Mapping[str, object]]) -> None:
    """Prints rows under the keys of all of them, in the order in which they come up."""
    rows = list(rows)
    columns = list(dict.fromkeys(key for row in rows for key in row))
    print(f"\n| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
    for row in rows:
        print(f"| {' | '.join(_text(row.get(column)) for column in columns)} |", flush=True)


def _text(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)
