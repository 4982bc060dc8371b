"""SIGKILL to the server's own processes, anywhere in a campaign."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from tests.support.faults.coordinator import Coordinator
from tests.support.faults.findings import Found
from tests.support.faults.lives import (
    Moment,
    kill_api,
    kill_dispatcher,
    kill_everything,
    kill_supervisor,
    live,
    moments,
    terminate,
)

KILLS_IN_A_LIFE = 5
KINDS = (kill_dispatcher, kill_dispatcher, kill_supervisor, kill_everything)
DATABASES = ("sqlite", "postgresql")
SHORT = {
    "sqlite": [(Moment(0.15, 0.0), kill_api), (Moment(0.3, 0.1), kill_dispatcher), (Moment(0.7, 0.0), terminate)],
    "postgresql": [(Moment(0.2, 0.1), kill_everything), (Moment(0.6, 0.0), kill_dispatcher)],
}

MakeServer = Callable[[str], Coordinator]


@pytest.mark.slow
@pytest.mark.parametrize("kind", DATABASES)
def test_campaigns_outlive_what_carries_them(kind: str, server_on: MakeServer, without_faults: dict[str, Found]) -> None:
    live(server_on(kind), SHORT[kind], without_faults)


@pytest.mark.faults
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("life", range(10))
@pytest.mark.parametrize("kind", DATABASES)
def test_campaigns_outlive_fifty_kills_at_random_points(
    kind: str, life: int, server_on: MakeServer, without_faults: dict[str, Found], base_seed: int
) -> None:
    seed = base_seed + 100 * DATABASES.index(kind) + life
    print(f"seed {seed}")
    chance = random.Random(seed)
    plan = [(moment, chance.choice(KINDS)) for moment in moments(seed, KILLS_IN_A_LIFE)]
    live(server_on(kind), plan, without_faults)
