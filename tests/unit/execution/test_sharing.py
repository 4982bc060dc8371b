"""Identical cells of parallel campaigns are simulated once."""

import math
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.plant import Plant, V, W, answers, cells, ids, send
from tests.support.setups import bare as setup

from drivecal.contracts.work import Cell, SetupRequest
from drivecal.execution.scheduling.in_flight import Completed, Dispatch, Work
from drivecal.execution.scheduling.scheduler import Scheduler


def scheduler() -> Scheduler:
    made = Scheduler()
    made.meet([W, V])
    return made


def add(to: Scheduler, tag: str, first: int, values: Sequence[float], priority: int = 0) -> None:
    to.add(Work(setup(), cells(len(values), first, values)), tag, priority)


def finish(of: Scheduler, sent: Dispatch) -> list[Completed]:
    return of.finished(sent.batch_id, answers(sent))


def test_an_identical_cell_of_another_campaign_is_answered_with_the_first_ones_result() -> None:
    one = scheduler()
    add(one, "a", 1, [0.25])
    sent = send(one)
    add(one, "b", 2, [0.25])
    assert one.next_batch(V, idle=True) is None
    leader, follower = finish(one, sent)
    assert (leader.tag, leader.result.id, leader.shared) == ("a", 1, False)
    assert (follower.tag, follower.result.id, follower.shared) == ("b", 2, True)
    assert (leader.result.rating, leader.attempts, leader.worker) == (0.25, 1, W)
    assert (follower.result.rating, follower.attempts, follower.worker) == (0.25, 1, W)
    assert one.held("a") == one.held("b") == 0
    add(one, "b", 3, [0.25])
    assert ids(send(one)) == [3]  # the pool forgets a given answer; the database keeps it


def test_the_cell_whose_turn_comes_first_is_the_one_that_is_sent() -> None:
    one = scheduler()
    add(one, "long", 1, [float(value) for value in range(100)])
    add(one, "short", 1001, [99.0])
    sent = [send(one), send(one)]
    assert sorted(number for each in sent for number in ids(each)) == [1, 1001]
    completed = [done for each in sent for done in finish(one, each)]
    assert [(done.result.id, done.shared) for done in completed if done.result.rating == 99.0] == [(1001, False), (100, True)]


def test_a_cell_of_higher_priority_does_not_wait_for_the_priority_of_its_like() -> None:
    one = scheduler()
    add(one, "low", 1, [1.0, 2.0, 3.0])
    add(one, "high", 11, [3.0], priority=7)
    sent = send(one)
    assert ids(sent) == [11]
    assert [(done.tag, done.result.id) for done in finish(one, sent)] == [("high", 11), ("low", 3)]


@pytest.mark.parametrize("other", [setup("S2"), setup("S1", evaluator="strict"), setup("S1", fingerprint="another version")])
def test_cells_of_other_setups_and_evaluators_are_not_identical(other: SetupRequest) -> None:
    one = scheduler()
    add(one, "a", 1, [1.0])
    one.add(Work(other, cells(1, 2, [1.0])), "b", 0)
    assert ids(send(one)) + ids(send(one)) == [1, 2]


@pytest.mark.parametrize(
    ("parameters", "like"),
    [
        ({"P1": 0.0}, {"P1": -0.0}),
        ({"P1": 0.1 + 0.2}, {"P1": 0.3}),
        ({"P1": 1.0}, {"P2": 1.0}),
        ({"P1": 1.0}, {"P1": 1.0, "P2": 0.0}),
        ({"P1": 1.0, "P2": 2.0}, {"P1": 2.0, "P2": 1.0}),
    ],
)
def test_parameters_that_differ_in_a_bit_are_not_identical(parameters: dict[str, float], like: dict[str, float]) -> None:
    one = scheduler()
    one.add(Work(setup(), [Cell(1, parameters)]), "a", 0)
    one.add(Work(setup(), [Cell(2, like)]), "b", 0)
    assert ids(send(one)) + ids(send(one)) == [1, 2]


def test_the_order_of_the_parameters_makes_no_difference() -> None:
    one = scheduler()
    one.add(Work(setup(), [Cell(1, {"P1": 1.0, "P2": math.nan})]), "a", 0)
    one.add(Work(setup(), [Cell(2, {"P2": math.nan, "P1": 1.0})]), "b", 0)
    assert ids(send(one)) == [1]
    assert one.next_batch(V, idle=True) is None


@given(
    st.lists(st.tuples(st.sampled_from("abcd"), st.lists(st.integers(0, 9), min_size=1, max_size=30)), min_size=1, max_size=8)
)
def test_every_value_is_simulated_once_and_every_cell_gets_its_value(work: list[tuple[str, list[int]]]) -> None:
    plant = Plant(2)
    values: dict[int, float] = {}
    for tag, wanted in work:
        first = len(values) + 1
        values |= {first + index: float(value) for index, value in enumerate(wanted)}
        plant.add(tag, "S1", cells(len(wanted), first, [float(value) for value in wanted]))
    plant.run()
    assert {entry.result.id: entry.result.rating for entry in plant.completed} == values
    assert len(plant.completed) == len(values)
    assert sum(count for _, _, count in plant.order) == len(set(values.values()))
    leaders = {item.result.rating for item in plant.completed if not item.shared}
    assert {member.result.rating for member in plant.completed if member.shared} <= leaders
