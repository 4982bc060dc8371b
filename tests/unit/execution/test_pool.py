"""The pool on a backend whose time is computed: attempts, sizes of batches, priorities, withdrawal."""

from collections import Counter

import pytest
from tests.support.fake_backend import Behaviour, FakeBackend
from tests.support.pooled import MemoryLeases, cells, drain
from tests.support.setups import bare as setup

from drivecal.contracts.work import Batch, BatchResult, Cell
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import Finished, Lost
from drivecal.execution.pool import WorkPool, _unstarted
from drivecal.execution.scheduling.in_flight import Dispatch, RunBudget, Work
from drivecal.execution.scheduling.scheduler import ATTEMPTS


def test_a_poison_cell_costs_three_attempts_and_leases_and_none_of_its_neighbours() -> None:
    for poison, cause in ((Behaviour.CRASH, "crash"), (Behaviour.HANG, "hang"), (Behaviour.MEMORY, "memory")):
        backend, leases = FakeBackend(), MemoryLeases()
        pool = WorkPool(backend, leases)
        pool.submit(Work(setup(), cells([Behaviour.WELL] * 300)), tag="a")
        pool.submit(Work(setup("S2"), cells([Behaviour.WELL] * 20 + [poison] + [Behaviour.WELL] * 279, first=1001)), tag="a")
        completed = drain(pool)
        assert len(completed) == 600
        [failed] = [entry for entry in completed if entry.result.breakdown is not None]
        assert (failed.result.id, failed.result.breakdown, failed.attempts) == (1021, cause, ATTEMPTS)
        assert (backend.attempts[1021], failed.lease, leases.breakdowns[1021]) == (ATTEMPTS, ATTEMPTS, ATTEMPTS - 1)
        assert max(count for cell, count in backend.attempts.items() if cell != 1021) <= ATTEMPTS


def test_cells_that_a_lost_worker_had_not_begun_keep_their_attempts_and_the_budget() -> None:
    backend, leases = FakeBackend(1), MemoryLeases()
    budget = RunBudget(left=3.0, taken={101: 0, 102: 0})  # two started cells, and the last one again
    pool = WorkPool(backend, leases)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 100)), tag="a")
    drain(pool)
    pool.submit(Work(setup(), cells([Behaviour.WELL, Behaviour.HANG, *[Behaviour.WELL] * 98], 101)), tag="b", budget=budget)
    failed = [(entry.result.id, entry.attempts) for entry in drain(pool) if entry.result.breakdown is not None]
    assert (failed, budget.left, backend.attempts) == ([(102, ATTEMPTS)], 0, leases.starts)


def test_starts_that_did_not_happen_are_known_by_cell() -> None:
    sent = Dispatch("worker-1", 1, Batch(setup(), tuple(cells([Behaviour.WELL] * 3))), None, alone=False, breakdowns={})
    lost = Lost(1, "worker-1", Breakdown.HANG, "it hung", starts={1: 1})
    busy = Finished(1, BatchResult("worker-1", (), 0.1, busy="no licence"))
    assert _unstarted(sent, lost) == _unstarted(sent, busy) == {1: 0, 2: 1, 3: 1}


def test_batches_take_half_a_second_whatever_a_cell_costs() -> None:
    backend = FakeBackend(seconds_per_cell={"S1": 0.007, "S2": 0.1, "S3": 3.0, "S4": 0.0001})
    pool = WorkPool(backend, MemoryLeases())
    for index, scenario in enumerate(("S1", "S2", "S3", "S4")):
        count = 40 if scenario == "S3" else 1000
        pool.submit(Work(setup(scenario), cells([Behaviour.WELL] * count, first=1 + 10_000 * index)), tag="a")
    drain(pool)
    typical = {
        scenario: Counter(size for _, name, size in backend.sizes if name == scenario).most_common(1)[0][0]
        for scenario in ("S1", "S2", "S3")
    }
    assert typical["S1"] in range(60, 81)
    assert typical["S2"] == 4
    assert typical["S3"] == 1
    assert max(size for _, name, size in backend.sizes if name == "S4") == 128
    assert next(size for _, name, size in backend.sizes if name == "S1") == 1  # a probe: nothing was known


def test_the_setups_of_a_generation_are_spread_over_the_workers() -> None:
    backend = FakeBackend(3)
    pool = WorkPool(backend, MemoryLeases())
    for generation in range(3):
        begun = len(backend.sizes)
        works = [
            Work(setup(scenario), cells([Behaviour.WELL] * 300, first=1 + 1000 * (3 * generation + index)))
            for index, scenario in enumerate(("S1", "S2", "S3"))
        ]
        pool.submit(*works, tag="a")
        assert {scenario for _, scenario, _ in backend.sizes[begun : begun + 3]} == {"S1", "S2", "S3"}
        drain(pool)


def test_a_cell_cannot_be_in_flight_twice() -> None:
    pool = WorkPool(FakeBackend(), leases := MemoryLeases())
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 3)), tag="a")
    with pytest.raises(ValueError, match=r"\[1\]"):
        pool.submit(Work(setup("S2"), cells([Behaviour.WELL])), tag="a")
    with pytest.raises(ValueError, match=r"\[9, 9\]"):
        pool.submit(Work(setup(), [Cell(9, {}), Cell(9, {})]), tag="a")
    assert len(drain(pool)) == 3
    leases.held.clear()
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 3)), tag="a")
    assert len(drain(pool)) == 3


def test_a_batch_that_comes_back_again_changes_nothing() -> None:
    pool = WorkPool(backend := FakeBackend(), MemoryLeases())
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 3)), tag="a")
    assert len(drain(pool)) == 3
    backend.repeat(0)
    assert pool.poll(0.0) == []
