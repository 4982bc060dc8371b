"""Fixtures that every suite may use: the servers that are too slow to start for each test."""

import gc
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TypeVar
from unittest.mock import patch

import hypothesis
import psycopg
import pytest
from sqlalchemy import Pool, event
from tests.support import effort
from tests.support.databases import leave_it_to_the_system
from tests.support.postgres import create_database, running_postgres
from tests.support.setups import ARCHIVES, FOLDER
from tests.support.tree import PROJECT
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling

from drivecal.campaigns.resolve.problem import trial
from drivecal.execution.processes.backend import ProcessBackend
from drivecal.execution.ray.backend import RayBackend
from drivecal.execution.supervised import WorkerLimits
from drivecal.storage.engine.database import PATIENT, Database, Patience

Started = TypeVar("Started", RayBackend, ProcessBackend)

# Everyday examples are the same everywhere, so that a newcomer's first run is no lottery. No test asserts a time: a first example that
# imports or compiles something may take as long as it likes.
hypothesis.settings.register_profile("everyday", deadline=None, derandomize=True, max_examples=30)
hypothesis.settings.register_profile("wide", deadline=None, max_examples=effort.examples(100), print_blob=True)
hypothesis.settings.load_profile("wide" if effort.LONG else "everyday")

# Servers in processes of their own wait for the disk, as users' servers do.
event.listen(Pool, "checkout", leave_it_to_the_system)

# A shell that runs the tests in the background has SIGINT ignored, and every process that a test starts would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)


# Collecting makes objects by the million that stay to the end: looking through them for garbage takes longer than many tests.
gc.disable()


SHARE_RAY = {"tests/contract/backend/test_backend.py", "tests/faults/test_poison.py", "tests/integration/test_ray_backend.py"}
"""The files that use `ray_backend`: one process runs them all and starts Ray once."""
LONG_FILES = (
    *("kills", "how_tos", "page_views", "backend", "poison", "ray_backend", "liveness", "hostile_problems", "hostile_files"),
    *("problems_whole_way", "highway", "documentation", "tutorials", "predictions", "notebooks", "random_campaigns", "fmu"),
    *("process", "outside_optimizers", "children", "guard", "cell_search", "problem", "supervisor", "surrogate", "check_cli"),
    *("api_schema", "database", "api_corpus", "disk", "database_away", "serve", "backup", "hostile_drives"),
)
"""Files that take longest, in `make test` or only in `make test-slow`: waiting files alternate with computing ones."""
SUITES = ("compose", "faults", "browser", "integration", "contract", "golden", "architecture", "unit")
"""Suites in the order of their files' lengths."""
MARKERS = ("slow", "faults", "compose", "packages")
"""Markers of tests that run only with `-m`: they take long, or need a Docker engine or a package index."""
PARTIAL = ("slow", "faults")
"""Markers that may name the cases that they leave out."""


class WholeFiles(LoadFileScheduling):  # type: ignore[misc]  # xdist ships no types
    """Gives each process whole files, so that what a file starts is started once."""

    def __init__(self, config: pytest.Config, log: Producer) -> None:
        super().__init__(config, log)
        self.kernels = subprocess.Popen([sys.executable, "-m", "drivecal.runtime"])

    def _split_scope(self, nodeid: str) -> str:
        file = str(super()._split_scope(nodeid))
        return "ray" if file in SHARE_RAY else file

    def schedule(self) -> None:
        """Starts the tests when the kernels are compiled, which happens while the processes collect them.

        In a new clone every process of the tests and of their servers would compile the same functions at once: half a minute each.
        """
        assert self.kernels.wait() == 0, "the kernels were not compiled"
        super().schedule()


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> WholeFiles | None:
    """The scheduler of `make test`."""
    return WholeFiles(config, log) if config.option.dist == "loadfile" else None


def holds(mark: pytest.Mark, item: pytest.Item) -> bool:
    """Returns whether a mark applies to an item: `slow("postgresql", "S2")` applies to cases with one of these ids among theirs."""
    case = item.nodeid.partition("[")[2].removesuffix("]")
    return not mark.args or any(f"-{name}-" in f"-{case}-" for name in mark.args)


def refuse_misspelt_cases(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Raises UsageError for ids in `slow(...)` that no case of their test has, unless single cases were asked for."""
    if any("::" in argument for argument in config.args):
        return
    held: dict[tuple[str, str], bool] = {}
    for item in items:
        test = item.nodeid.partition("[")[0]
        for mark in item.own_markers:
            for name in mark.args if mark.name in PARTIAL else ():
                held[test, name] = held.get((test, name), False) or holds(pytest.mark.slow(name).mark, item)
    if misspelt := [f"{test} has no case {name!r}" for (test, name), is_held in held.items() if not is_held]:
        raise pytest.UsageError("; ".join(misspelt))


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leaves out files without the one marker that `-m` asks for: to import all files takes half of the time of collecting."""
    asked = config.option.markexpr
    held = asked not in MARKERS or collection_path.suffix != ".py" or f"mark.{asked}" in collection_path.read_text()
    return None if held else True


@pytest.hookimpl(tryfirst=True)  # before `-m` looks at the marks
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselects tests of unrequested `MARKERS`. Puts long files first, so that no process is left alone with one at the end."""
    refuse_misspelt_cases(config, items)
    for item in items:
        item.own_markers[:] = [mark for mark in item.own_markers if mark.name not in PARTIAL or holds(mark, item)]
    unwanted = [marker for marker in MARKERS if marker not in config.option.markexpr]
    wanted: dict[bool, list[pytest.Item]] = {True: [], False: []}
    for item in items:
        wanted[not any(map(item.get_closest_marker, unwanted))].append(item)
    config.hook.pytest_deselected(items=wanted[False])
    items[:] = wanted[True]
    places = {f"test_{name}": place for place, name in enumerate(LONG_FILES)}
    items.sort(
        key=lambda item: (
            places.get(item.path.stem, len(places)),
            SUITES.index(item.path.relative_to(PROJECT / "tests").parts[0]),
        )
    )


def pytest_collection_finish() -> None:
    """From here on garbage is collected as usual, among what the tests make."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Tests log what hostile clients and broken workers say. Lone surrogates do not get from a process of pytest-xdist to the next."""
    report = yield
    report.sections = [(title, text.encode(errors="replace").decode()) for title, text in report.sections]
    return report


@contextmanager
def started(make: Callable[[], Started], home: Path) -> Iterator[Started]:
    """A backend on which the plug-in of `tests.support` is installed, as soon as both its workers are there."""
    with patch.dict(os.environ, HOME=str(home), PYTHONPATH=str(FOLDER)), closing(make()) as backend:
        while len(backend.slots()) < 2:
            backend.wait(1.0)
        yield backend


@pytest.fixture(scope="session")
def ray_backend(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RayBackend]:
    """A local Ray with two workers: one per process is all Ray allows."""
    options = WorkerLimits(workers=2, deadline_seconds=10.0, archive=ARCHIVES.__getitem__)
    with started(lambda: RayBackend(options, trial()), tmp_path_factory.mktemp("home")) as backend:
        yield backend


@pytest.fixture(scope="session")
def processes_backend(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ProcessBackend]:
    """Two workers as processes of this machine."""
    limits = WorkerLimits(workers=2, deadline_seconds=5.0, archive=ARCHIVES.__getitem__)
    with started(lambda: ProcessBackend(limits, trial()), tmp_path_factory.mktemp("home")) as backend:
        yield backend


@pytest.fixture(autouse=True)
def closed(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Closes the databases that a test opens: an open connection would fail whichever test runs when it is collected."""
    opened: list[Database] = []
    original = Database.open

    def opens(url: str, patience: Patience = PATIENT) -> Database:
        opened.append(original(url, patience))
        return opened[-1]

    monkeypatch.setattr(Database, "open", opens)
    yield
    for database in opened:
        database.dispose()


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[str]:
    """The URL of a real PostgreSQL server's administration database; started with the first test that asks for it."""
    with running_postgres() as url:
        yield url


@pytest.fixture(scope="session")
def postgres_scratch(postgres_server: str) -> str:
    """The URL of the database that `postgres_url` empties for each test: making one is slow, and removing it even more."""
    return create_database(postgres_server, "scratch")


@pytest.fixture
def postgres_url(postgres_scratch: str) -> str:
    """Returns the URL of an empty PostgreSQL database. Ends sessions that earlier tests left open."""
    with psycopg.connect(postgres_scratch, autocommit=True) as connection:
        connection.execute(
            "SELECT pg_terminate_backend(pid, 5000) FROM pg_stat_activity"
            " WHERE datname = current_database() AND pid <> pg_backend_pid()"
        )
        connection.execute("DROP SCHEMA public CASCADE")
        connection.execute("CREATE SCHEMA public")
    return postgres_scratch
