"""Every promise of README and documentation names tests that exist."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
GUARANTEES, SECURITY = (ROOT / "docs" / "pages" / "concepts" / f"{name}.md" for name in ("guarantees", "security"))
REFERENCE = re.compile(r"`([\w/]+\.py)::(\w+)`")


@cache
def functions_in(file: Path) -> frozenset[str]:
    """Names of the tests in a file."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return frozenset(
        node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    )


def rows(page: Path, head: str) -> dict[str, list[tuple[str, str]]]:
    """The tests of each line of the table with this head."""
    lines = page.read_text(encoding="utf-8").partition(f"{head}\n")[2].splitlines()[1:]
    table = lines[: lines.index("")]
    cells = [line.strip("|").split(" | ") for line in table]
    return {first[0].strip(): REFERENCE.findall(first[-1]) for first in cells}


TABLES = {GUARANTEES: "| promise | held by |", SECURITY: "| attack | result | evidence | test |"}


@pytest.mark.parametrize("page", TABLES, ids=lambda page: page.stem)
def test_every_promise_and_every_attack_names_tests_that_exist(page: Path) -> None:
    table = rows(page, TABLES[page])
    assert len(table) > 10
    assert [promise for promise, tests in table.items() if not tests] == []
    named = {(file, name) for tests in table.values() for file, name in tests} | set(REFERENCE.findall(page.read_text()))
    missing = {(file, name) for file, name in named if not (ROOT / "tests" / file).is_file()}
    assert missing == set()
    assert {(file, name) for file, name in named if name not in functions_in(ROOT / "tests" / file)} == set()


def test_every_attack_has_its_result_and_its_evidence() -> None:
    lines = SECURITY.read_text(encoding="utf-8").partition(f"{TABLES[SECURITY]}\n")[2].splitlines()[1:]
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip("|"))] for line in lines[: lines.index("")]]
    assert [line for line in cells if len(line) != 4 or not all(line)] == []


def test_every_guarantee_of_the_readme_is_in_the_table() -> None:
    section = (ROOT / "README.md").read_text(encoding="utf-8").partition("## Guarantees\n")[2].partition("\n## ")[0]
    promises = [line.removeprefix("- ") for line in section.splitlines() if line.startswith("- ")]
    assert len(promises) >= 5
    assert set(promises) <= rows(GUARANTEES, TABLES[GUARANTEES]).keys()


def test_the_page_takes_no_text_for_markup() -> None:
    """Svelte escapes what it shows, unless it is told not to."""
    sources = [path for path in (ROOT / "services" / "web" / "src").rglob("*") if path.suffix in {".svelte", ".ts"}]
    assert len(sources) > 20
    assert [
        path for path in sources if re.search(r"\{@html|innerHTML|document\.write|outerHTML", path.read_text(encoding="utf-8"))
    ] == []
