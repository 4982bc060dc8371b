"""Lots of predictions and of references: stored with their batch, sampled after their commit, and concluded once."""

from dataclasses import replace

import pytest
from sqlalchemy import Connection
from tests.support.storage import begun, campaign, new_evaluation, new_run, simulate

from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome, Purpose
from drivecal.domain.scales import COMFORT
from drivecal.storage import audits, campaigns, evaluations, lots, results
from drivecal.storage.evaluations import AnsweredCell
from drivecal.storage.lots import LotVerdict, NewLot
from drivecal.storage.references import runs

CALIBRATION = StageName.CALIBRATION
LOT = NewLot(2, 0, "S1", 3, 1, 0, 0.0, 0.05, 400, 0.25, Outcome.PREDICTED)


def test_samples_are_drawn_by_the_seed_of_their_campaign(connection: Connection) -> None:
    one, same, other = (
        campaigns.insert(connection, name="seeded", spec={"optimizer": {"seed": seed}}).sequence for seed in (1, 1, 2)
    )
    assert lots.sample_key(connection, one) == lots.sample_key(connection, same) != lots.sample_key(connection, other)


def test_lots_keep_their_order_and_wait_for_their_verdict(connection: Connection) -> None:
    sequence, other = campaign(connection).sequence, campaign(connection).sequence
    assert lots.insert(connection, sequence, []) == []
    numbers = lots.insert(connection, sequence, [LOT, replace(LOT, scenario="S2", size=0, sample=0)])
    lots.insert(connection, other, [LOT])
    lots.conclude(connection, {numbers[0]: (LotVerdict.RELEASED, 0)})
    first, second = lots.of_campaign(connection, sequence)
    assert (first.id, second.id) == tuple(numbers)
    assert (first.verdict, first.errors, first.released) == (LotVerdict.RELEASED, 0, 2)
    assert (second.verdict, second.errors, second.released) == (None, None, 0)
    assert (first.aoql, first.known, first.seconds) == (0.05, 400, 0.25)


def test_lots_of_both_kinds_may_belong_to_a_batch_and_are_told_apart(connection: Connection) -> None:
    reused = replace(LOT, kind=Outcome.REUSED, known=0, seconds=0.0)
    sequence = campaign(connection).sequence
    first, second, other = lots.insert(connection, sequence, [LOT, reused, replace(reused, scenario="S2")])
    lots.conclude(
        connection, {first: (LotVerdict.RELEASED, 0), second: (LotVerdict.REJECTED, 1), other: (LotVerdict.RELEASED, 0)}
    )
    assert [lot.id for lot in lots.of_campaign(connection, sequence)] == [first, second, other]
    assert [lot.id for lot in lots.of_campaign(connection, sequence, Outcome.REUSED)] == [second, other]
    assert lots.by_id(connection, second).kind is Outcome.REUSED


def test_a_lot_of_references_waits_is_drawn_as_audits_and_compared_with_its_references(connection: Connection) -> None:
    sequence, setup, sets = begun(connection, 6)
    (number,) = lots.insert(connection, sequence, [replace(LOT, kind=Outcome.REUSED, size=4, sample=3)])
    cell = new_evaluation(CALIBRATION, 0, 0, "S1", setup, sets[0], Outcome.SIMULATED, reference_key=b"key")
    (reference,) = simulate(connection, sequence, [cell], score=5, rating=5.25)
    donor = evaluations.own_answers(connection, sequence, "S1", setup, [b"key"], by_key=True)[b"key"]
    bare = replace(cell, iteration=2, plan=Outcome.REUSED, lot=number)
    leader = replace(bare, individual=4, parameter_set_id=sets[5], plan=Outcome.SIMULATED, lot=None)
    members = [replace(bare, individual=place, parameter_set_id=sets[place + 1], donor=donor) for place in range(3)]
    evaluations.insert(
        connection, sequence, [leader, *members, replace(bare, individual=3, parameter_set_id=sets[4], leader=0)]
    )
    waiting = {cell.individual: cell for cell in results.pending(connection, sequence)}
    assert set(waiting) == {0, 1, 2, 3, 4}, "no answer before the verdict"
    drawn = [waiting[0].id, waiting[1].id, waiting[3].id]
    assert lots.references(connection, sequence, [number]) == {number: {reference, waiting[4].id}}
    assert lots.references(connection, sequence, []) == {}
    evaluations.simulate(connection, drawn, purpose=Purpose.AUDIT)
    cells = {cell.individual: cell for cell in results.pending(connection, sequence)}
    assert [(cells[0].plan, cells[0].purpose)] == [(Outcome.SIMULATED, "audit")]
    assert cells[0].reference == reference, "what it is compared with"
    answers = [
        AnsweredCell(drawn[0], Outcome.SIMULATED, 4, 4.0, donor.run),
        AnsweredCell(drawn[1], Outcome.SIMULATED, 3, 3.0, donor.run),
        AnsweredCell(drawn[2], Outcome.SIMULATED, 0, 0.0, donor.run),
        AnsweredCell(waiting[4].id, Outcome.FAILED, None, None, None),
    ]
    evaluations.answer(connection, answers)
    asked = connection, sequence, "reference@1", COMFORT, [number]
    assert audits.wrong_in_lots(*asked) == {number: 1}, "a point is no error, and a reference without a result is none"
    assert audits.wrong_in_lots(*asked[:4], []) == {}
    trusted = audits.trusted(connection, sequence, "reference@1", [reference, waiting[4].id])
    assert trusted == {reference: donor}


def test_samples_are_simulated_compared_and_known_with_their_weight(connection: Connection) -> None:
    sequence, setup, sets = begun(connection, 4)
    (number,) = lots.insert(connection, sequence, [LOT])
    bare = new_evaluation(CALIBRATION, 2, 0, "S1", setup, sets[0], Outcome.PREDICTED)
    predicted = [
        replace(bare, individual=place, parameter_set_id=sets[place], lot=number, confidence=0.9, predicted_score=4)
        for place in range(3)
    ]
    simulate(connection, sequence, [replace(bare, individual=3, parameter_set_id=sets[3], plan=Outcome.SIMULATED)], score=5)
    evaluations.insert(connection, sequence, [replace(cell, predicted_rating=4.2) for cell in predicted])
    waiting = results.pending(connection, sequence)
    drawn = waiting[1]
    run = new_run(setup, drawn.parameter_set_id, evaluation=drawn.id, campaign_sequence=sequence, score=3, rating=3.1)
    (own,) = runs.insert_results(connection, [run])
    evaluations.simulate(connection, [drawn.id], purpose=Purpose.SAMPLE)
    assert lots.errors_so_far(connection, sequence, [number]) == {}
    cells = {cell.id: cell for cell in results.pending(connection, sequence)}
    assert (cells[drawn.id].plan, cells[drawn.id].purpose) == (Outcome.SIMULATED, "sample")
    evaluations.answer(connection, [AnsweredCell(drawn.id, Outcome.SIMULATED, 3, 3.1, own.id, milliseconds=8.0, agrees=False)])
    rest = [number for number in cells if number != drawn.id]
    lots.release_predictions(connection, sequence + 1, [number])
    lots.release_predictions(connection, sequence, [])
    assert results.pending(connection, sequence) != []
    lots.release_predictions(connection, sequence, [number])
    assert results.pending(connection, sequence) == []
    assert lots.errors_so_far(connection, sequence, [number]) == {number: 1}
    assert lots.errors_so_far(connection, sequence, []) == {}
    lots.conclude(connection, {number: (LotVerdict.RELEASED, 1)})
    known, newest = lots.known_answers(connection, sequence, [setup], after=0)
    assert lots.known_answers(connection, sequence, [setup], after=newest) == ([], newest)
    released = results.released(connection, sequence)
    occupied, last = evaluations.occupied(connection, sequence, after=0)
    assert evaluations.occupied(connection, sequence, last) == ({}, last)
    assert evaluations.occupied(connection, sequence, last - 1)[0]["S1"][0] == 1
    assert [(answer.individual, answer.score, answer.stands_for) for answer in known] == [(1, 3, 3.0), (3, 5, 1.0)]
    assert [(answer.predicted_score, answer.confidence) for answer in known] == [(4, 0.9), (None, None)]
    assert [(cell.id, cell.score, cell.rating) for cell in released] == [(cell, 4, 4.2) for cell in sorted(rest)]
    assert occupied == {"S1": (2, 14_000)}


@pytest.mark.parametrize("outcome", [Outcome.PREDICTED, Outcome.REUSED])
def test_predicted_answers_are_not_the_sets_own(connection: Connection, outcome: Outcome) -> None:
    sequence, setup, (own,) = begun(connection, 1)
    cell = new_evaluation(CALIBRATION, 0, 0, "S1", setup, own, outcome)
    evaluations.insert(connection, sequence, [cell])
    (waiting,) = results.pending(connection, sequence)
    evaluations.answer(connection, [AnsweredCell(waiting.id, outcome, 4, 4.2, run_id=None)])
    assert evaluations.own_answers(connection, sequence, "S1", setup, [own]) == {}
    (answer,) = results.answers(connection, sequence, CALIBRATION)
    assert (answer.own, answer.predicted) == (False, outcome is Outcome.PREDICTED)
