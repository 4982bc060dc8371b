"""Licences are counted, never more at once than there are, and busy simulators and lost workers take no attempt from cells."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.support.fake_backend import Behaviour, FakeBackend
from tests.support.plant import V, W, answers, cells, ids, send
from tests.support.pooled import MemoryLeases, drain
from tests.support.pooled import cells as behaving
from tests.support.setups import bare

from drivecal.contracts.work import BatchResult, SetupRequest
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import Lost
from drivecal.execution.pool import WorkPool
from drivecal.execution.scheduling.in_flight import Completed, Work
from drivecal.execution.scheduling.resources import KEPT_SECONDS, Resources
from drivecal.execution.scheduling.scheduler import MOST_LOSSES, Scheduler

LICENCES = {"carmaker": 2}


def licensed(scenario: str = "S1", count: int = 1, *, keeps: bool = False) -> SetupRequest:
    """Returns a setup that needs licences. `keeps`: its program stays open between its runs."""
    return replace(bare(scenario), resources={"carmaker": count}, renews=not keeps, simulator={"timeout": 60.0})


def scheduler(total: dict[str, int], **options: float) -> Scheduler:
    made = Scheduler(Resources(total, **options))
    made.meet([W, V], 0.0)
    return made


@pytest.mark.parametrize("keeps", [False, True])
def test_licences_are_in_use_while_work_waits_for_them_and_hold_no_other_work_up(keeps: bool) -> None:
    backend = FakeBackend(4, {"S1": 0.1, "S2": 0.1})
    pool = WorkPool(backend, MemoryLeases(), clock=lambda: backend.now, resources=Resources(LICENCES))
    both = [
        Work(licensed(keeps=keeps), behaving([Behaviour.WELL] * 300)),
        Work(bare("S2"), behaving([Behaviour.WELL] * 500, 1001)),
    ]
    pool.submit(*both, tag="a")
    drain(pool)
    assert max(count for _, count in backend.held) == 2
    end = max(end for _, end in backend.running)
    assert sum(end - begin for begin, end in backend.running) >= 0.95 * 2 * end
    assert backend.busy_seconds >= 0.95 * 4 * backend.now


@pytest.mark.slow
@pytest.mark.parametrize("keeps", [False, True])
@given(kills=st.lists(st.tuples(st.integers(0, 60), st.integers(0, 3)), max_size=12))
@settings(max_examples=examples(25), deadline=None)
def test_there_are_never_more_runs_than_licences_whoever_is_killed(keeps: bool, kills: list[tuple[int, int]]) -> None:
    backend = FakeBackend(4, {"S1": 0.4, "S2": 0.3, "S3": 0.2}, linger_seconds=5.0)
    pool = WorkPool(backend, MemoryLeases(), clock=lambda: backend.now, resources=Resources(LICENCES, settle_seconds=6.0))
    pool.submit(Work(licensed(keeps=keeps), behaving([Behaviour.WELL] * 40)), tag="a")
    pool.submit(Work(licensed("S2", 2, keeps=keeps), behaving([Behaviour.WELL] * 10, 1001)), tag="b", priority=1)
    pool.submit(Work(bare("S3"), behaving([Behaviour.WELL] * 60, 2001)), tag="c")
    completed = []
    for moment, worker in sorted(kills):
        while backend.now < moment and any(map(pool.held, "abc")):
            completed += pool.poll(0.5)
        backend.kill(worker)
    completed += drain(pool)
    assert max(count for _, count in backend.held) <= 2
    assert len(completed) == 110
    assert {(entry.result.breakdown, entry.attempts) for entry in completed} == {(None, 1)}


def test_campaigns_share_licences_and_a_higher_priority_takes_them_first() -> None:
    backend = FakeBackend(4, {"S1": 0.5})
    pool = WorkPool(backend, MemoryLeases(), clock=lambda: backend.now, resources=Resources(LICENCES))
    for tag, first in (("a", 1), ("b", 1001)):
        pool.submit(Work(licensed(), behaving([Behaviour.WELL] * 50, first)), tag=tag)
    pool.poll(0.1)
    pool.submit(Work(licensed(), behaving([Behaviour.WELL] * 10, 2001)), tag="c", priority=5)
    order = [entry.tag for entry in drain(pool)]
    assert set(order[4:12]) == {"c"}
    assert abs(order[:60].count("a") - order[:60].count("b")) <= 5


@pytest.mark.parametrize("keeps", [False, True])
def test_a_campaign_that_needs_two_licences_gets_its_share_beside_one_that_needs_one(keeps: bool) -> None:
    backend = FakeBackend(4, {"S1": 0.5, "S2": 0.5})
    pool = WorkPool(backend, MemoryLeases(), clock=lambda: backend.now, resources=Resources(LICENCES))
    pool.submit(Work(licensed(keeps=keeps), behaving([Behaviour.WELL] * 200)), tag="a")
    pool.poll(1.0)
    pool.submit(Work(licensed("S2", 2, keeps=keeps), behaving([Behaviour.WELL] * 20, 1001)), tag="b")
    order = [entry.tag for entry in drain(pool)]
    last = len(order) - order[::-1].index("b")
    assert order[:last].count("a") < 100
    assert max(count for _, count in backend.held) <= 2


def test_a_campaign_behind_a_higher_priority_says_so() -> None:
    one = scheduler({})
    one.add(Work(bare(), cells(3)), "low", 0)
    assert one.waits("low") is None
    one.add(Work(bare("S2"), cells(3, 11)), "high", 7)
    send(one)
    assert "priority, up to 7" in (one.waits("low") or "")
    assert one.waits("high") is None


def test_an_open_program_is_closed_before_other_work_or_when_it_is_unused() -> None:
    one = scheduler({"carmaker": 1})
    one.add(Work(licensed(keeps=True), cells(1)), "a", 0)
    one.add(Work(licensed("S2", keeps=True), cells(1, 11)), "b", 0)
    first = send(one)
    assert one.next_batch(V, idle=True) is None
    assert one.waits("b") is not None
    one.finished(first.batch_id, BatchResult(W, (), 0.1, busy=None))
    one.withdraw("a")
    closing = send(one)
    assert (closing.batch.closes, closing.batch.setup.scenario) == (True, "S1")
    assert one.next_batch(V, idle=True) is None
    one.finished(closing.batch_id, BatchResult(W, (), 0.1))
    second = send(one, V)
    assert ids(second) == [11]
    one.withdraw("b")
    one.finished(second.batch_id, BatchResult(V, (), 0.1))
    assert one.next_batch(V, idle=True) is None
    one.meet([W, V], KEPT_SECONDS)
    assert send(one, V).batch.closes


def test_seeds_of_one_session_share_its_resources_and_close_it_once() -> None:
    seeds = [replace(licensed(keeps=True), run_fingerprint=f"run {seed}", session="S1", seed=seed) for seed in (1, 2)]
    one = scheduler({"carmaker": 1})
    for seed, setup in enumerate(seeds):
        one.add(Work(setup, cells(1, 1 + 10 * seed)), "a", 0)
    for expected in (1, 11):
        sent = send(one)
        assert ids(sent) == [expected]
        assert [use.held for use in one.resources()] == [1]
        one.finished(sent.batch_id, answers(sent))
    one.meet([W, V], KEPT_SECONDS)
    closing = send(one)
    assert closing.batch.closes
    one.finished(closing.batch_id, BatchResult(W, (), 0.1))
    assert [use.held for use in one.resources()] == [0]


def test_a_new_dispatcher_waits_until_the_runs_of_the_last_one_have_ended() -> None:
    one = scheduler({"carmaker": 1}, free_at=10.0)
    one.add(Work(licensed(), cells(1)), "a", 0)
    assert one.next_batch(W, idle=True) is None
    one.meet([W, V], 10.1)
    assert ids(send(one)) == [1]


def test_cells_that_need_more_than_exists_wait_with_the_reason() -> None:
    one = scheduler({"carmaker": 1})
    one.add(Work(licensed(count=2), cells(1)), "a", 0)
    one.add(Work(bare("S2"), cells(1, 11)), "a", 0)
    assert ids(send(one)) == [11]
    assert one.next_batch(V, idle=True) is None
    assert "carmaker=2" in (one.waits("a") or "")


def test_resources_are_not_kept_for_cells_that_the_worker_refuses() -> None:
    one = scheduler({"carmaker": 1})
    one.add(Work(licensed("S1", keeps=True), cells(2)), "refused", 0)
    for worker in (W, V):
        one.finished(send(one, worker).batch_id, BatchResult(worker, (), 0.1, refusal="it has version 2"))
    one.add(Work(licensed("S2", keeps=True), cells(100, 101)), "other", 0)
    for _ in range(3):
        sent = send(one)
        assert sent.batch.setup.scenario == "S2"
        assert not sent.batch.closes
        one.finished(sent.batch_id, answers(sent))


def test_a_busy_simulator_takes_no_attempt_and_holds_no_other_work_up() -> None:
    backend = FakeBackend(2, {"S1": 0.1, "S2": 0.1}, busy_until={"S1": 20.0})
    pool = WorkPool(backend, MemoryLeases(), clock=lambda: backend.now)
    pool.submit(
        Work(bare("S1"), behaving([Behaviour.WELL] * 6)), Work(bare("S2"), behaving([Behaviour.WELL] * 20, 101)), tag="a"
    )
    completed: list[Completed] = []
    reason = None
    while len(completed) < 26:
        completed += pool.poll(1.0)
        reason = reason or pool.waits("a")
        assert backend.now < 60
    assert reason is not None
    assert "no licence" in reason
    assert {(entry.result.breakdown, entry.attempts) for entry in completed} == {(None, 1)}
    assert [entry.result.id > 100 for entry in completed].index(False) == 20
    assert backend.replaced == []
    # it was asked with longer and longer pauses
    assert len([size for _, scenario, size in backend.sizes if scenario == "S1"]) < 20


def test_workers_that_leave_take_no_attempt_until_a_cell_lost_many_alone() -> None:
    one = scheduler({})
    one.add(Work(bare(), cells(1)), "a", 0)
    for number in range(1, 100):
        sent = send(one)
        assert sent.alone == (number > 2)
        done = one.lost(Lost(sent.batch_id, W, Breakdown.CRASH, "it was killed", departed=True))
        if done:
            break
    assert number == MOST_LOSSES
    assert done[0].result.breakdown == Breakdown.CRASH
    assert one.take_breakdowns() == {}
