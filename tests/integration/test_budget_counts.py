"""`runs` counts every start of the simulator, whatever breaks; without lost ones it keeps to the budget."""

from __future__ import annotations

import random
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from tests.support.cell_search import CellSearchPlugin
from tests.support.changes import install
from tests.support.computed import ComputedBackend, computed
from tests.support.runs import dispatcher, finish, get, request, run, submit

from drivecal.api.responses import campaign_answer
from drivecal.campaigns.resolve.bench import Bench
from drivecal.contracts.work import Batch, BatchResult, Cell, CellResult
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import Finished, Lost
from drivecal.storage import evaluations
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance.consistency import check_counters


@dataclass
class Breaking(ComputedBackend):
    """Counts runs as simulators would. Chance decides which batches are lost, refused or broken."""

    started: int = 0
    """Runs that simulators began."""
    unknown: int = 0
    """Planned runs of lost batches that did not begin: the dispatcher cannot know that."""
    kinds: list[str] = field(default_factory=list)

    def wait(self, timeout: float) -> list[Finished | Lost]:
        return [self._turn(event) for event in super().wait(timeout)]

    def kill(self) -> None:
        """The dispatcher dies, and its workers with it."""
        for _, batch in self._outstanding:
            self._begin_some(batch)
        self._outstanding.clear()

    def _begin_some(self, batch: Batch, *, tells: bool = False) -> Counter[int]:
        planned = [cell.id for cell in batch.cells for _ in range(1 + cell.check)]
        begun = planned[: self._random.randint(0, len(planned))]
        self.started += len(begun)
        self.unknown += 0 if tells else len(planned) - len(begun)
        return Counter(begun)

    def submit(self, worker: str, batch_id: int, batch: Batch, expected_seconds: float | None, *, alone: bool = False) -> None:
        super().submit(worker, batch_id, batch, expected_seconds, alone=alone)
        self._batches = getattr(self, "_batches", {}) | {batch_id: batch}

    def _turn(self, event: Finished | Lost) -> Finished | Lost:
        assert isinstance(event, Finished)
        batch: Batch = self._batches[event.batch_id]
        kind = self._random.choices(["well", "lost", "killed", "behind", "refused"], [20, 1, 2, 1, 1])[0]
        self.kinds.append(kind)
        if kind == "killed":
            starts = self._begin_some(batch, tells=True)
            return Lost(event.batch_id, self._name, Breakdown.CRASH, "it died", departed=True, starts=starts)
        if kind == "lost":
            self._begin_some(batch)
            return Lost(event.batch_id, self._name, Breakdown.CRASH, "it died")
        if kind == "behind":
            return Lost(event.batch_id, self._name, Breakdown.CRASH, "it died", 0.0, begun=False)
        if kind == "refused":
            done = event.result.results[: self._random.randint(0, len(batch.cells) - 1)]
            self.started += sum(result.starts for result in done)
            self.replace(self._name, None)
            return Finished(event.batch_id, BatchResult(event.result.worker, done, 0.01, "no licence"))
        self.started += sum(result.starts for result in event.result.results)
        return event


def breaking(cell: Cell, scenario: str, draws: random.Random) -> CellResult:
    """A result, or a crash or a hang of the simulator that its worker noticed."""
    if draws.random() < 0.1:
        kind = draws.choice([Breakdown.CRASH, Breakdown.HANG]).value
        return CellResult(cell.id, None, None, {}, None, 7.0, kind, "exit code 7", contained=True)
    result = computed(scenario, cell)
    repeats = True if cell.check else None
    return CellResult(
        result.id, result.rating, result.score, result.metrics, result.failure, 7.0, repeats=repeats, starts=1 + cell.check
    )


@pytest.mark.slow(*(str(number) for number in range(10) if number != 3))
@pytest.mark.faults(*map(str, range(10, 50)))
@pytest.mark.parametrize("seed", range(50))
def test_runs_are_what_simulators_count(database: Database, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    draws = random.Random(seed)
    install(monkeypatch, "optimizer", CellSearchPlugin())
    monkeypatch.setattr(Bench, "repeated_share", 0.1)
    optimizer: dict[str, Any] = draws.choice([{"kind": "cell_search"}, {"kind": "genetic", "population": 12}])
    budget = draws.randint(30, 90)
    spec: dict[str, Any] = {"catalogue": ["S1", "S2", "S3"], "reduction": {"mode": "exact"}, "optimizer": optimizer}
    campaign = submit(database, budget={"simulations": budget}, **spec)
    backend = Breaking(seed, lambda scenario, cell: breaking(cell, scenario, draws))
    for _ in range(2_000):
        working = dispatcher(database, backend)
        with suppress(StopIteration):
            for _ in range(draws.randint(4, 200)):
                working.step()
                if get(database, campaign).state.ended:
                    raise StopIteration
        if (ended := get(database, campaign)).state.ended:
            break
        backend.kill()
    with database.read() as connection:
        runs = evaluations.runs_by_purpose(connection, ended.sequence)
        assert list(check_counters(connection)) == []
    assert sum(runs.values()) == ended.cells.runs == backend.started + backend.unknown
    assert runs["further"] > 0
    assert budget * 0.5 < campaign_answer(ended, ended.created_at, None).spent.simulations <= budget, ended.error


def test_a_campaign_that_shares_runs_with_another_uses_its_whole_budget(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run that was kept for a second one of a shared cell is free again."""
    monkeypatch.setattr(Bench, "repeated_share", 0.2)
    backend = ComputedBackend(
        answer=lambda scenario, cell: replace(
            computed(scenario, cell), repeats=True if cell.check else None, starts=1 + cell.check
        )
    )
    spec: dict[str, Any] = {"catalogue": ["S1", "S2"], "reduction": {"mode": "exact"}, "budget": {"simulations": 100}}
    both = [submit(database, optimizer={"kind": "random", "population": 10, "seed": 1}, **spec) for _ in range(2)]
    working = dispatcher(database, backend)
    ended = [finish(database, campaign, working) for campaign in both]
    assert all(each.cells.runs in {99, 100} for each in ended), "no further set fits"


@pytest.mark.parametrize("kills", [False, True])
def test_a_crash_leaves_the_second_run_of_its_cell_to_the_budget(
    database: Database, monkeypatch: pytest.MonkeyPatch, kills: bool
) -> None:
    monkeypatch.setattr(Bench, "repeated_share", 0.3)
    crashed = set[int]()

    def crashing(scenario: str, cell: Cell) -> CellResult:
        if cell.check and cell.id not in crashed and len(crashed) < 4:
            crashed.add(cell.id)
            return CellResult(cell.id, None, None, {}, None, 7.0, Breakdown.CRASH.value, "exit code 7", contained=True)
        return replace(computed(scenario, cell), repeats=True if cell.check else None, starts=1 + cell.check)

    backend = ComputedBackend(answer=crashing)
    optimizer = {"kind": "random", "population": 2}
    spec: dict[str, Any] = {"catalogue": ["S1", "S2"], "reduction": {"mode": "exact"}, "optimizer": optimizer}
    campaign, working, steps = submit(database, budget={"simulations": 40}, **spec), dispatcher(database, backend), 0
    while not get(database, campaign).state.ended:
        working.step()
        steps += 1
        assert steps < 20_000
        if kills and steps % 50 == 0:
            backend.close()
            working = dispatcher(database, backend)
    cells = get(database, campaign).cells
    assert len(crashed) == 4
    assert cells.runs - cells.lost in {39, 40}, "no further set fits"


def test_runs_under_way_count_whoever_answers_their_cells(database: Database) -> None:
    """Another campaign stores the same runs while they are at workers, and a new dispatcher or the same one looks again."""
    spec: dict[str, Any] = {
        "catalogue": ["S1", "S2"],
        "optimizer": {"kind": "random", "population": 6},
        "budget": {"simulations": 12},
    }
    backend = ComputedBackend(held=True)
    campaign, working = submit(database, reduction={"mode": "exact"}, **spec), dispatcher(database, backend)
    while len(backend.sent) < 8:  # places of the backend
        working.step()
    other = ComputedBackend()
    working._pool._backend = other
    finish(database, submit(database, reduction={"mode": "off"}, priority=5, **spec), working)
    request(database, campaign, "pause")
    working.step()
    request(database, campaign, "resume")
    cells = finish(database, campaign, working).cells
    assert cells.runs - cells.lost <= 12


def test_a_search_of_an_exhausted_space_ends_before_its_budget(database: Database) -> None:
    space = [{"name": "P1", "lower": 0, "upper": 1, "step": 0.1}]
    optimizer = {"kind": "genetic", "population": 8}
    fixed = {f"P{number}": 0.5 for number in range(2, 12)}
    spec: dict[str, Any] = {"catalogue": ["S1"], "parameters": space, "fixed": fixed, "optimizer": optimizer}
    ended = run(database, submit(database, budget={"simulations": 100}, **spec))
    assert ended.search is not None
    assert (ended.search.ended_by, ended.cells.runs <= 11) == ("stagnation", True)
