from itertools import product

import pytest
from sqlalchemy import Connection
from tests.support.storage import EVALUATOR, begun, campaign, new_evaluation, sample_sets, simulate

from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import InvalidInputError, NotFoundError
from drivecal.domain.evaluations import CellScore, Outcome
from drivecal.storage import evaluations, results
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.records import encode_cursor
from drivecal.storage.evaluations import AnsweredCell
from drivecal.storage.references import runs
from drivecal.storage.results import StoredEvaluation

CALIBRATION = StageName.CALIBRATION


def test_pages_and_stream_give_every_row_once_in_order(connection: Connection) -> None:
    sequence, setup, (one,) = begun(connection, 1)
    places = list(product((1, 0), (2, 1, 0, 10), ("S2", "S10", "S1", "s1")))
    cells = [new_evaluation(CALIBRATION, i, n, scenario, setup, one, Outcome.SIMULATED) for i, n, scenario in places]
    evaluations.insert(connection, sequence, cells)
    evaluations.insert(connection, campaign(connection).sequence, cells)
    result: list[StoredEvaluation] = []
    cursor = None
    while True:
        page, cursor = results.page(connection, sequence, limit=5, cursor=cursor)
        result.extend(page)
        if cursor is None:
            break
    assert list(results.stream(connection, sequence)) == result
    assert [(item.iteration, item.individual, item.scenario) for item in result] == sorted(places)
    assert result[0].parameters.floats == {"P1": 0.0, "P2": 5.0}
    assert {type(value) for value in result[0].parameters.floats.values()} == {float}


@pytest.mark.parametrize("cursor", ["", "x", "W10", "WzEsMl0", encode_cursor(2, 0, 2**40, "S1"), encode_cursor(2, 0, 0, "S\0")])
def test_a_cursor_that_is_not_of_this_list_is_refused_by_name(database: Database, cursor: str) -> None:
    with (
        database.read() as connection,
        pytest.raises(InvalidInputError, check=lambda error: error.problems[0].field == "cursor"),
    ):
        results.page(connection, 1, cursor=cursor)


@pytest.mark.parametrize("unknown", [0, -1, 1, 2**63, 10**30])
def test_an_evaluation_that_is_not_there_is_not_found(database: Database, unknown: int) -> None:
    with database.read() as connection, pytest.raises(NotFoundError, check=lambda error: error.kind == "evaluation"):
        results.by_id(connection, unknown)


def test_answers_say_whether_they_are_the_sets_own(connection: Connection) -> None:
    sequence, setup, sets = begun(connection, 3)
    first = new_evaluation(CALIBRATION, 0, 5, "S1", setup, sets[0], Outcome.SIMULATED)
    simulate(connection, sequence, [first], score=5)
    donor = evaluations.own_answers(connection, sequence, "S1", setup, sets)[sets[0]]
    copies = [
        new_evaluation(CALIBRATION, 0, 6, "S1", setup, sets[1], Outcome.REUSED, donor=donor),
        new_evaluation(CALIBRATION, 1, 0, "S1", setup, sets[0], Outcome.REPEATED, donor=donor),
    ]
    evaluations.insert(connection, sequence, copies)
    waiting = [new_evaluation(CALIBRATION, 1, n, "S2", setup, sets[n], Outcome.SIMULATED) for n in (0, 1)]
    broken, _ = evaluations.insert(connection, sequence, waiting)
    evaluations.answer(connection, [AnsweredCell(broken, Outcome.FAILED, None, None, None, failure="crash")])
    everything = list(results.answers(connection, sequence, CALIBRATION))
    assert everything == [
        CellScore(sets[0], "S1", 5, 5.25, own=True, iteration=0, individual=5),
        CellScore(sets[1], "S1", 5, 5.25, own=False, iteration=0, individual=6),
        CellScore(sets[0], "S1", 5, 5.25, own=True, iteration=1, individual=0),
        CellScore(sets[0], "S2", None, None, own=True, iteration=1, individual=0),
    ]
    assert {type(item.own) for item in everything} == {bool}
    assert list(results.answers(connection, sequence, CALIBRATION, iteration=1)) == everything[2:]
    assert list(results.answers(connection, sequence, StageName.SENSITIVITY)) == []


def test_donors_are_the_simulated_cells_of_a_stage_with_their_sets(connection: Connection) -> None:
    sequence, setup, sets = begun(connection, 3)
    cells = [new_evaluation(StageName.SENSITIVITY, 4, n, "S1", setup, one, Outcome.SIMULATED) for n, one in enumerate(sets[:2])]
    first, second = simulate(connection, sequence, cells)
    waiting = [new_evaluation(StageName.SENSITIVITY, 5, 0, "S1", setup, sets[2], Outcome.SIMULATED)]
    evaluations.insert(connection, sequence, waiting)
    zero, one, _ = sample_sets(3)
    assert list(results.donors(connection, sequence, StageName.SENSITIVITY)) == [(first, "S1", zero), (second, "S1", one)]
    assert list(results.donors(connection, sequence, CALIBRATION)) == []
    asked = [results.is_requested(connection, sequence, StageName.SENSITIVITY, iteration) for iteration in (3, 4, 5)]
    assert asked == [False, True, True]
    assert not results.is_requested(connection, sequence, CALIBRATION, 4)


def test_a_copied_score_gives_way_to_the_run_of_the_very_cell(connection: Connection) -> None:
    """By any campaign, under the same evaluator, if it is wanted."""
    sequence, setup, sets = begun(connection, 3)
    simulate(connection, sequence, [new_evaluation(CALIBRATION, 0, 0, "S1", setup, sets[0], Outcome.SIMULATED)], score=5)
    donor = evaluations.own_answers(connection, sequence, "S1", setup, sets)[sets[0]]
    reused = new_evaluation(CALIBRATION, 0, 1, "S1", setup, sets[1], Outcome.REUSED, donor=donor)
    predicted = new_evaluation(CALIBRATION, 0, 2, "S1", setup, sets[2], Outcome.PREDICTED)
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
    own = [new_evaluation(StageName.ROBUSTNESS, 0, number, "S1", setup, each, Outcome.SIMULATED) for number, each in places]
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
