"""Attempts, over restarts too, and what was not sent after all."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.support.plant import TARGET, V, W, answers, cells, ids, send
from tests.support.setups import bare as setup

from drivecal.contracts.work import BatchResult, CellResult
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.scheduling.batching import BatchPolicy
from drivecal.execution.scheduling.in_flight import Completed, Dispatch, Work
from drivecal.execution.scheduling.scheduler import ATTEMPTS, MOST_PASSED_OVER, Scheduler
from drivecal.execution.scheduling.worker_health import BATCHES_WITHOUT_RESULT

SMALL = 0.0001
"""Seconds per cell of which many go into a batch, even at the end."""


def scheduler(known: float | None = None) -> Scheduler:
    """Of two workers; `known` is what a cell of S1 costs in seconds."""
    made = Scheduler(BatchPolicy())
    made.meet([W, V])
    for worker in (W, V) if known is not None else ():
        made.add(Work(setup(), cells(1, first=999)), "before", 0)
        sent = send(made, worker)
        made.finished(sent.batch_id, answers(sent, known or 0.0))
    made.withdraw("before")
    return made


def erroneous(sent: Dispatch) -> BatchResult:
    results = (CellResult(number, None, None, {}, None, 1.0, "error", "ValueError") for number in ids(sent))
    return BatchResult(sent.worker, tuple(results), 0.1)


def crash(of: Scheduler, sent: Dispatch) -> None:
    assert of.lost(sent.batch_id, sent.worker, Breakdown.CRASH, "it died") == []


def test_a_cell_with_earlier_breakdowns_is_sent_alone_from_the_start() -> None:
    one = scheduler(SMALL)
    one.add(Work(setup(), cells(20), breakdowns={7: 1}), "a", 0)
    assert one.next_batch(W, idle=False) is None  # it runs dry
    sent = send(one)
    assert (ids(sent), sent.alone, dict(sent.breakdowns)) == ([7], True, {7: 1})
    assert len(ids(send(one))) > 1


@pytest.mark.parametrize("earlier", range(ATTEMPTS + 2))
def test_breakdowns_before_a_restart_count(earlier: int) -> None:
    one = scheduler()
    one.add(Work(setup(), cells(1), breakdowns={1: earlier}), "a", 0)
    tries = 0
    completed: list[Completed] = []
    while not completed:
        tries += 1
        sent = send(one)
        completed = one.lost(sent.batch_id, W, Breakdown.HANG, "it hung")
    assert [(done.result.breakdown, done.attempts) for done in completed] == [("hang", ATTEMPTS)]
    assert tries == max(ATTEMPTS - earlier, 1)


@pytest.mark.parametrize("earlier", range(ATTEMPTS + 2))
def test_however_often_a_cell_broke_down_it_never_had_more_attempts_than_there_are(earlier: int) -> None:
    one = scheduler()
    one.add(Work(setup(), cells(1), breakdowns={1: earlier}), "a", 0)
    sent = send(one)
    [done] = one.finished(sent.batch_id, answers(sent))
    assert done.attempts == min(earlier + 1, ATTEMPTS)


def test_breakdowns_are_told_once_to_whoever_writes_them_down() -> None:
    one = scheduler(SMALL)
    one.add(Work(setup(), cells(3)), "a", 0)
    one.add(Work(setup(), cells(1, first=11, values=[2.0])), "b", 0)
    crash(one, send(one))
    assert one.take_breakdowns() == {1: 1, 2: 1, 3: 1, 11: 1}
    assert one.take_breakdowns() == {}
    sent = [send(one), send(one)]
    assert [ids(each) for each in sent] == [[1], [11]]
    for each in sent:
        crash(one, each)
    one.withdraw("b")
    assert one.take_breakdowns() == {1: 2, 2: 2}
    while one.held("a"):
        last = send(one)
        if last.breakdowns == {3: 1}:
            crash(one, last)
        else:
            one.finished(last.batch_id, answers(last))
    assert one.take_breakdowns() == {}  # nothing is outstanding


def test_the_only_worker_is_replaced_for_a_suspect_after_others_were_let_past_it_for_a_while() -> None:
    one = Scheduler(BatchPolicy())
    one.meet([W])
    one.add(Work(setup(), cells(20 * MOST_PASSED_OVER)), "many", 0)
    first = MOST_PASSED_OVER * 20 + 1
    for number, worker in enumerate((W, V)):
        one.meet([worker])
        one.add(Work(setup(), cells(1, first + number), breakdowns={first + number: 1}), "few", 1)
        sent = send(one, worker)
        assert one.finished(sent.batch_id, erroneous(sent)) == []
        passed = 0
        while (sent_past := one.next_batch(worker, idle=True)) is not None:
            passed += 1
            one.finished(sent_past.batch_id, answers(sent_past, 1.0))
        assert passed == MOST_PASSED_OVER
        assert one.replacement(worker) is not None
        one.meet([f"the next {worker}"])
        again = send(one, f"the next {worker}")
        assert ids(again) == [first + number]
        assert len(one.finished(again.batch_id, answers(again))) == 1


def test_a_refusal_is_no_breakdown() -> None:
    one = scheduler(SMALL)
    one.add(Work(setup(), cells(3)), "a", 0)
    sent = send(one)
    assert one.finished(sent.batch_id, BatchResult(W, (), 0.1, "it has no frenet")) == []
    assert one.take_breakdowns() == {}
    again = send(one, V)
    assert (ids(again), set(again.breakdowns.values()), again.alone) == ([1, 2, 3], {0}, False)


def test_cells_of_a_dispatch_that_was_not_sent_return_to_the_front_in_their_order() -> None:
    one = scheduler(0.05)
    one.add(Work(setup(), cells(40)), "a", 0)
    first, second = send(one), send(one)
    assert ids(first) + ids(second) == list(range(1, len(ids(first)) + len(ids(second)) + 1))
    one.take_back(second.batch_id)
    one.take_back(first.batch_id)
    assert ids(send(one)) == ids(first)
    assert ids(send(one)) == ids(second)


def test_a_dispatch_that_was_not_sent_is_not_charged() -> None:
    one = scheduler(0.05)
    one.add(Work(setup(), cells(400)), "a", 0)
    one.add(Work(setup(), cells(400, first=1001)), "b", 0)
    first = send(one)
    assert ids(first)[0] == 1
    for _ in range(5):
        one.take_back(first.batch_id)
        first = send(one)
        assert ids(first)[0] == 1
    assert ids(send(one))[0] == 1001


def test_cells_that_were_withdrawn_while_a_dispatch_was_out_do_not_return_with_it() -> None:
    one = scheduler()
    one.add(Work(setup(), cells(1)), "a", 0)
    sent = send(one)
    assert one.withdraw("a") == 1
    one.take_back(sent.batch_id)
    assert one.held("a") == 0
    assert one.next_batch(W, idle=True) is None


def test_dropped_cells_are_forgotten_and_the_rest_of_their_batch_is_sent() -> None:
    one = scheduler(SMALL)
    one.add(Work(setup(), cells(4)), "a", 0)
    sent = send(one)
    assert ids(sent) == [1, 2, 3, 4]
    assert sent.expected_seconds == pytest.approx(4 * SMALL)
    rest = one.drop(sent.batch_id, {2, 777})
    assert rest is not None
    assert (rest.batch_id, rest.worker, ids(rest)) == (sent.batch_id, W, [1, 3, 4])
    assert rest.expected_seconds == pytest.approx(3 * SMALL)
    assert set(rest.breakdowns) == {1, 3, 4}
    assert one.held("a") == 3
    completed = one.finished(rest.batch_id, answers(rest))
    assert [done.result.id for done in completed] == ids(rest)
    one.add(Work(setup(), cells(1, first=2)), "a", 0)  # forgotten: it may come again


def test_a_batch_of_which_everything_is_dropped_is_none_and_costs_nothing() -> None:
    one = scheduler(TARGET)
    one.add(Work(setup(), cells(3)), "a", 0)
    one.add(Work(setup(), cells(3, first=11)), "b", 0)
    for number in (1, 2):
        sent = send(one)
        assert ids(sent) == [number]
        assert one.drop(sent.batch_id, {number}) is None
        assert one.finished(sent.batch_id, answers(sent)) == []
    assert ids(send(one)) == [3]
    assert ids(send(one)) == [11]
    assert one.held("a") == 1


def test_a_breakdown_in_company_is_never_the_last() -> None:
    """A campaign joins with what broke down twice, before a restart, while its like is in a batch with a poison cell."""
    one = scheduler(SMALL)
    one.add(Work(setup(), cells(2)), "a", 0)
    sent = send(one)
    assert len(ids(sent)) == 2
    one.add(Work(setup(), cells(1, first=11, values=[1.0]), breakdowns={11: 2}), "b", 0)
    crash(one, sent)
    again = send(one)
    assert again.alone
    assert again.breakdowns in ({1: 2}, {11: 2})


def test_breakdowns_in_children_of_a_worker_say_nothing_about_the_worker() -> None:
    for contained in (False, True):
        one = scheduler(SMALL)
        one.add(Work(setup(), cells(400)), "a", 0)
        for _ in range(BATCHES_WITHOUT_RESULT):
            sent = send(one)
            result = erroneous(sent)
            one.finished(
                sent.batch_id, replace(result, results=tuple(replace(each, contained=contained) for each in result.results))
            )
        assert (one.replacement(W) is None) == contained
