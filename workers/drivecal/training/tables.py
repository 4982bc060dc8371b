"""Tables of the model cards: the cards are prose with marked places, and the tables between the marks are what training writes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _mark(name: str) -> re.Pattern[str]:
    return re.compile(rf"(<!-- {re.escape(name)} -->\n)(.*?)(<!-- end -->)", re.DOTALL)


def read_table(card: Path, name: str) -> str:
    """What stands between the marks. Raises ValueError if the card has no such place."""
    found = _mark(name).search(card.read_text(encoding="utf-8"))
    if found is None:
        raise ValueError(f"{card.name} has no place for {name}")
    return found[2].strip()


def write_table(card: Path, name: str, content: str) -> None:
    """Puts a table in its place. Raises ValueError if the card has none."""
    read_table(card, name)
    text = card.read_text(encoding="utf-8")
    card.write_text(_mark(name).sub(lambda match: f"{match[1]}{content}\n{match[3]}", text), encoding="utf-8")
