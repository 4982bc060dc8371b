"""The pool sends nothing without a lease, and keeps none that it does not need."""

import random

import pytest
from tests.support.fake_backend import Behaviour, FakeBackend
from tests.support.pooled import MemoryLeases, cells, drain
from tests.support.setups import bare as setup

from drivecal.domain.errors import UnavailableError
from drivecal.execution.pool import WorkPool
from drivecal.execution.scheduling.in_flight import Work


def test_one_exchange_leases_all_that_is_sent_at_a_time() -> None:
    leases = MemoryLeases()
    pool = WorkPool(FakeBackend(8), leases)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 10)), tag="a")
    assert [len(wanted) for _, wanted in leases.exchanges] == [8, 2]


def test_refused_cells_give_their_leases_back_without_a_breakdown() -> None:
    leases = MemoryLeases()
    backend = FakeBackend(2, refusing={1: "it has another version"})
    pool = WorkPool(backend, leases)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 50)), tag="a")
    assert len(drain(pool)) == 50
    assert max(leases.numbers.values()) > 1
    assert set(leases.breakdowns.values()) == {0}


@pytest.mark.parametrize("seed", range(20))
def test_a_database_that_comes_and_goes_costs_no_result_and_no_attempt(seed: int) -> None:
    draw = random.Random(seed)
    leases = MemoryLeases(fails=draw.choices(["", "before", "after"], k=200))
    backend = FakeBackend(3)
    pool = WorkPool(backend, leases)
    behaviours = [Behaviour.WELL] * 200 + [Behaviour.CRASH]
    draw.shuffle(behaviours)
    for tag, first in (("a", 1), ("b", 1001)):
        try:
            pool.submit(Work(setup(), cells(behaviours, first)), tag=tag)
        except UnavailableError:
            continue
    completed = drain(pool)
    assert len({element.result.id for element in completed}) == len(completed) == 402
    assert sum(member.result.breakdown is not None for member in completed) == 2
    assert all(item.lease == leases.numbers[item.result.id] for item in completed)
    assert {entry.result.id for entry in completed} == leases.held.keys()


def test_cells_that_are_not_granted_are_forgotten_and_the_others_sent() -> None:
    leases = MemoryLeases(denied={3, 7})
    backend = FakeBackend()
    pool = WorkPool(backend, leases)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 10)), tag="a")
    assert sorted(item.result.id for item in drain(pool)) == [1, 2, 4, 5, 6, 8, 9, 10]
    assert backend.attempts.keys().isdisjoint({3, 7})


def test_results_that_nobody_writes_down_give_their_leases_back() -> None:
    leases = MemoryLeases()
    pool = WorkPool(FakeBackend(), leases)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 5)), tag="a")
    pool.give_back(drain(pool))
    pool.poll(0.0)
    assert leases.held == {}
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 5)), tag="a")
    assert {item.lease for item in drain(pool)} == {2}


def test_a_withdrawn_cell_whose_worker_dies_is_free_again() -> None:
    leases = MemoryLeases()
    backend = FakeBackend()
    pool = WorkPool(backend, leases)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 10)), tag="a")
    assert pool.withdraw("a") > 0
    backend.kill(0)
    backend.kill(1)
    assert drain(pool) == []
    assert leases.held == {}
    assert set(leases.breakdowns.values()) == {0}
