"""Cells that break the worker that simulates them."""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from sqlalchemy import select
from tests.support.faults.coordinator import coordinator
from tests.support.faults.lives import wait_until_ended
from tests.support.faults.workload import submit
from tests.support.plugins.misbehaving import POISONOUS as POISON
from tests.support.pooled import MemoryLeases, drain
from tests.support.setups import FOLDER, misbehaving_setup
from tests.support.values import present

from drivecal.contracts.work import Cell
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.pool import WorkPool
from drivecal.execution.ray.backend import RayBackend
from drivecal.execution.scheduling.in_flight import LOSSES_TOGETHER, Work
from drivecal.execution.scheduling.scheduler import ATTEMPTS
from drivecal.storage.engine.tables import evaluations

CAUSES = {POISON.SEGFAULT: Breakdown.CRASH, POISON.HANG: Breakdown.HANG, POISON.MEMORY: Breakdown.MEMORY}
LOSSES = 5  # each takes the start of a worker; `test_resources.py` shows the ten
RUNS = {POISON.SEGFAULT: LOSSES, POISON.HANG: ATTEMPTS, POISON.MEMORY: ATTEMPTS}
"""Ray does not tell a crash from a worker that was killed, which takes no attempt."""
SHORTEST_DEADLINE_SECONDS = 10.0
PATIENCE_FACTOR = 20.0
"""A cell hangs that takes this many times longer than the first one, which loads what the others find loaded."""


@pytest.fixture
def healed(ray_backend: RayBackend) -> Iterator[RayBackend]:
    """The tests' workers, whole before and afterwards."""
    while len(ray_backend.slots()) < 2:
        ray_backend.wait(0.5)
    yield ray_backend
    while len(ray_backend.slots()) < 2:
        ray_backend.wait(0.5)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_poison_in_a_batch_of_sixteen_costs_its_own_cells(healed: RayBackend, monkeypatch: pytest.MonkeyPatch) -> None:
    noted = Mock(side_effect=healed.submit)
    monkeypatch.setattr(healed, "submit", noted)
    monkeypatch.setattr("drivecal.execution.scheduling.scheduler.MOST_LOSSES", LOSSES)
    for name in ("TARGET_SECONDS", "SHORTEST_SECONDS"):  # all at once
        monkeypatch.setattr(f"drivecal.execution.scheduling.batching.{name}", 600.0)
    pool = WorkPool(healed, MemoryLeases())
    setup = misbehaving_setup(function=POISON)
    begin = time.monotonic()
    pool.submit(Work(setup, [Cell(1, {"dose": 0.0})]), tag="test")  # tells what a cell costs, without which batches are of one
    drain(pool)
    deadline = max(SHORTEST_DEADLINE_SECONDS, PATIENCE_FACTOR * (time.monotonic() - begin))
    monkeypatch.setattr(healed, "_limits", replace(healed._limits, deadline_seconds=deadline))
    pool.submit(Work(setup, [Cell(100 + dose, {"dose": float(dose)}) for dose in range(POISON.DOSES)]), tag="test")
    completed = {item.result.id - 100: item for item in drain(pool)}
    sent = [[int(cell.parameters["dose"]) for cell in call.args[2].cells] for call in noted.call_args_list]
    assert max(len(batch) for batch in sent) == len(completed) == POISON.DOSES
    assert {dose: one.result.breakdown for dose, one in completed.items() if one.result.breakdown} == CAUSES
    times = {dose: sum(dose in batch for batch in sent) for dose in range(1, POISON.DOSES)}
    assert times[POISON.SEGFAULT] == LOSSES, times
    assert all(RUNS[dose] <= times[dose] <= RUNS[dose] + LOSSES_TOGETHER for dose in CAUSES), times
    assert max(times[dose] for dose in times if dose not in CAUSES) <= ATTEMPTS + LOSSES_TOGETHER
    assert all(len(completed[dose].result.detail or "") > 10 for dose in CAUSES)
    assert all(one.result.metrics == completed[0].result.metrics for dose, one in completed.items() if dose not in CAUSES)


@pytest.mark.faults
@pytest.mark.timeout(3600)
def test_poison_in_a_campaign_is_failed_with_its_cause_and_nothing_else_is(tmp_path: Path) -> None:
    document: dict[str, Any] = {
        "catalogue": ["S1"],
        "driving_function": "poisonous",
        "parameters": "all",
        "sensitivity": None,
        "reduction": {"mode": "exact"},
        "optimizer": {
            "kind": "genetic",
            "population": POISON.DOSES,
            "iterations": 1,
            "start_sets": [{"dose": dose} for dose in range(POISON.DOSES)],
        },
    }
    with coordinator(tmp_path, plugins=FOLDER) as server:
        server.start_ready()
        accepted = submit(server.url, {"poison": document})
        wait_until_ended(server, accepted, 600)
        campaign = present(server.answers(f"/api/v1/campaigns/{accepted.campaigns['poison']}"))
        rows = present(server.answers(f"/api/v1/campaigns/{accepted.campaigns['poison']}/evaluations"))
        with server.database.read() as connection:
            attempts = {row.id: row.attempts for row in connection.execute(select(evaluations.c.id, evaluations.c.attempts))}
            details = {row.id: row.detail for row in connection.execute(select(evaluations.c.id, evaluations.c.detail))}
        server.terminate()
    assert (campaign.json()["state"], campaign.json()["cells"]["failed"]) == ("succeeded", len(CAUSES))
    result = {int(row["dose"]): row for row in rows.json()["items"]}
    assert len(result) == POISON.DOSES
    assert {dose: row["failure"] for dose, row in result.items() if row["outcome"] == "failed"} == CAUSES
    assert {row["outcome"] for dose, row in result.items() if dose not in CAUSES} <= {"simulated", "reused", "repeated"}
    assert all(attempts[result[dose]["id"]] == ATTEMPTS for dose in CAUSES if RUNS[dose] == ATTEMPTS), attempts
    assert all(details[result[dose]["id"]] for dose in CAUSES), details
    assert max(attempts.values()) <= ATTEMPTS
