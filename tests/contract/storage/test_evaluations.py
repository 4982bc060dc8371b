from dataclasses import replace

import numpy as np
import pytest
from sqlalchemy import Connection
from sqlalchemy.exc import IntegrityError
from tests.support.storage import begun, campaign, cell, sample_set_ids, sample_sets, setup_id, simulate
from tests.support.values import present

from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import NotFoundError
from drivecal.domain.evaluations import Donor, Outcome, Purpose
from drivecal.storage import evaluations, results
from drivecal.storage.engine.database import Database
from drivecal.storage.evaluations import AnsweredCell

SIMULATED, REPEATED, REUSED, FAILED = Outcome.SIMULATED, Outcome.REPEATED, Outcome.REUSED, Outcome.FAILED


@pytest.mark.slow("sqlite")
def test_a_population_gets_its_ids_in_order_and_waits(connection: Connection) -> None:
    sequence, setup, sets = begun(connection, 2500)
    ids = evaluations.insert(connection, sequence, [cell(n, setup, one) for n, one in enumerate(sets)])
    waiting = results.pending(connection, sequence)
    assert [item.id for item in waiting] == ids
    assert [entry.individual for entry in waiting] == list(range(2500))
    assert [element.parameters for element in waiting] == sample_sets(2500)
    assert {(member.plan, member.reference, member.purpose == "audit", member.attempts) for member in waiting} == {
        (SIMULATED, None, False, 0)
    }


def test_a_copy_of_a_stored_result_has_its_answer_at_once(connection: Connection) -> None:
    first, second = campaign(connection).sequence, campaign(connection).sequence
    setup, sets = setup_id(connection), sample_set_ids(connection, 3)
    (simulated,) = simulate(connection, first, [cell(0, setup, sets[0])], score=6, rating=5.75)
    run = present(results.by_id(connection, simulated).run_id)
    donor = Donor(simulated, run, 6, 5.75, "collision")
    cells = [cell(0, setup, sets[0], plan=REPEATED, donor=donor), cell(1, setup, sets[1], plan=REUSED, donor=donor)]
    audited = cell(2, setup, sets[2], donor=donor, purpose=Purpose.AUDIT)
    ids = evaluations.insert(connection, second, [*cells, audited])
    copies = [results.by_id(connection, item) for item in ids[:2]]
    waiting = results.pending(connection, second)
    assert [entry.outcome for entry in copies] == [REPEATED, REUSED]
    result = {(copy.score, copy.rating, copy.failure, copy.run_id, copy.reference) for copy in copies}
    assert result == {(6, 5.75, "collision", run, simulated)}
    assert [(element.id, element.plan, element.reference, (element.purpose == "audit")) for element in waiting] == [
        (ids[2], SIMULATED, simulated, True)
    ]


def test_an_inspected_cell_without_a_result_is_no_simulated_one(connection: Connection) -> None:
    sequence, setup, sets = begun(connection, 2)
    drawn = [cell(number, setup, one, purpose=Purpose.SAMPLE) for number, one in enumerate(sets)]
    done, broken = evaluations.insert(connection, sequence, drawn)
    simulated = AnsweredCell(done, SIMULATED, 6, 5.75, None)
    evaluations.answer(connection, [simulated, AnsweredCell(broken, FAILED, None, None, None, "crash")])
    counts = evaluations.counts(connection, sequence, StageName.CALIBRATION, 0)
    assert (counts.requested, counts.simulated, counts.failed, counts.sampled) == (2, 1, 1, 1)


def test_a_cell_that_waits_for_another_of_its_population_names_it(connection: Connection) -> None:
    sequence, setup, sets = begun(connection, 2)
    cells = [
        cell(0, setup, sets[0]),
        cell(1, setup, sets[0], plan=REPEATED, leader=0),
        cell(2, setup, sets[1], leader=0, purpose=Purpose.AUDIT),
    ]
    ids = evaluations.insert(connection, sequence, cells)
    waiting = results.pending(connection, sequence)
    assert [(item.plan, item.reference, (item.purpose == "audit")) for item in waiting] == [
        (SIMULATED, None, False),
        (REPEATED, ids[0], False),
        (SIMULATED, ids[0], True),
    ]


def test_an_answer_is_stored_once_and_a_late_one_changes_nothing(connection: Connection) -> None:
    sequence, setup, sets = begun(connection, 3)
    ids = evaluations.insert(connection, sequence, [cell(n, setup, one) for n, one in enumerate(sets)])
    broken = AnsweredCell(ids[0], FAILED, None, None, None, failure="hang", worker="w", attempts=3)
    evaluations.answer(connection, [broken])
    late = [replace(broken, id=item, outcome=SIMULATED, score=1, rating=1.0, failure=None) for item in ids[:2]]
    evaluations.answer(connection, late)
    first, second = (results.by_id(connection, entry) for entry in ids[:2])
    assert [element.id for element in results.pending(connection, sequence)] == [ids[2]]
    assert (first.outcome, first.score, first.failure, first.attempts) == (FAILED, None, "hang", 3)
    assert (second.outcome, second.score) == (SIMULATED, 1)


def test_the_same_cell_of_a_population_cannot_be_stored_twice(database: Database) -> None:
    with database.transaction() as connection:
        sequence, setup, (one,) = begun(connection, 1)
    with pytest.raises(IntegrityError), database.transaction() as connection:
        evaluations.insert(connection, sequence, [cell(0, setup, one), cell(0, setup, one)])


def test_numpy_numbers_are_stored_as_numbers(connection: Connection) -> None:
    sequence, setup, (one,) = begun(connection, 1)
    (stored,) = evaluations.insert(connection, sequence, [cell(np.int64(4), setup, one, iteration=np.int64(2))])
    result = results.by_id(connection, stored)
    assert (result.iteration, result.individual) == (2, 4)


def test_own_references_are_the_first_simulated_answers_in_the_order_of_the_campaign(connection: Connection) -> None:
    key, other = b"k" * 16, b"o" * 16
    sequence, setup, sets = begun(connection, 6)
    # Stored out of order; the certified first one, the copy and the pending cell must not hide it.
    later = cell(1, setup, sets[0], iteration=1, reference_key=key)
    first = cell(3, setup, sets[1], iteration=0, reference_key=key)
    ids = simulate(connection, sequence, [later, first], score=4, rating=4.5)
    run = present(results.by_id(connection, ids[0]).run_id)
    copy = cell(0, setup, sets[2], plan=REUSED, reference_key=key, donor=Donor(ids[0], run, 4, 4.5, None))
    pending = cell(1, setup, sets[3], reference_key=key)
    failed = cell(2, setup, sets[4], reference_key=key)
    others = evaluations.insert(connection, sequence, [copy, pending, failed])
    evaluations.answer(connection, [AnsweredCell(others[2], FAILED, None, None, None, failure="crash")])
    simulate(connection, sequence, [cell(9, setup, sets[5], scenario="S2", reference_key=other)])
    simulate(connection, campaign(connection).sequence, [cell(0, setup, sets[5], reference_key=other)])

    result = evaluations.own_answers(connection, sequence, "S1", setup, [key, other, b"x" * 16], by_key=True)
    assert {name: one.evaluation for name, one in result.items()} == {key: ids[1]}
    assert (result[key].score, result[key].rating, result[key].failure) == (4, 4.5, None)
    exact = evaluations.own_answers(connection, sequence, "S1", setup, sets)
    assert {one: donor.evaluation for one, donor in exact.items()} == {sets[0]: ids[0], sets[1]: ids[1]}


def test_the_sensitivity_stage_comes_before_calibration(connection: Connection) -> None:
    key = b"k" * 16
    sequence, setup, sets = begun(connection, 2)
    calibration = cell(0, setup, sets[0], iteration=0, reference_key=key)
    sensitivity = cell(5, setup, sets[1], iteration=7, stage=StageName.SENSITIVITY, reference_key=key)
    ids = simulate(connection, sequence, [calibration, sensitivity])
    assert evaluations.own_answers(connection, sequence, "S1", setup, [key], by_key=True)[key].evaluation == ids[1]
    assert [item.id for item in results.stream(connection, sequence)] == ids[::-1]


def test_copies_of_a_cell_without_a_result_are_simulated_instead(connection: Connection) -> None:
    sequence, setup, sets = begun(connection, 3)
    cells = [cell(0, setup, sets[0]), *(cell(n, setup, sets[n], plan=REUSED, leader=0) for n in (1, 2))]
    leader, copy, answered = evaluations.insert(connection, sequence, cells)
    broken = [AnsweredCell(item, FAILED, None, None, None, failure="hang") for item in (leader, answered)]
    evaluations.answer(connection, broken)
    evaluations.simulate(connection, [copy, answered], reference=None)
    evaluations.simulate(connection, [])
    assert [(entry.id, entry.plan, entry.reference) for entry in results.pending(connection, sequence)] == [
        (copy, SIMULATED, None)
    ]
    assert results.by_id(connection, answered).reference == leader


def test_a_place_of_a_set_finds_its_cells_in_scenarios_that_were_asked_at_other_places(connection: Connection) -> None:
    sequence, numbers = campaign(connection).sequence, sample_set_ids(connection, 2)
    setups = {name: setup_id(connection, name) for name in ("S1", "S2")}
    asked = [(0, 0, "S2", 0), (0, 1, "S1", 1), (3, 0, "S1", 0)]
    cells = [
        cell(individual, setups[scenario], numbers[chosen], iteration=iteration, scenario=scenario)
        for iteration, individual, scenario, chosen in asked
    ]
    ids = evaluations.insert(connection, sequence, cells)
    assert results.cells_at(connection, sequence, 0, 0, "S1") == {0: ids[2]}
    for place in ((0, 1, "S2"), (1, 0, "S1")):
        with pytest.raises(NotFoundError):
            results.cells_at(connection, sequence, *place)


def test_seeds_that_report_a_set_come_before_its_others(connection: Connection) -> None:
    sequence, setup, (number,) = begun(connection, 1)
    reports = {3: Purpose.SEARCH, 14: Purpose.REPORT, 13: Purpose.REPORT, 1: Purpose.SEARCH}
    cells = [cell(0, setup, number, seed=seed, has_seed=True, purpose=purpose) for seed, purpose in reports.items()]
    ids = evaluations.insert(connection, sequence, cells)
    evaluations.answer(connection, [AnsweredCell(number, SIMULATED, 5.0, 5.25, None) for number in ids])
    assert list(results.cells_at(connection, sequence, 0, 0, "S1").items()) == [
        (13, ids[2]),
        (14, ids[1]),
        (1, ids[3]),
        (3, ids[0]),
    ]
