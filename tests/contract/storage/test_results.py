from __future__ import annotations

from dataclasses import replace
from itertools import product

import pytest
from tests.support.storage import EVALUATOR, campaign, new_run, sample_set_ids, sample_sets, setup_id, simulate

from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import InvalidInputError, NotFoundError
from drivecal.domain.evaluations import CellScore, Outcome
from drivecal.storage import evaluations, results
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.records import encode_cursor
from drivecal.storage.evaluations import AnsweredCell, NewEvaluation
from drivecal.storage.references import runs
from drivecal.storage.references.withdrawal import withdraw_certified
from drivecal.storage.results import StoredEvaluation
from drivecal.storage.retention.marking import mark

CALIBRATION = StageName.CALIBRATION


def place(one: StoredEvaluation) -> tuple[int, int, str]:
    return one.iteration, one.individual, one.scenario


def test_pages_and_stream_give_every_row_once_in_order(database: Database) -> None:
    with database.transaction() as connection:
        sequence, setup = campaign(connection).sequence, setup_id(connection)
        (one,) = sample_set_ids(connection, 1)
        places = list(product((1, 0), (2, 1, 0, 10), ("S2", "S10", "S1", "s1")))
        cells = [NewEvaluation(CALIBRATION, i, n, scenario, setup, one, Outcome.SIMULATED) for i, n, scenario in places]
        evaluations.insert(connection, sequence, cells)
        evaluations.insert(connection, campaign(connection).sequence, cells)
    found: list[StoredEvaluation] = []
    cursor = None
    with database.read() as connection:
        while True:
            page, cursor = results.page(connection, sequence, limit=5, cursor=cursor)
            found.extend(page)
            if cursor is None:
                break
        assert list(results.stream(connection, sequence)) == found
    assert [place(one) for one in found] == sorted(places)
    assert found[0].parameters.floats == {"P1": 0.0, "P2": 5.0}
    assert {type(value) for value in found[0].parameters.floats.values()} == {float}


@pytest.mark.parametrize("cursor", ["", "x", "W10", "WzEsMl0", encode_cursor(2, 0, 2**40, "S1"), encode_cursor(2, 0, 0, "S\0")])
def test_a_cursor_that_is_not_of_this_list_is_refused_by_name(database: Database, cursor: str) -> None:
    with (
        database.read() as connection,
        pytest.raises(InvalidInputError, check=lambda error: error.problems[0].field == "cursor"),
    ):
        results.page(connection, 1, cursor=cursor)


def test_a_cursor_of_a_stage_that_does_not_exist_ends_the_list(database: Database) -> None:
    with database.transaction() as connection:
        sequence, setup = campaign(connection).sequence, setup_id(connection)
        (one,) = sample_set_ids(connection, 1)
        evaluations.insert(connection, sequence, [NewEvaluation(CALIBRATION, 0, 0, "S1", setup, one, Outcome.SIMULATED)])
        assert results.page(connection, sequence, cursor=encode_cursor(77, 0, 0, "S1")) == ([], None)


@pytest.mark.parametrize("unknown", [0, -1, 1, 2**63, 10**30])
def test_an_evaluation_that_is_not_there_is_not_found(database: Database, unknown: int) -> None:
    with database.read() as connection, pytest.raises(NotFoundError, check=lambda error: error.kind == "evaluation"):
        results.by_id(connection, unknown)


def test_answers_say_whether_they_are_the_sets_own(database: Database) -> None:
    with database.transaction() as connection:
        sequence, setup = campaign(connection).sequence, setup_id(connection)
        sets = sample_set_ids(connection, 3)
        first = NewEvaluation(CALIBRATION, 0, 5, "S1", setup, sets[0], Outcome.SIMULATED)
        simulate(connection, sequence, [first], score=5)
        donor = evaluations.own_exact(connection, sequence, "S1", setup, sets)[sets[0]]
        copies = [
            NewEvaluation(CALIBRATION, 0, 6, "S1", setup, sets[1], Outcome.REUSED, donor=donor),
            NewEvaluation(CALIBRATION, 1, 0, "S1", setup, sets[0], Outcome.REPEATED, donor=donor),
        ]
        evaluations.insert(connection, sequence, copies)
        waiting = [NewEvaluation(CALIBRATION, 1, n, "S2", setup, sets[n], Outcome.SIMULATED) for n in (0, 1)]
        broken, _ = evaluations.insert(connection, sequence, waiting)
        evaluations.answer(connection, [AnsweredCell(broken, Outcome.FAILED, None, None, None, failure="crash")])
        everything = list(results.answers(connection, sequence, CALIBRATION))
        assert everything == [
            CellScore(sets[0], "S1", 5, 5.25, own=True, iteration=0, individual=5),
            CellScore(sets[1], "S1", 5, 5.25, own=False, iteration=0, individual=6),
            CellScore(sets[0], "S1", 5, 5.25, own=True, iteration=1, individual=0),
            CellScore(sets[0], "S2", None, None, own=True, iteration=1, individual=0),
        ]
        assert {type(one.own) for one in everything} == {bool}
        assert list(results.answers(connection, sequence, CALIBRATION, iteration=1)) == everything[2:]
        assert list(results.answers(connection, sequence, StageName.SENSITIVITY)) == []


def test_donors_are_the_simulated_cells_of_a_stage_with_their_sets(database: Database) -> None:
    with database.transaction() as connection:
        sequence, setup = campaign(connection).sequence, setup_id(connection)
        sets = sample_set_ids(connection, 3)
        cells = [
            NewEvaluation(StageName.SENSITIVITY, 4, n, "S1", setup, one, Outcome.SIMULATED) for n, one in enumerate(sets[:2])
        ]
        first, second = simulate(connection, sequence, cells)
        waiting = [NewEvaluation(StageName.SENSITIVITY, 5, 0, "S1", setup, sets[2], Outcome.SIMULATED)]
        evaluations.insert(connection, sequence, waiting)
        zero, one, _ = sample_sets(3)
        assert list(results.donors(connection, sequence, StageName.SENSITIVITY)) == [(first, "S1", zero), (second, "S1", one)]
        assert list(results.donors(connection, sequence, CALIBRATION)) == []
        asked = [results.is_requested(connection, sequence, StageName.SENSITIVITY, iteration) for iteration in (3, 4, 5)]
        assert asked == [False, True, True]
        assert not results.is_requested(connection, sequence, CALIBRATION, 4)


def test_cells_get_their_keys_once_a_map_is_known(database: Database) -> None:
    key = b"k" * 16
    with database.transaction() as connection:
        sequence, setup = campaign(connection).sequence, setup_id(connection)
        (one,) = sample_set_ids(connection, 1)
        (simulated,) = simulate(connection, sequence, [NewEvaluation(CALIBRATION, 0, 0, "S1", setup, one, Outcome.SIMULATED)])
        assert evaluations.own_references(connection, sequence, "S1", setup, [key]) == {}
        evaluations.set_reference_keys(connection, {})
        evaluations.set_reference_keys(connection, {simulated: key})
        assert evaluations.own_references(connection, sequence, "S1", setup, [key])[key].evaluation == simulated


def test_the_best_simulated_set_has_a_score_of_its_own_in_every_scenario(database: Database) -> None:
    weights = {"S1": 0.25, "S2": 0.75}
    with database.transaction() as connection:
        sequence, setup, other = campaign(connection).sequence, setup_id(connection), setup_id(connection, "S2")
        first, second, third = sample_set_ids(connection, 3)
        assert results.best_simulated(connection, sequence, weights) is None

        def cell(individual: int, scenario: str, one: int) -> NewEvaluation:
            return NewEvaluation(
                CALIBRATION, 0, individual, scenario, setup if scenario == "S1" else other, one, Outcome.SIMULATED
            )

        simulate(connection, sequence, [cell(0, "S1", first), cell(1, "S1", second)], score=4)
        simulate(connection, sequence, [cell(0, "S2", first), cell(2, "S1", third)], score=6)
        reused = evaluations.insert(connection, sequence, [cell(1, "S2", second)])
        evaluations.answer(connection, [AnsweredCell(reused[0], Outcome.REUSED, 7, 7.0, 1)])
        assert results.best_simulated(connection, sequence, weights) == pytest.approx(0.25 * 4 + 0.75 * 6)


def test_a_copied_score_gives_way_to_the_run_of_the_very_cell(database: Database) -> None:
    """By any campaign, under the same evaluator, if it is wanted."""
    with database.transaction() as connection:
        sequence, setup = campaign(connection).sequence, setup_id(connection)
        sets = sample_set_ids(connection, 3)
        simulate(connection, sequence, [NewEvaluation(CALIBRATION, 0, 0, "S1", setup, sets[0], Outcome.SIMULATED)], score=5)
        donor = evaluations.own_exact(connection, sequence, "S1", setup, sets)[sets[0]]
        reused = NewEvaluation(CALIBRATION, 0, 1, "S1", setup, sets[1], Outcome.REUSED, donor=donor)
        predicted = NewEvaluation(CALIBRATION, 0, 2, "S1", setup, sets[2], Outcome.PREDICTED)
        evaluations.insert(connection, sequence, [reused, predicted])
        answers = [
            AnsweredCell(cell.id, cell.plan, 5, 5.0, run_id=donor.run if cell.plan is Outcome.REUSED else None)
            for cell in results.pending(connection, sequence)
        ]
        evaluations.answer(connection, answers)
        before = list(results.answers(connection, sequence, CALIBRATION, corrected_by=EVALUATOR))
        watermark = runs.largest_id(connection)
        study = campaign(connection).sequence
        places = enumerate(sets[1:])
        own = [NewEvaluation(StageName.ROBUSTNESS, 0, number, "S1", setup, each, Outcome.SIMULATED) for number, each in places]
        simulate(connection, study, own, score=4)
        assert list(results.answers(connection, sequence, CALIBRATION)) == before
        after = list(results.answers(connection, sequence, CALIBRATION, corrected_by=EVALUATOR))
        assert list(results.answers(connection, sequence, CALIBRATION, corrected_by="another 1")) == before
        seen = [
            list(results.answers(connection, sequence, CALIBRATION, corrected_by=EVALUATOR, watermark=number))
            for number in (watermark, runs.largest_id(connection))
        ]
        assert seen == [before, after]
    assert [(answer.score, answer.own, answer.predicted) for answer in before] == [
        (5, True, False),
        (5, False, False),
        (5, False, True),
    ]
    assert [(answer.score, answer.own, answer.predicted) for answer in after] == [
        (5, True, False),
        (4, True, False),
        (4, True, False),
    ]


def test_a_copied_score_gives_way_to_the_run_that_a_certificate_names(database: Database) -> None:
    with database.transaction() as connection:
        sequence, setup = campaign(connection).sequence, setup_id(connection)
        sets = sample_set_ids(connection, 3)
        donors = [NewEvaluation(CALIBRATION, 0, number, "S1", setup, sets[number], Outcome.SIMULATED) for number in (0, 1)]
        simulate(connection, sequence, donors[:1], score=5)
        (proof,) = simulate(connection, sequence, donors[1:], score=3)
        donor = evaluations.own_exact(connection, sequence, "S1", setup, sets)[sets[0]]
        reused = NewEvaluation(CALIBRATION, 0, 2, "S1", setup, sets[2], Outcome.REUSED, donor=donor)
        (copy,) = evaluations.insert(connection, sequence, [reused])
        evaluations.note_proofs(connection, {copy: proof})
        believed, known = (
            list(results.answers(connection, sequence, CALIBRATION, corrected_by=evaluator))[-1]
            for evaluator in (None, EVALUATOR)
        )
    assert (believed.score, believed.own) == (5, False)
    assert (known.score, known.own) == (3, True)


def test_an_answer_by_a_withdrawn_certificate_counts_as_copied_until_the_very_cell_is_simulated(database: Database) -> None:
    with database.transaction() as connection:
        sequence, setup = campaign(connection).sequence, setup_id(connection)
        sets = sample_set_ids(connection, 2)
        cells = [
            NewEvaluation(CALIBRATION, 0, number, "S1", setup, each, Outcome.SIMULATED) for number, each in enumerate(sets)
        ]
        (proof,) = simulate(connection, sequence, cells[:1], score=5)
        (certified,) = evaluations.insert(connection, sequence, cells[1:])
        (stored,) = runs.insert_results(
            connection, [new_run(setup, sets[1], evaluation=certified, campaign_sequence=sequence, individual=1)]
        )
        evaluations.answer(connection, [AnsweredCell(certified, Outcome.CERTIFIED, 6, 6.0, stored.id, proven_by=proof)])

        def known(evaluator: str | None = EVALUATOR) -> tuple[float | None, bool]:
            answer = list(results.answers(connection, sequence, CALIBRATION, corrected_by=evaluator))[-1]
            return answer.score, answer.own

        assert (known(), results.withdrawn(connection, sequence)) == ((6, True), 0)
        assert results.best_simulated(connection, sequence, {"S1": 1}) == 6
        withdraw_certified(connection, [setup])
        assert known() == known(None) == (6, False)
        assert results.withdrawn(connection, sequence) == 1
        assert results.best_simulated(connection, sequence, {"S1": 1}) == 5
        copy = results.first_copy(connection, sequence, "S1", sets[1])
        assert copy is not None
        assert (copy.id, copy.reference) == (certified, proof)
        assert results.first_copy(connection, sequence, "S1", sets[0]) is None
        assert [results.by_id(connection, each).is_copied for each in (proof, certified)] == [False, True]
        assert runs.simulated_later(connection, sequence, EVALUATOR) == []
        again = replace(cells[1], stage=StageName.ROBUSTNESS)
        (corrects,) = simulate(connection, campaign(connection).sequence, [again], score=4)
        assert known() == (4, True)
        assert [run.evaluation for run in runs.simulated_later(connection, sequence, EVALUATOR)] == [corrects]
        later = replace(cells[1], iteration=1)
        (own,) = simulate(connection, sequence, [later], score=4)
        assert results.number_at(connection, sequence, 0, 1, "S1") == own
        outcomes = list(results.outcomes_of(connection, sequence, [sets[1]]))
        assert outcomes == [(sets[1], "S1", Outcome.REUSED), (sets[1], "S1", Outcome.SIMULATED)]


def test_pruning_leaves_the_simulation_that_corrects_a_withdrawn_answer(database: Database) -> None:
    with database.transaction() as connection:
        setup, (one,) = setup_id(connection), sample_set_ids(connection, 1)
        cell = NewEvaluation(CALIBRATION, 0, 0, "S1", setup, one, Outcome.CERTIFIED)
        certified = campaign(connection).sequence
        (withdrawn,) = evaluations.insert(connection, certified, [cell])
        evaluations.answer(connection, [AnsweredCell(withdrawn, Outcome.CERTIFIED, 6, 6.0, None)])
        study = campaign(connection).sequence
        simulate(connection, study, [replace(cell, plan=Outcome.SIMULATED)], score=4)
        assert mark(connection, {study}, {}).cells == 0
        assert mark(connection, {study, certified}, {}).cells == 2


def test_a_confirmed_cell_counts_under_the_withdrawn_copy_that_had_answered_it(database: Database) -> None:
    with database.transaction() as connection:
        sequence, setup, (one,) = campaign(connection).sequence, setup_id(connection), sample_set_ids(connection, 1)
        cell = NewEvaluation(CALIBRATION, 1, 0, "S1", setup, one, Outcome.REPEATED)
        (copy,) = evaluations.insert(connection, sequence, [cell])
        evaluations.answer(connection, [AnsweredCell(copy, Outcome.REPEATED, 6, 6.0, None)])
        simulate(connection, sequence, [replace(cell, iteration=2, plan=Outcome.SIMULATED)])
        assert evaluations.confirmed(connection, sequence, 2) == {"S1": {Outcome.REPEATED: 1}}
