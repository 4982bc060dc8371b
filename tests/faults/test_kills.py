"""SIGKILL to the server's own processes and to its database, anywhere in a campaign."""

import random
from collections.abc import Callable
from typing import Any

import pytest
from tests.support.faults.coordinator import Coordinator
from tests.support.faults.findings import Found
from tests.support.faults.lives import (
    Fault,
    Moment,
    and_ready_again,
    asleep,
    asleep_for,
    dispatcher_asleep,
    kill_api,
    kill_dispatcher,
    kill_everything,
    kill_gcs_server,
    kill_raylet,
    kill_supervisor,
    live,
    moments,
    outage,
    terminate,
)
from tests.support.faults.oracle import carried_out
from tests.support.faults.postgres import KillablePostgres

DATABASES = ("sqlite", "postgresql")
BACKENDS = ("ray", "processes", "processes", "processes")
"""Backends of the lives, in turn. A server with Ray needs longer to start after each kill."""
LIVES, KILLS_IN_A_LIFE = 10, 20
KINDS: tuple[Fault, ...] = (kill_dispatcher, kill_dispatcher, kill_supervisor, kill_everything)

SMALL: dict[str, dict[str, Any]] = {
    "small": {
        "sensitivity": None,
        "catalogue": ["S1"],
        "optimizer": {"kind": "genetic", "population": 12, "iterations": 3, "seed": 2},
    }
}

MakeServer = Callable[..., Coordinator]


@pytest.fixture(scope="module")
def small_without_faults(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Found]:
    return carried_out(tmp_path_factory.mktemp("small"), SMALL)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_small_campaign_outlives_its_processes_and_its_database(
    server_on: MakeServer, small_without_faults: dict[str, Found], postgres: KillablePostgres
) -> None:
    """The short form of what follows: all processes sleep for a second, PostgreSQL is killed and away for one, everything is killed."""
    plan: list[tuple[Moment, Fault]] = [
        (Moment(0.1, 0.0), asleep_for(1.0)),
        (Moment(0.3, 0.0), outage(postgres, 1.0)),
        (Moment(0.5, 0.0), kill_everything),
    ]
    live(server_on("postgresql", DRIVECAL_BACKEND="processes", DRIVECAL_WORKERS="1"), plan, small_without_faults, SMALL)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_small_campaign_on_sqlite_outlives_its_server(server_on: MakeServer, small_without_faults: dict[str, Found]) -> None:
    plan: list[tuple[Moment, Fault]] = [
        (Moment(0.1, 0.0), and_ready_again(kill_api)),  # noticed before the supervisor's own end
        (Moment(0.3, 0.1), and_ready_again(kill_dispatcher)),
        (Moment(0.6, 0.0), kill_supervisor),
    ]
    server = server_on("sqlite", DRIVECAL_WORKERS="1")
    live(server, plan, small_without_faults, SMALL)
    log = server.log.read_text()
    assert "the API ended unexpectedly" in log
    assert "the dispatcher ended unexpectedly" in log


@pytest.mark.faults
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("life", range(LIVES))
@pytest.mark.parametrize("kind", DATABASES)
def test_two_hundred_kills_at_random_points(
    kind: str, life: int, server_on: MakeServer, without_faults: dict[str, Found], base_seed: int
) -> None:
    seed = base_seed + 100 * DATABASES.index(kind) + life
    print(f"seed {seed}")
    chance = random.Random(seed)
    plan = [(moment, chance.choice(KINDS)) for moment in moments(seed, KILLS_IN_A_LIFE)]
    live(server_on(kind, DRIVECAL_BACKEND=BACKENDS[life % len(BACKENDS)]), plan, without_faults)


@pytest.mark.faults
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("life", range(4))
def test_twenty_kills_of_postgresql_in_the_middle_of_a_commit(
    life: int, server_on: MakeServer, without_faults: dict[str, Found], base_seed: int, postgres: KillablePostgres
) -> None:
    seed = base_seed + 500 + life
    print(f"seed {seed}")
    chance = random.Random(seed)
    shares = sorted(chance.uniform(0.0, 0.9) for _ in range(5))
    plan = [(Moment(share, 0.0), outage(postgres, chance.uniform(0.0, 4.0))) for share in shares]
    faults = live(server_on("postgresql"), plan, without_faults).faults
    assert faults.count("kill_postgresql_in_a_commit") >= len(plan) - 1, faults


@pytest.mark.faults
@pytest.mark.timeout(3600)
def test_postgresql_is_away_for_a_minute(
    server_on: MakeServer, without_faults: dict[str, Found], postgres: KillablePostgres
) -> None:
    live(server_on("postgresql"), [(Moment(0.4, 0.0), and_ready_again(outage(postgres, 60.0)))], without_faults)


@pytest.mark.faults
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", DATABASES)
def test_api_and_dispatcher_are_back_in_a_minute(kind: str, server_on: MakeServer, without_faults: dict[str, Found]) -> None:
    faults: list[Fault] = [kill_api, kill_dispatcher, kill_api, kill_dispatcher]
    plan = [(Moment(0.2 * number, 0.1), and_ready_again(fault)) for number, fault in enumerate(faults, 1)]
    live(server_on(kind), plan, without_faults)


@pytest.mark.faults
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", DATABASES)
def test_sigterm_under_load_ends_it_in_ten_seconds(kind: str, server_on: MakeServer, without_faults: dict[str, Found]) -> None:
    live(server_on(kind), [(Moment(share, 0.05), terminate) for share in (0.1, 0.35, 0.6, 0.85)], without_faults)


@pytest.mark.faults
@pytest.mark.timeout(3600)
def test_the_parts_of_a_local_ray_are_killed(server_on: MakeServer, without_faults: dict[str, Found]) -> None:
    plan = [(Moment(0.2, 0.0), and_ready_again(kill_raylet)), (Moment(0.6, 0.0), and_ready_again(kill_gcs_server))]
    live(server_on("sqlite"), plan, without_faults)


@pytest.mark.faults
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("fault", [dispatcher_asleep, asleep])
@pytest.mark.parametrize("kind", DATABASES)
def test_processes_sleep_and_wake_up(kind: str, fault: Fault, server_on: MakeServer, without_faults: dict[str, Found]) -> None:
    plan = [(Moment(0.2, 0.0), and_ready_again(fault)), (Moment(0.6, 0.1), and_ready_again(fault))]
    live(server_on(kind), plan, without_faults)
