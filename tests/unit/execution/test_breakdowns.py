"""Attempts, over restarts too, and what was not sent after all."""

from dataclasses import replace

from tests.support.plant import V, W, answers, cells, ids, send
from tests.support.setups import bare as setup

from drivecal.contracts.work import BatchResult, CellResult
from drivecal.execution.scheduling.batching import TARGET_SECONDS
from drivecal.execution.scheduling.in_flight import Dispatch, Work
from drivecal.execution.scheduling.scheduler import MOST_PASSED_OVER, Scheduler
from drivecal.execution.scheduling.worker_health import BATCHES_WITHOUT_RESULT

SMALL = 0.0001
"""Seconds of a cell, so short that many cells fill a batch, even at the end."""


def scheduler(known: float | None = None) -> Scheduler:
    """Returns a scheduler of two workers; `known` is the cost of a cell of S1 in seconds."""
    made = Scheduler()
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


def test_a_cell_with_earlier_breakdowns_is_sent_alone_from_the_start() -> None:
    one = scheduler(SMALL)
    one.add(Work(setup(), cells(20), breakdowns={7: 1}), "a", 0)
    assert one.next_batch(W, idle=False) is None  # it runs dry
    sent = send(one)
    assert (ids(sent), sent.alone, dict(sent.breakdowns)) == ([7], True, {7: 1})
    assert len(ids(send(one))) > 1


def test_the_only_worker_is_replaced_for_a_suspect_after_others_were_let_past_it_for_a_while() -> None:
    one = Scheduler()
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
        assert one.is_stuck(worker)
        one.meet([f"the next {worker}"])
        again = send(one, f"the next {worker}")
        assert ids(again) == [first + number]
        assert len(one.finished(again.batch_id, answers(again))) == 1


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


def test_a_batch_of_which_everything_is_dropped_is_none_and_costs_nothing() -> None:
    one = scheduler(TARGET_SECONDS)
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
        assert (one.fault(W) is None) == contained
