from contextlib import suppress
from dataclasses import replace
from math import isfinite
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import Connection, func, select, update
from tests.support.databases import migrated
from tests.support.storage import EVALUATOR, new_run, sample_set_ids, setup_id

from drivecal.api.live.worker_time import RecentWork
from drivecal.domain.evaluations import Donor, Rating
from drivecal.domain.parameters import ParameterSet
from drivecal.storage.engine import tables
from drivecal.storage.engine.database import Database
from drivecal.storage.references import metrics, parameter_sets, ratings, runs, setups
from drivecal.storage.references.runs import NewRun, StoredRun


@pytest.mark.slow("postgresql")
def test_results_are_found_by_setup_parameter_set_and_evaluator(connection: Connection) -> None:
    s1, s2 = setup_id(connection, "S1"), setup_id(connection, "S2")
    sets = sample_set_ids(connection, 6000)
    stored = runs.insert_results(connection, [new_run(s1, one, evaluation=100 + number) for number, one in enumerate(sets)])
    runs.insert_results(connection, [new_run(s2, sets[0], score=0, rating=0.0, failure="collision")])
    result = runs.look_up_exact(connection, s1, sets, EVALUATOR, 10**9)
    assert result == {
        one: Donor(evaluation=100 + number, run=stored[number].id, score=5, rating=5.25, failure=None)
        for number, one in enumerate(sets)
    }
    failed = runs.look_up_exact(connection, s2, sets, EVALUATOR, 10**9)
    assert [(item.score, item.failure) for item in failed.values()] == [(0, "collision")]
    assert runs.look_up_exact(connection, s1, sets, "learned 1", 10**9) == {}
    assert [(count.scenario, count.runs) for count in setups.counts(connection)] == [("S1", 6000), ("S2", 1)]


def test_the_first_result_of_a_cell_stays_and_an_equal_one_agrees(connection: Connection) -> None:
    first = new_run(setup_id(connection), *sample_set_ids(connection, 1), evaluation=7)
    late = replace(first, evaluation_id=8, worker="worker 2", milliseconds=9.0)
    (stored,) = runs.insert_results(connection, [first])
    assert stored == StoredRun(stored.id, evaluation_id=7, agrees=True)
    assert runs.insert_results(connection, [late]) == [stored]
    assert connection.scalar(select(func.count()).select_from(tables.runs)) == 1


def test_the_work_of_workers_is_read_once(connection: Connection) -> None:
    recent = RecentWork()
    *first, last = (new_run(setup_id(connection), number) for number in sample_set_ids(connection, 3))
    runs.insert_results(connection, first)
    known = recent.read(connection)
    connection.execute(update(tables.runs).values(worker="another"))
    runs.insert_results(connection, [last])
    newest, *older = recent.read(connection)
    assert (older, newest.id > known[0].id) == (known, True)


@pytest.mark.parametrize(
    "change",
    [
        {"metrics": {"peak_lateral_acceleration_mps2": 0.3, "offset_m": 1e-300}},  # one bit away from 0.1 + 0.2
        {"failure": "off_road"},
        {"score": 4},
        {"rating": 5.250000000000001},
    ],
)
def test_a_result_that_differs_in_a_bit_does_not_agree_and_changes_nothing(
    connection: Connection, change: dict[str, Any]
) -> None:
    first = new_run(setup_id(connection), *sample_set_ids(connection, 1))
    (stored,) = runs.insert_results(connection, [first])
    assert runs.insert_results(connection, [replace(first, **change)]) == [replace(stored, agrees=False)]
    assert runs.insert_results(connection, [first]) == [stored]


def test_a_repeat_with_measures_that_were_declared_since_agrees(connection: Connection) -> None:
    one = new_run(setup_id(connection), *sample_set_ids(connection, 1))
    (stored,) = runs.insert_results(connection, [one])
    more = replace(one, metrics={**one.metrics, "gap_m": 2.0})
    assert runs.insert_results(connection, [more, one]) == [replace(stored, is_whole=False), stored]
    assert runs.values_of(connection, [stored.id]) == {stored.id: (one.metrics, None)}, "the first result of a cell stays"


def test_two_results_of_one_cell_in_one_batch_are_stored_once(connection: Connection) -> None:
    one = new_run(setup_id(connection), *sample_set_ids(connection, 1), evaluation=1)
    first, second = runs.insert_results(connection, [one, replace(one, evaluation_id=2)])
    assert first == second == StoredRun(first.id, evaluation_id=1, agrees=True)
    first, second = runs.insert_results(connection, [one, replace(one, score=4)])
    assert (first.agrees, second.agrees) == (True, False)


def test_a_later_simulation_adds_no_rating_to_a_run_that_campaigns_may_see_already(connection: Connection) -> None:
    """An evaluator rates a run by its stored metrics; a repeated simulation of the cell changes nothing."""
    one = new_run(setup_id(connection), *sample_set_ids(connection, 1))
    (stored,) = runs.insert_results(connection, [one])
    again = replace(one, evaluator="learned 1", score=3, rating=3.0, campaign_sequence=2)
    assert runs.insert_results(connection, [again]) == [stored]
    assert runs.look_up_exact(connection, one.setup_id, [one.parameter_set_id], "learned 1", stored.id) == {}
    ratings.insert(connection, "learned 1", [(stored.id, Rating(3.0, 3))])
    result = runs.look_up_exact(connection, one.setup_id, [one.parameter_set_id], "learned 1", stored.id)
    assert result == {one.parameter_set_id: Donor(1, stored.id, 3, 3.0, None)}
    assert runs.insert_results(connection, [again]) == [stored]
    assert runs.insert_results(connection, [replace(again, score=4)]) == [replace(stored, agrees=False)]


def test_ratings_from_series_of_a_repeated_run_are_for_later_campaigns(connection: Connection) -> None:
    setup, sets = setup_id(connection), sample_set_ids(connection, 5)
    stored = runs.insert_results(connection, [new_run(setup, element) for element in sets[:4]])
    before = runs.largest_id(connection)
    seen = [
        new_run(setup, item, evaluator="learned 1", score=3, rating=3.0, campaign_sequence=2, evaluation=2) for item in sets[:4]
    ]
    seen = [replace(entry, from_series=True) for entry in seen]
    seen[1] = replace(seen[1], metrics={"offset_m": 1.0})  # differs from the stored run
    seen[2] = replace(seen[2], failure="collision")
    result = runs.insert_results(connection, [*seen, replace(seen[0], score=4)])
    assert result == [
        stored[0],
        *(replace(member, agrees=False) for member in stored[1:3]),
        stored[3],
        replace(stored[0], agrees=False),
    ]
    assert runs.insert_results(connection, seen[:1]) == stored[:1]
    after = runs.largest_id(connection)
    assert runs.look_up_exact(connection, setup, sets, "learned 1", before) == {}
    assert runs.look_up_exact(connection, setup, sets, "learned 1", after) == {
        sets[0]: Donor(1, stored[0].id, 3, 3.0, None),
        sets[3]: Donor(1, stored[3].id, 3, 3.0, None),
    }
    [new] = runs.insert_results(connection, [new_run(setup, sets[4])])
    assert new.id > after


def test_metrics_without_a_number_are_stored_as_null_and_agree_with_themselves(connection: Connection) -> None:
    one = new_run(setup_id(connection), *sample_set_ids(connection, 1))
    odd: NewRun = replace(one, metrics={"peak": float("nan"), "other": float("inf")})
    [stored] = runs.insert_results(connection, [odd])
    assert stored.agrees
    assert runs.insert_results(connection, [odd])[0].agrees
    assert runs.values_of(connection, [stored.id]) == {stored.id: ({"peak": None, "other": None}, None)}


NUMBERS = {"peak_mps2": 0.1 + 0.2, "offset_m": -0.0, "missing": float("nan")}
STORED = "hgqY8lRBl_bY:NDMzMzMz0z8AAAAAAAAAgAAAAAAAAPh/"


def test_the_stored_form_of_a_run_stays_as_it_is(connection: Connection) -> None:
    assert metrics.pack(connection, [NUMBERS, NUMBERS]) == [STORED, STORED]
    assert connection.scalars(select(tables.metric_names.c.names)).all() == [list(NUMBERS)]


def test_every_bit_comes_back(tmp_path_factory: pytest.TempPathFactory) -> None:
    database = migrated(f"sqlite:///{tmp_path_factory.mktemp('metrics') / '1.db'}")

    @given(st.dictionaries(st.text(max_size=20), st.floats() | st.integers(-9, 9), max_size=8))
    def comes_back(given: dict[str, float]) -> None:
        with database.transaction() as connection:
            [stored] = metrics.pack(connection, [given])
            read = metrics.reader(connection)(stored)
        assert list(read) == list(given)
        assert [repr(each) for each in read.values()] == [repr(each) if isfinite(each) else "None" for each in given.values()]

    comes_back()


def test_names_that_a_transaction_took_back_are_stored_by_the_next(database: Database) -> None:
    with suppress(ZeroDivisionError), database.transaction() as connection:
        [stored] = metrics.pack(connection, [NUMBERS])
        assert metrics.reader(connection)(stored)["offset_m"] == 0.0
        raise ZeroDivisionError
    with database.transaction() as connection:
        metrics.pack(connection, [NUMBERS])
        assert connection.scalars(select(tables.metric_names.c.names)).all() == [list(NUMBERS)]


def test_sets_are_chosen_by_names_that_differ_in_case_alone(connection: Connection) -> None:
    setup = setup_id(connection)
    numbers = parameter_sets.ensure(
        connection, [ParameterSet.from_json('{"gain": 0.5}'), ParameterSet.from_json('{"gain": 0.5, "Gain": 1}')]
    )
    runs.insert_results(connection, [new_run(setup, number) for number in numbers])
    chosen = list(runs.in_order_of_keys(connection, setup, EVALUATOR, 10**9, ["gain"], ["Gain"]))
    assert [set(run.parameters.floats) for run in chosen] == [{"gain"}]
