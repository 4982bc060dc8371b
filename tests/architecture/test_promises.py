"""Every promise of README and documentation names tests that exist, and has the numbers of the code."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from drivecal.api.http.protocol import MOST_CONNECTIONS
from drivecal.api.live.streams import KEEPALIVE_SECONDS
from drivecal.configuration.settings import Settings
from drivecal.contracts.specification import ReductionSpecification
from drivecal.execution.scheduling.batching import TARGET_SECONDS, batch_size
from drivecal.execution.scheduling.in_flight import WITNESSES
from drivecal.execution.scheduling.refusals import PATIENCE_WITH_REFUSALS
from drivecal.execution.scheduling.reservation import LONG_SECONDS, SMALL_SECONDS
from drivecal.execution.scheduling.scheduler import ATTEMPTS, MOST_LOSSES
from drivecal.storage.admission import MOST_MAPS
from drivecal.storage.engine.database import PROMPT

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


PROMISES = (Path(__file__).parents[2] / "docs" / "pages" / "concepts" / "guarantees.md").read_text(encoding="utf-8")
LIMITS = {name: field.default for name, field in Settings.model_fields.items()}


def test_numbers_in_promises_are_those_of_the_code() -> None:
    for text, promised, actual in (
        ("up to 20 (`reduction.confirm`", 20, ReductionSpecification().confirm),
        ("memory three times", 3, ATTEMPTS),
        ("loses ten workers", 10, MOST_LOSSES),
        ("if two workers", 2, WITNESSES),
        ("after half a minute", 30.0, PATIENCE_WITH_REFUSALS),
        ("each of 0.5 s", 0.5, TARGET_SECONDS),
        ("at most 2 s of its work", 2.0, SMALL_SECONDS),
        ("cells above 5 s", 5.0, LONG_SECONDS),
        ("At most eight campaigns", 8, LIMITS["running_campaigns"]),
        ("problems: 64 MB", 64, LIMITS["problem_mb"]),
        ("over 10,000,000 cells", 10_000_000, LIMITS["largest_campaign"]),
        ("more than 1,000 posted influence maps", 1_000, MOST_MAPS),
        ("or pushed problems", 1_000, LIMITS["pushed_problems"]),
        ("More than 1,000 queued", 1_000, LIMITS["queued_campaigns"]),
        ("or 100 event streams", 100, LIMITS["event_streams"]),
        ("more than 500 requests", 500, MOST_CONNECTIONS),
        ("end within 15 s", 15.0, KEEPALIVE_SECONDS),
    ):
        assert text in PROMISES, text
        assert actual == promised, text


def test_batches_beside_a_small_campaign_are_as_short_as_promised(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "0.1 s with up to six workers, 0.13 s with eight, 0.5 s with 32" in PROMISES
    cost = 0.001  # of a cell: small enough that no other limit counts
    monkeypatch.setattr("drivecal.execution.scheduling.batching.LARGEST", 10_000)
    for workers, seconds in ((1, 0.1), (6, 0.1), (8, 0.13), (32, 0.5)):
        assert round(batch_size(cost, 1e6, workers, beside_small=True) * cost, 2) == seconds


def test_the_api_gives_up_on_a_database_before_it_has_to_say_so() -> None:
    assert "reports the trouble within five seconds" in PROMISES
    assert max(PROMPT.lock, PROMPT.connect) < 5.0
