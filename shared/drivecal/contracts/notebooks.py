"""Answers as HTML tables, for notebooks."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

MOST_ROWS = 20
"""Rows of a table that are shown; further ones are counted."""


def flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a row whose mappings are columns of their own."""
    columns: dict[str, Any] = {}
    for name, value in row.items():
        columns.update(
            {f"{name}.{key}": inner for key, inner in value.items()} if isinstance(value, Mapping) else {name: value}
        )
    return columns


def html_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Returns rows as a table with all their columns."""
    shown = [flat(row) for row in rows[:MOST_ROWS]]
    columns = list(dict.fromkeys(name for row in shown for name in row))
    lines = [_line("th", columns), *(_line("td", [row.get(name) for name in columns]) for row in shown)]
    more = f"<p>{len(rows) - len(shown):,} more rows</p>" if len(rows) > len(shown) else ""
    return f"<table>{''.join(lines)}</table>{more}"


def html_facts(facts: Mapping[str, object]) -> str:
    """Returns named values as a table of two columns."""
    return f"<table>{''.join(_line('td', (name, value)) for name, value in facts.items())}</table>"


def _line(tag: str, values: Iterable[object]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(_text(value))}</{tag}>' for value in values)}</tr>"


def _text(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
