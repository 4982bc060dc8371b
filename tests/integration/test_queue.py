"""The durable queue: after every death of a process each cell has one answer, and campaigns end as without deaths."""

import random
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import mkdtemp
from types import SimpleNamespace
from typing import Any

import pytest
from sqlalchemy import func, select, text
from tests.support.cell_search import CellSearchPlugin
from tests.support.computed import ComputedBackend, computed
from tests.support.databases import migrated
from tests.support.deaths import Killed, at, mortal
from tests.support.effort import tries
from tests.support.runs import dispatcher, everything, finish, get, post_map, submit
from tests.support.server import new_database

from drivecal.contracts.work import Batch, Cell, CellResult
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import SupersededError, UnavailableError
from drivecal.domain.evaluations import Outcome
from drivecal.execution.backend import Finished, Lost
from drivecal.execution.measures import MEASURES
from drivecal.execution.scheduling.scheduler import ATTEMPTS
from drivecal.plugins import registry
from drivecal.storage import campaigns, leases
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import evaluations as evaluations_table
from drivecal.storage.engine.tables import leases as leases_table
from drivecal.storage.engine.tables import runs

TINY: dict[str, Any] = {
    "optimizer": {"kind": "genetic", "population": 16, "iterations": 4, "seed": 3},
    "catalogue": ["S1", "S2"],
}
BY_CELL: dict[str, Any] = {"optimizer": {"kind": "cell_search"}, "budget": {"simulations": 60}, "catalogue": ["S1", "S2"]}
BOLD_MAP = {
    scenario: {f"P{i}": {"influential": False} for i in range(1, 12) if i not in left}
    for scenario, left in {"S1": (1, 2), "S2": (3, 4)}.items()
}
"""It claims so much that even a small campaign reuses, its audits find something, and its best set seems better than it is."""


@pytest.fixture(params=["sqlite", "postgresql"])
def databases(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[], Database]:
    """Makes new databases of a kind."""
    return lambda: migrated(new_database(request, request.param, Path(mkdtemp(dir=tmp_path))))


class MortalBackend(ComputedBackend):
    """Dies between leasing and sending, and between a result and its record."""

    dies: Callable[[], bool]

    def submit(self, worker: str, batch_id: int, batch: Batch, expected_seconds: float | None, *, alone: bool = False) -> None:
        if self.dies():
            raise Killed("between lease and send")
        super().submit(worker, batch_id, batch, expected_seconds, alone=alone)

    def wait(self, timeout: float) -> list[Finished | Lost]:
        events = super().wait(timeout)
        if events and self.dies():
            raise Killed("between result and record")
        return events


def late_results() -> float:
    (found,) = (samples[0][2] for name, _, _, samples in MEASURES.snapshot() if name == "drivecal_late_results")
    return float(found)


def leased(database: Database) -> int:
    with database.read() as connection:
        return connection.scalar(select(func.count()).select_from(leases_table)) or 0


@pytest.mark.slow("postgresql", "sqlite-0-False")
@pytest.mark.parametrize("by_cell", [False, True])
@pytest.mark.parametrize("seed", range(tries(1, 3)))
def test_a_dispatcher_killed_at_any_moment_changes_no_result_and_answers_nothing_twice(
    databases: Callable[[], Database], seed: int, *, by_cell: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if by_cell:
        monkeypatch.setattr(registry, "optimizer", lambda _: CellSearchPlugin())
    search = BY_CELL if by_cell else TINY
    draw = random.Random(seed)
    result, deaths = [], Counter[str]()
    for kills in (False, True):
        database = databases()
        reduction = {"audit": 0.2, "confirm": 20}
        campaign = submit(database, stored_map=post_map(database, BOLD_MAP), reduction=reduction, **search)
        if not kills:
            finish(database, campaign, dispatcher(database))
        while not get(database, campaign).state.ended:
            backend = MortalBackend(draw.randrange(99))
            backend.dies = at(draw.randrange(1, draw.choice([40, 90])))
            try:
                finish(database, campaign, mortal(database, backend.dies, backend))
            except Killed as moment:
                deaths[str(moment)] += 1
        assert leased(database) == 0
        with database.read() as connection:
            simulated = connection.scalar(
                select(func.count()).where(evaluations_table.c.worker.is_not(None), evaluations_table.c.outcome == "simulated")
            )
            stored = connection.scalar(select(func.count()).select_from(runs))
        assert simulated == stored == get(database, campaign).cells.simulated
        result.append(everything(database, campaign))
    assert result[0] == result[1]
    assert sum(deaths.values()) > 3
    assert len(deaths) > 1
    assert result[0][2].reused > 0
    assert result[0][0][-1][0] >= TINY["optimizer"]["iterations"], "the best set was confirmed"


@pytest.mark.slow("postgresql")
def test_a_dispatcher_that_comes_back_after_another_was_elected_writes_nothing(databases: Callable[[], Database]) -> None:
    database = databases()
    campaign = submit(database, **TINY)
    asleep = dispatcher(database)
    while not leased(database):  # the search may be computed first
        asleep.step()
    awake = dispatcher(database)
    awake.step()
    before = get(database, campaign)
    for _ in range(3):  # its look, its progress, its results, its leases: whatever it comes to first
        with pytest.raises(SupersededError):
            asleep.step()
        with pytest.raises(SupersededError):
            asleep._move(next(iter(asleep._active.values())))
    assert get(database, campaign) == before
    assert finish(database, campaign, awake).state is CampaignState.SUCCEEDED


@dataclass
class Poisoned:
    """Cells that no worker survives; counts how often the first of them was tried."""

    first: int | None = None
    tried: int = 0

    def __call__(self, scenario: str, cell: Cell) -> CellResult:
        if scenario == "S2" and cell.parameters["P1"] == 1.0:
            self.first = cell.id if self.first is None else self.first
            self.tried += cell.id == self.first
            return CellResult(cell.id, None, None, {}, None, 1.0, "crash", "segmentation fault\0\ud800")
        return computed(scenario, cell)


@pytest.mark.slow("postgresql")
def test_a_poison_cell_has_three_attempts_however_many_dispatchers_it_sees(databases: Callable[[], Database]) -> None:
    database = databases()
    campaign = submit(database, **TINY)
    poison = Poisoned()
    for life in range(ATTEMPTS - 1):
        working = dispatcher(database, ComputedBackend(life, poison))
        while poison.tried == life:
            working.step()
    ended = finish(database, campaign, dispatcher(database, ComputedBackend(answer=poison)))
    assert ended.state is CampaignState.SUCCEEDED
    assert poison.tried == ATTEMPTS
    with database.read() as connection:
        [row] = connection.execute(select(evaluations_table).where(evaluations_table.c.id == poison.first))
    assert (row.outcome, row.failure, row.attempts, row.score) == (Outcome.FAILED, "crash", ATTEMPTS, None)
    assert row.detail == "segmentation fault\ufffd?"


def test_a_result_whose_lease_was_lost_changes_nothing_and_the_cell_is_simulated_again(database: Database) -> None:
    campaign = submit(database, **TINY)
    working = dispatcher(database)
    while not leased(database):
        working.step()
    with database.transaction() as connection:  # as another holder would
        ids = list(connection.scalars(select(leases_table.c.evaluation_id)))
        leases.give_back(connection, dict.fromkeys(ids, 0))
        taken = leases.take(connection, dict.fromkeys(ids, 0))
        leases.give_back(connection, dict.fromkeys(ids, 0))
    assert set(taken.values()) == {2}
    late = late_results()
    ended = finish(database, campaign, working)
    assert late_results() - late == len(ids)
    assert ended.state is CampaignState.SUCCEEDED
    assert leased(database) == 0


def test_an_answer_of_another_process_is_taken_over(database: Database) -> None:
    campaign = submit(database, **TINY)
    backend = ComputedBackend(held=True)
    working = dispatcher(database, backend)
    for _ in range(4):
        working.step()
    with database.transaction() as connection:
        last = text("UPDATE evaluations SET outcome = 'failed', failure = 'crash' WHERE id = (SELECT max(id) FROM evaluations)")
        connection.execute(last)
    backend.held = False
    ended = finish(database, campaign, working)
    assert ended.state is CampaignState.SUCCEEDED


def _states(database: Database, submitted: Sequence[StoredCampaign]) -> list[str]:
    return [get(database, campaign).state.value for campaign in submitted]


def test_campaigns_start_by_priority_then_age_and_only_so_many_run(database: Database) -> None:
    submitted = []
    for priority in (0, 0, 5, 9):
        specification = submit(database, **TINY).spec
        with database.transaction() as connection:
            submitted.append(campaigns.insert(connection, name="test", spec=specification, priority=priority))
    with database.transaction() as connection:
        connection.execute(
            text("UPDATE campaigns SET state = 'cancelled', ended_at = created_at WHERE priority = 0 AND id NOT IN (:a, :b)"),
            {"a": submitted[0].id, "b": submitted[1].id},
        )
    working = dispatcher(database, ComputedBackend(held=True), running_campaigns=2)
    for _ in range(3):
        working.step()
    assert _states(database, submitted) == ["queued", "queued", "running", "running"]
    with database.transaction() as connection:
        campaigns.request_action(connection, submitted[3].id, "pause")
        connection.execute(
            text("UPDATE campaigns SET state = 'succeeded', ended_at = created_at WHERE id = :id"), {"id": submitted[2].id}
        )
    fresh = dispatcher(database, ComputedBackend(held=True), running_campaigns=2)
    for _ in range(5):
        fresh.step()
    assert _states(database, submitted) == ["running", "running", "succeeded", "paused"]
    with database.transaction() as connection:
        campaigns.request_action(connection, submitted[3].id, "resume")
    for _ in range(3):
        fresh.step()
    assert _states(database, submitted)[3] == "paused", "there is no room for it yet"
    with database.transaction() as connection:
        campaigns.explain(connection, fresh._places())
    assert "place 1 of 1 in the queue with priority 9" in (get(database, submitted[3]).waiting or "")
    assert get(database, submitted[0]).waiting is None
    fresh._in_line = [replace(fresh._in_line[0], sequence=number) for number in range(1, 301)]
    long = fresh._places()
    fresh._in_line.pop(0)
    assert {number for number, reason in fresh._places().items() if reason != long[number]} == set(range(2, 102))
    fresh._active.clear()  # they ended since the line was drawn up: no other program keeps its places
    assert fresh._places()[2].split()[0] == "2"
    with database.transaction() as connection:
        submitted.append(campaigns.insert(connection, name="urgent", spec=submitted[0].spec, priority=9))
    for most in (1, 2):
        more = dispatcher(database, ComputedBackend(held=True), running_campaigns=most)
        for _ in range(3):
            more.step()
        assert _states(database, submitted)[:2] == ["running", "running"], "they ran before the restart"
        assert _states(database, submitted)[4] == "queued", "it takes no place of theirs"


@pytest.mark.slow("postgresql")
def test_a_campaign_whose_rows_are_damaged_fails_alone(databases: Callable[[], Database]) -> None:
    database = databases()
    before, during, sound = (submit(database, **TINY) for _ in range(3))
    with database.transaction() as connection:
        campaigns.start(connection, during.sequence)
        counts = """SELECT sequence, 2, '{"proposed": "many"}' FROM campaigns WHERE sequence < :sequence"""
        damage = text(f"INSERT INTO campaign_stages {counts}")
        connection.execute(damage, {"sequence": sound.sequence})
    assert finish(database, sound, dispatcher(database)).state is CampaignState.SUCCEEDED
    with database.read() as connection:
        rows = connection.execute(
            text("SELECT state, error FROM campaigns WHERE sequence < :sequence"), {"sequence": sound.sequence}
        )
        result = {(row.state, (row.error or "").partition(":")[0]) for row in rows}
    assert result == {("failed", "internal error")}
    assert before.sequence < sound.sequence


def _both(database: Database, **changes: Any) -> tuple[ComputedBackend, list[StoredCampaign]]:
    both = [submit(database, **TINY, **changes) for _ in range(2)]
    backend = ComputedBackend()
    working = dispatcher(database, backend)
    return backend, [finish(database, item, working) for item in both]


def test_identical_cells_of_parallel_campaigns_are_simulated_once_and_counted_once(tmp_path: Path) -> None:
    result: Mapping[str, Any] = {}
    for name in ("alone", "both"):
        database = migrated(f"sqlite:///{tmp_path / name}.db")
        if name == "alone":
            campaign = submit(database, **TINY)
            finish(database, campaign, dispatcher(database))
            result = {"cells": everything(database, campaign)[0], "seconds": get(database, campaign).simulating_seconds}
            continue
        backend, ended = _both(database)
        assert len(backend.sent) == len(set(backend.sent))
        for item in ended:
            assert everything(database, item)[0] == result["cells"]
        assert sum(entry.simulating_seconds for entry in ended) == pytest.approx(result["seconds"])
        with database.read() as connection:
            row = evaluations_table.c
            shared = select(func.count()).where(row.outcome == "simulated", row.worker.is_(None), row.milliseconds.is_(None))
            assert connection.scalar(shared) == sum(element.cells.simulated for element in ended) - len(backend.sent)


def test_without_reduction_every_campaign_simulates_its_own_cells(database: Database) -> None:
    backend, ended = _both(database, reduction={"mode": "off"})
    assert len(backend.sent) == sum(campaign.cells.simulated for campaign in ended) == 2 * ended[0].cells.simulated
    assert all(campaign.cells.unrepeatable == 0 for campaign in ended)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(tries(1, 5)))
def test_hiccups_change_no_result_and_simulate_nothing_twice(tmp_path: Path, seed: int) -> None:
    ended, sent = [], []
    for share in (0.0, 0.1):
        database = migrated(f"sqlite:///{tmp_path / f'{share}.db'}")
        campaign = submit(
            database,
            stored_map=post_map(database, BOLD_MAP),
            catalogue=["S1", "S2"],
            optimizer={"kind": "genetic", "population": 8, "iterations": 2, "seed": 3},
            reduction={"audit": 0.2, "confirm": 20},
        )
        draw, failures, backend = random.Random(seed), list[bool](), ComputedBackend(seed)

        def fails(draw: random.Random = draw, share: float = share, failures: list[bool] = failures) -> bool:
            failures.append(draw.random() < share)
            return failures[-1]

        working = mortal(database, fails, backend, UnavailableError)
        until_the_end: Any = SimpleNamespace(
            is_set=lambda database=database, campaign=campaign: get(database, campaign).state.ended, wait=lambda _: None
        )
        working.run(until_the_end)
        assert any(failures) == (share > 0)
        ended.append(everything(database, campaign))
        sent.append(Counter(backend.sent))
    assert ended[0] == ended[1]
    assert sent[0] == sent[1]
