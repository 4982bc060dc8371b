"""Parts of tests: what the fault suite needs: databases that can be killed, and what the campaigns find without any fault."""

import json
import os
import random
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.support.effort import LONG
from tests.support.faults import report
from tests.support.faults.coordinator import Coordinator
from tests.support.faults.findings import Found
from tests.support.faults.oracle import undisturbed
from tests.support.faults.postgres import KillablePostgres, killable_postgres


@pytest.fixture(scope="session")
def postgres() -> Iterator[KillablePostgres]:
    """A PostgreSQL server that the suite may kill; whoever does starts it again."""
    with killable_postgres() as server:
        yield server


@pytest.fixture(scope="session")
def without_faults(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Found]:
    """Returns what the campaigns find, by name, where nothing happens to them. Both databases have to give just this."""
    return undisturbed(tmp_path_factory.mktemp("without-faults"))


@pytest.fixture
def server_on(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Callable[..., Coordinator]]:
    """Makes the test's server, not started, on an empty database of a kind, with environment variables."""
    made: list[Coordinator] = []

    def make(kind: str, **settings: str) -> Coordinator:
        url = request.getfixturevalue("postgres").new_database() if kind == "postgresql" else None
        made.append(Coordinator(tmp_path, url, settings))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture(scope="session")
def base_seed() -> int:
    """Of all random points: DRIVECAL_FAULTS_SEED repeats a suite that failed, otherwise every suite has its own."""
    return int(os.environ.get("DRIVECAL_FAULTS_SEED") or random.randrange(10**6) * 1000)


@pytest.fixture(autouse=True)
def told(record_property: Callable[[str, object], None]) -> Iterator[None]:
    """Has the test's report carry what its servers went through."""
    report.NOTES.clear()
    yield
    if report.NOTES:
        record_property(report.PROPERTY, report.CARRIED.dump_json(report.NOTES).decode())


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Tells what was done to servers and what came of it, and keeps it, if the long forms ran."""
    if not LONG:
        return
    ended = [test for reports in terminalreporter.stats.values() for test in reports if isinstance(test, pytest.TestReport)]
    failed = {test.nodeid for test in ended if test.failed}
    seconds: dict[str, float] = {}
    for test in ended:
        seconds[test.nodeid] = seconds.get(test.nodeid, 0.0) + test.duration
    lives = {
        test.nodeid: report.CARRIED.validate_json(str(dict(test.user_properties).get(report.PROPERTY, "[]")))
        for test in ended
        if test.when == "teardown"
    }
    tests = [
        report.Told(name.partition("[")[0].rpartition("/")[2], name not in failed, seconds[name], lives.get(name, []))
        for name in seconds
    ]
    if not tests:
        return
    rows = report.table(tests)
    report.TARGET.parent.mkdir(parents=True, exist_ok=True)
    report.TARGET.write_text(json.dumps({"tests": rows, "faults": report.by_kind(tests)}, indent=2))
    terminalreporter.section("faults")
    for line in [*report.lines(rows), *(f"{database}: {kinds}" for database, kinds in report.by_kind(tests).items())]:
        terminalreporter.write_line(line)
