"""Tables of the model cards, which training writes between marks in their prose."""

import re
from collections.abc import Sequence
from pathlib import Path


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Formats a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _mark(name: str) -> re.Pattern[str]:
    return re.compile(rf"(<!-- {re.escape(name)} -->\n)(.*?)(<!-- end -->)", re.DOTALL)


def read_table(card: Path, name: str) -> str:
    """Returns the text between the marks. Raises ValueError if the card has no such marks."""
    match = _mark(name).search(card.read_text(encoding="utf-8"))
    if match is None:
        raise ValueError(f"{card.name} has no marks for the table {name!r}")
    return match[2].strip()


def write_table(card: Path, name: str, content: str) -> None:
    """Replaces the table between the marks. Raises ValueError if the card has no such marks."""
    read_table(card, name)
    text = card.read_text(encoding="utf-8")
    card.write_text(_mark(name).sub(lambda match: f"{match[1]}{content}\n{match[3]}", text), encoding="utf-8")
