"""Parts of tests: what the fault suite needs: databases that can be killed, and what the campaigns find without any fault."""

import os
import random
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.support.faults.coordinator import Coordinator
from tests.support.faults.findings import Found
from tests.support.faults.oracle import undisturbed
from tests.support.faults.postgres import KillablePostgres, killable_postgres


@pytest.fixture(scope="session")
def postgres() -> Iterator[KillablePostgres]:
    """A PostgreSQL server that a test may kill and must then start again."""
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
    for item in made:
        item.close()


@pytest.fixture(scope="session")
def base_seed() -> int:
    """Returns the seed of all random moments: DRIVECAL_FAULTS_SEED to repeat a failed suite, else a new one."""
    return int(os.environ.get("DRIVECAL_FAULTS_SEED") or random.randrange(10**6) * 1000)
