"""Exceptions, spoilt workers and refusals: no good cell pays for them."""

from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import pytest
from tests.support.fake_backend import Behaviour, FakeBackend
from tests.support.pooled import MemoryLeases, cells, drain
from tests.support.setups import bare as setup

from drivecal.contracts.work import Cell
from drivecal.execution.backend import Finished, Lost
from drivecal.execution.pool import WorkPool
from drivecal.execution.scheduling.in_flight import WITNESSES, Work
from drivecal.execution.scheduling.refusals import PATIENCE_WITH_REFUSALS, SHARE_OF_REFUSALS
from drivecal.execution.scheduling.worker_health import BATCHES_WITHOUT_RESULT


def test_an_exception_is_tried_on_another_worker(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    backend = FakeBackend()
    noted = Mock(side_effect=backend.submit)
    monkeypatch.setattr(backend, "submit", noted)
    pool = WorkPool(backend, MemoryLeases())
    behaviours = [Behaviour.WELL] * 300
    behaviours[149] = Behaviour.ERROR  # in a batch of many
    pool.submit(Work(setup(), cells(behaviours)), tag="campaign-7")
    [failed] = [entry for entry in drain(pool) if entry.result.breakdown is not None]
    assert (failed.result.id, failed.result.breakdown, failed.attempts) == (150, "error", WITNESSES)
    assert failed.result.detail == "ValueError: as asked for"
    sent = [
        (worker, [cell.id for cell in batch.cells]) for worker, _, batch, *_ in (call.args for call in noted.call_args_list)
    ]
    (first, _), (second, alone) = [(worker, ids) for worker, ids in sent if 150 in ids]
    assert first != second
    assert alone == [150]
    assert backend.replaced == []
    [(line, campaign)] = [(record.getMessage(), record.__dict__["campaign"]) for record in caplog.records]
    assert campaign == "campaign-7"
    assert line.startswith("cell 150 has no result after 2 attempts (error, at last on worker-")
    assert line.endswith("; failure 1 of this campaign): ValueError: as asked for")


def test_the_only_worker_is_replaced_once_before_its_exceptions_count() -> None:
    backend = FakeBackend(1)
    pool = WorkPool(backend, MemoryLeases())
    behaviours = [Behaviour.WELL] * 500
    for index in (3, 77, 200, 431):
        behaviours[index] = Behaviour.ERROR
    pool.submit(Work(setup(), cells(behaviours)), tag="a")
    failed = {entry.result.id: entry for entry in drain(pool) if entry.result.breakdown is not None}
    assert sorted(failed) == [4, 78, 201, 432]
    assert {entry.worker for entry in failed.values()} == {"worker-1.2"}
    assert backend.replaced == [("worker-1", None)]
    assert pool.trouble() is None


@pytest.mark.parametrize(("workers", "bad"), [(4, {1}), (4, {2, 3}), (4, {1, 2, 4}), (2, {2})])
def test_bad_workers_cost_no_good_cell(workers: int, bad: set[int]) -> None:
    backend = FakeBackend(workers, bad=bad)
    pool = WorkPool(backend, MemoryLeases())
    behaviours = [Behaviour.WELL] * 6000
    behaviours[1234] = Behaviour.ERROR
    pool.submit(Work(setup(), cells(behaviours)), tag="a")
    completed = drain(pool)
    assert len(completed) == 6000
    assert [entry.result.id for entry in completed if entry.result.breakdown is not None] == [1235]
    assert {worker.split("-")[1].split(".")[0] for worker, _ in backend.replaced} == {str(place) for place in bad}
    for _, fault in backend.replaced:
        count, words = (fault or "").split(maxsplit=1)
        assert int(count) in {BATCHES_WITHOUT_RESULT, BATCHES_WITHOUT_RESULT + 1}
        assert words.endswith(": SUMO is gone")
    spoilt = sum(count - 1 for count in backend.attempts.values())
    assert spoilt < 1500, "bad workers are given little"


def test_a_campaign_of_errors_comes_to_its_end_and_costs_few_workers_and_words(caplog: pytest.LogCaptureFixture) -> None:
    backend = FakeBackend(4)
    pool = WorkPool(backend, MemoryLeases())
    pool.submit(Work(setup(), cells([Behaviour.ERROR] * 1000)), tag="a")
    completed = drain(pool)
    assert len(completed) == 1000
    assert {(entry.result.breakdown, entry.attempts) for entry in completed} == {("error", WITNESSES)}
    assert len(backend.replaced) <= 8
    assert len(caplog.records) < 40


def test_a_campaign_whose_only_worker_starts_again_says_that_none_is_ready() -> None:
    backend = FakeBackend(1, {"S1": 1.0})
    pool = WorkPool(backend, MemoryLeases(), clock=lambda: backend.now)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 3)), tag="a")
    pool.poll(0.5)
    assert pool.waits("a") is None
    backend.kill(0)
    pool.poll(0.1)
    assert pool.waits("a") is not None
    drain(pool)
    assert pool.waits("a") is None


def test_cells_that_every_worker_refuses_wait_until_one_is_mended(caplog: pytest.LogCaptureFixture) -> None:
    backend = FakeBackend(2, refusing={1: "it has version 2", 2: "it has version 2"})
    pool = WorkPool(backend, MemoryLeases(), clock=lambda: backend.now)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 50)), tag="a")
    pool.submit(Work(setup("S2"), cells([Behaviour.WELL] * 50, first=101)), tag="b")
    troubles = set()
    while backend.now < 5 * PATIENCE_WITH_REFUSALS:
        assert pool.poll(1.0) == []
        if backend.now > 1.0:
            troubles.add(pool.trouble())
    assert pool.held("a") == 50
    assert troubles == {f"{number} workers refuse S1, S2: it has version 2" for number in (2, 3, 4)} & troubles
    assert "worker-1 refuses: it has version 2" in caplog.text
    assert pool.withdraw("b") == 0
    backend.refusing.clear()
    completed = drain(pool)
    assert len(completed) == 50
    assert {entry.attempts for entry in completed} == {1}
    assert pool.trouble() is None
    assert backend.now < 7 * PATIENCE_WITH_REFUSALS


class Failing(FakeBackend):
    """The first worker refuses from the third cell of a batch on."""

    def _end(self, worker: Any) -> list[Finished | Lost]:
        events = super()._end(worker)
        for number, event in enumerate(events):
            if worker.index == 1 and isinstance(event, Finished) and len(event.result.results) > 2:
                kept = event.result.results[:2]
                events[number] = replace(event, result=replace(event.result, results=kept, refusal="no licence"))
        return events


def test_a_refusal_in_the_middle_of_a_batch_keeps_the_results_before_it() -> None:
    backend = Failing(2)
    pool = WorkPool(backend, MemoryLeases(), clock=lambda: backend.now)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 1000)), tag="a")
    completed = drain(pool)
    assert sorted(entry.result.id for entry in completed) == list(range(1, 1001))
    assert {(entry.attempts, entry.result.breakdown) for entry in completed} == {(1, None)}
    by_first = [entry for entry in completed if entry.worker == "worker-1"]
    assert by_first
    assert all(backend.attempts[entry.result.id] == 1 for entry in by_first)


class Picky(FakeBackend):
    """Refuses S1, after a while."""

    def _begin(self, worker: Any) -> None:
        refuses = worker.calls[0].scenario == "S1"
        self.refusing = dict.fromkeys((1, 2), "no licence") if refuses else {}
        self.overhead_seconds = 30.0 if refuses else 0.001
        super()._begin(worker)


def test_busy_workers_lose_little_time_with_setups_that_they_refuse() -> None:
    backend = Picky(2, {"S2": 5.0})
    pool = WorkPool(backend, MemoryLeases(), clock=lambda: backend.now)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 10)), tag="a", priority=1)
    while "2 workers refuse" not in (pool.trouble() or ""):
        pool.poll(1.0)
    begin = backend.now
    pool.submit(Work(setup("S2"), cells([Behaviour.WELL] * 1000, first=101)), tag="b")
    while backend.now < begin + 30 / SHARE_OF_REFUSALS + 100:
        pool.poll(1.0)
    asked = [when for when, scenario, _ in backend.sizes if scenario == "S1" and when > begin + 60]
    assert 1 <= len(asked) <= 4
    assert asked[0] >= begin + 30 / SHARE_OF_REFUSALS - 60


def test_a_refusal_of_long_ago_does_not_replace_a_worker_at_another_one(caplog: pytest.LogCaptureFixture) -> None:
    backend = FakeBackend(1, refusing={1: "it has version 2"})
    pool = WorkPool(backend, MemoryLeases(), clock=lambda: backend.now)
    pool.submit(Work(setup(), cells([Behaviour.WELL])), tag="a")
    while pool.trouble() is None:
        pool.poll(1.0)
    pool.withdraw("a")
    while backend.now < 3 * PATIENCE_WITH_REFUSALS:
        pool.poll(1.0)
    backend.refusing[1] = "it has no model"
    begin = backend.now
    pool.submit(Work(setup("S2"), cells([Behaviour.WELL])), tag="b")
    while backend.now < begin + 0.9 * PATIENCE_WITH_REFUSALS:
        pool.poll(1.0)
    assert backend.replaced == []
    assert "worker-1 refuses: it has no model" in caplog.text
    while not backend.replaced:
        assert backend.now < begin + 2 * PATIENCE_WITH_REFUSALS
        pool.poll(1.0)


@pytest.mark.faults
@pytest.mark.parametrize("behaviour", [Behaviour.ERROR, Behaviour.CRASH])
@pytest.mark.parametrize("workers", [1, 2, 12])
def test_where_everything_fails_the_first_sets_fail_first_in_all_scenarios(workers: int, behaviour: Behaviour) -> None:
    backend = FakeBackend(workers)
    pool = WorkPool(backend, MemoryLeases(), clock=lambda: backend.now)
    work = [
        Work(
            setup(f"S{scenario}"),
            [Cell(100 * scenario + number, {"behaviour": behaviour, "x": number}) for number in range(50)],
        )
        for scenario in range(1, 7)
    ]
    pool.submit(*work, tag="a")
    completed: list[int] = []
    while len(completed) < 60:
        completed += [entry.result.id for entry in pool.poll(0.002)]
    assert {100 * scenario + number for scenario in range(1, 7) for number in range(5)} <= set(completed)
