"""Workers on one node that own the same setup get each other's recorded runs, each once, and no other worker does."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.support.plant import answers, send, setup

from drivecal.contracts.work import Batch, Cell, RecordedRun
from drivecal.domain.evaluations import Rating, RunResult
from drivecal.execution.scheduling import shared_runs
from drivecal.execution.scheduling.affinity import SetupAffinity
from drivecal.execution.scheduling.batching import BatchPolicy
from drivecal.execution.scheduling.dispatches import Dispatch
from drivecal.execution.scheduling.in_flight import Work
from drivecal.execution.scheduling.scheduler import Scheduler
from drivecal.execution.scheduling.shared_runs import SharedRuns

KEY = setup().key
NODES = {"one": "here", "two": "here", "three": "here", "far": "elsewhere"}


def run(number: int, size: int = 8) -> RecordedRun:
    return RecordedRun(number, RunResult(Rating(5.0, 5), {}), (1.0,), (0,), bytes(size))


def shared(*owners: str) -> SharedRuns:
    affinity = SetupAffinity()
    for owner in owners:
        affinity.load(owner, KEY, 10)
    runs = SharedRuns(affinity)
    runs.meet(NODES)
    return runs


def numbers(runs: tuple[RecordedRun, ...]) -> list[int]:
    return [run.number for run in runs]


def test_every_other_owner_on_the_node_gets_a_run_once() -> None:
    runs = shared("one", "two", "far")
    runs.take("one", KEY, [run(1), run(2)])
    runs.take("three", KEY, [run(3)])  # no owner: it gives and does not get
    runs.take("far", KEY, [run(4)])
    assert numbers(runs.give("two", KEY)) == [3, 2, 1]
    assert numbers(runs.give("one", KEY)) == [3]
    for worker in NODES:
        assert runs.give(worker, KEY) == ()


def test_the_oldest_runs_are_dropped_above_the_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_runs, "MOST_BYTES", 100)
    monkeypatch.setattr(shared_runs, "MOST_BYTES_IN_ALL", 100)
    runs = shared("one", "two")
    runs.take("one", KEY, [run(number, 30) for number in range(5)])
    runs.take("two", KEY, [run(9, 30)])
    assert numbers(runs.give("two", KEY)) == []
    assert numbers(runs.give("one", KEY)) == [9]
    runs.take("one", KEY, [run(number, 30) for number in range(5)])
    assert numbers(runs.give("two", KEY)) == [4, 3, 2]


def test_a_batch_carries_the_newest_runs_that_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_runs, "MOST_SENT_IN_ALL", 3 * len(NODES) * 70)
    runs = shared("one", "two")
    assert runs.room == 70
    runs.take("one", KEY, [run(number, 30) for number in range(5)])
    assert [numbers(runs.give("two", KEY)) for _ in range(4)] == [[4, 3], [2, 1], [0], []]


def test_what_is_on_its_way_to_a_worker_that_is_gone_is_dropped() -> None:
    runs = shared("one", "two")
    runs.take("one", KEY, [run(1)])
    runs.meet({"one": "here"})
    runs.meet(NODES)
    assert runs.give("two", KEY) == ()


def test_workers_of_unknown_nodes_share_nothing() -> None:
    runs = shared("one", "two")
    runs.meet({})
    assert runs.readers("one", KEY) == []


def scheduled() -> Scheduler:
    """A scheduler with a generation of S1, at which two workers of one node and one of another node worked."""
    made = Scheduler(BatchPolicy())
    made.meet(list(NODES), NODES)
    made.add(Work(setup(), [Cell(number, {"P1": float(number)}, certify=True) for number in range(1, 200)]), "a")
    for _ in range(2):  # one cell each at first, because its cost is unknown
        for dispatch in [send(made, worker) for worker in ("one", "two", "far")]:
            finish(made, dispatch)
    return made


def finish(scheduler: Scheduler, dispatch: Dispatch, *runs: RecordedRun, agrees: bool | None = None) -> None:
    answered = answers(dispatch, seconds=0.05 * len(dispatch.batch.cells))
    results = tuple(replace(result, agrees=agrees) for result in answered.results)
    result = replace(answered, learned=runs, results=results)
    scheduler.note_refutation(dispatch.batch_id, result)
    scheduler.finished(dispatch.batch_id, result)


def test_the_next_batch_of_another_owner_carries_the_runs() -> None:
    scheduler = scheduled()
    first, second = send(scheduler, "one"), send(scheduler, "two")
    finish(scheduler, second)
    finish(scheduler, first, run(first.batch.cells[0].id))
    batches = {worker: send(scheduler, worker).batch for worker in ("one", "two", "far")}
    assert {worker: numbers(batch.known) for worker, batch in batches.items()} == {
        "one": [],
        "two": [first.batch.cells[0].id],
        "far": [],
    }
    assert first.batch.share
    assert [bool(batch.share) for batch in batches.values()] == [True, True, False]


def test_runs_of_a_setup_with_a_contradicted_certificate_are_not_shared() -> None:
    scheduler = scheduled()
    first, second = send(scheduler, "one"), send(scheduler, "two")
    finish(scheduler, first, run(1))
    finish(scheduler, second, run(2), agrees=False)
    for worker in ("one", "two"):
        batch = send(scheduler, worker).batch
        assert batch == Batch(batch.setup, batch.cells)
        assert not any(cell.certify for cell in batch.cells)


def test_cells_without_certificates_share_nothing() -> None:
    scheduler = scheduled()
    scheduler.withdraw("a")
    scheduler.add(Work(setup(), [Cell(number, {"P1": float(number)}) for number in range(500, 520)]), "b")
    assert not send(scheduler, "one").batch.share
