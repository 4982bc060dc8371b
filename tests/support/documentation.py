"""The documentation's sources, and the programs in `docs`, which are no modules of any package."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from tests.support.tree import PROJECT, loaded

DOCS = PROJECT / "docs"
PAGES = sorted(
    [
        *PROJECT.glob("*.md"),
        *PROJECT.glob("*/README.md"),
        *(DOCS / "pages").rglob("*.md"),
        *(PROJECT / "shared/drivecal").rglob("*.md"),
    ]
)


@dataclass(frozen=True)
class Block:
    """A fenced block of a page; `title`: the file that it shows, if it names one."""

    page: Path
    language: str
    title: str
    text: str

    def __str__(self) -> str:
        return f"{self.page.relative_to(PROJECT)}: {' '.join(self.text.split())[:50]}"


def blocks(page: Path) -> Iterator[Block]:
    """The fenced blocks of a page."""
    for language, title, text in re.findall(
        r'^```([a-z]*)(?: title="(.*?)")?\n(.*?)^```', page.read_text(), re.MULTILINE | re.DOTALL
    ):
        yield Block(page, language, title, text)


def program(name: str) -> ModuleType:
    """A program of the documentation, loaded anew."""
    return loaded(f"documentation_{name}", DOCS / f"{name}.py")
