import pytest
from sqlalchemy import Connection
from tests.support.storage import EVALUATOR, begun, campaign, cell, setup_id, simulate
from tests.support.values import COST

from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import AuditCount, Outcome, Purpose, Rating
from drivecal.storage import audits, evaluations, results
from drivecal.storage.engine.database import Database
from drivecal.storage.references import ratings, reference_keys, runs

KEY, OTHER_KEY = b"k" * 16, b"o" * 16


def audited(connection: Connection) -> tuple[int, list[int]]:
    """A campaign with a donor of score 5 and audits of it: scores 5, 4 in iteration 1, 2 in iteration 2, one pending."""
    sequence, setup, sets = begun(connection, 6)
    simulate(connection, sequence, [cell(0, setup, sets[0])], score=5)
    donor = evaluations.own_answers(connection, sequence, "S1", setup, sets)[sets[0]]
    ids: list[int] = []
    for number, (iteration, score) in enumerate([(1, 5), (1, 4), (2, 2)], 1):
        one = cell(number, setup, sets[number], iteration=iteration, donor=donor, purpose=Purpose.AUDIT)
        ids += simulate(connection, sequence, [one], score=score)
    ids += evaluations.insert(connection, sequence, [cell(4, setup, sets[4], iteration=2, donor=donor, purpose=Purpose.AUDIT)])
    evaluations.insert(connection, sequence, [cell(5, setup, sets[5], iteration=2, plan=Outcome.REUSED, donor=donor)])
    return sequence, ids


def test_audits_are_settled_by_comparing_the_score_with_the_donors(connection: Connection) -> None:
    sequence, (equal, other, later, waiting) = audited(connection)
    audits.settle(connection, sequence, StageName.CALIBRATION, 1, EVALUATOR)
    agrees = {item.id: item.agrees for item in results.stream(connection, sequence) if item.purpose == "audit"}
    assert agrees == {equal: True, other: False, later: None, waiting: None}


def test_a_donor_counts_as_the_campaigns_own_evaluator_rates_it(connection: Connection) -> None:
    """The evaluation that made a run may have been rated by another evaluator: its score is not the one to compare with."""
    sequence, setup, sets = begun(connection, 2)
    simulate(connection, campaign(connection).sequence, [cell(0, setup, sets[0])], score=5)
    ratings.insert(connection, "learned 1", [(runs.largest_id(connection), Rating(2.0, 2))])
    donor = runs.look_up_exact(connection, setup, sets, "learned 1", 10**6)[sets[0]]
    audit = cell(1, setup, sets[1], donor=donor, purpose=Purpose.AUDIT)
    simulate(connection, sequence, [audit], score=2)
    assert audits.count(connection, sequence, "learned 1") == [AuditCount("S1", audited=1, different=0, wrong=0)]
    audits.settle(connection, sequence, StageName.CALIBRATION, 0, "learned 1")
    assert [item.agrees for item in results.stream(connection, sequence)] == [True]


def test_a_donor_of_the_campaigns_own_counts_as_it_was_answered_whatever_is_stored_of_its_cell(connection: Connection) -> None:
    faster, (sequence, setup, sets) = campaign(connection).sequence, begun(connection, 2)
    simulate(connection, faster, [cell(0, setup, sets[0])], score=5)
    simulate(connection, sequence, [cell(0, setup, sets[0])], score=2)
    donor = evaluations.own_answers(connection, sequence, "S1", setup, sets)[sets[0]]
    simulate(connection, sequence, [cell(1, setup, sets[1], donor=donor, purpose=Purpose.AUDIT)], score=2)
    assert audits.count(connection, sequence, EVALUATOR) == [AuditCount("S1", audited=1, different=0, wrong=0)]
    audits.settle(connection, sequence, StageName.CALIBRATION, 0, EVALUATOR)
    assert [item.agrees for item in results.stream(connection, sequence) if item.purpose == "audit"] == [True]


@pytest.mark.parametrize(("scores", "expected"), [((5, 5), {}), ((5, 4), {"S1": 1}), ((5, 4, 3), {"S1": 1})])
def test_scores_under_one_key_contradict_once(
    connection: Connection, scores: tuple[int, ...], expected: dict[str, int]
) -> None:
    sequence, setup, sets = begun(connection, len(scores) + 2)
    for number, score in enumerate(scores):
        simulate(connection, sequence, [cell(number, setup, sets[number], reference_key=KEY)], score=score)
    others = [cell(90, setup, sets[-1], reference_key=OTHER_KEY), cell(91, setup, sets[-2])]
    simulate(connection, sequence, others, score=1)
    simulate(connection, sequence, [cell(0, setup, sets[0], scenario="S2", reference_key=KEY)], score=0)
    other = campaign(connection).sequence
    simulate(connection, other, [cell(0, setup, sets[-1], reference_key=KEY)], score=0)
    seeded = cell(0, setup_id(connection, "S1, seed 2"), sets[0], reference_key=KEY, seed=2, has_seed=True)
    simulate(connection, sequence, [seeded], score=0)
    assert audits.contradictions(connection, sequence, 0, EVALUATOR, 10**6) == expected


def test_a_stored_reference_contradicts_as_well_but_only_one_that_the_campaign_sees(database: Database) -> None:
    with database.transaction() as connection:
        first, (sequence, setup, sets) = campaign(connection).sequence, begun(connection, 2)
        simulate(connection, first, [cell(0, setup, sets[0])], score=5)
        watermark = runs.largest_id(connection)
        simulate(connection, sequence, [cell(0, setup, sets[1], reference_key=KEY)], score=3)
    reference_keys.sync(database, 1, setup, EVALUATOR, watermark, lambda _, values: [KEY] * len(values))
    with database.read() as connection:
        assert audits.contradictions(connection, sequence, 1, EVALUATOR, watermark) == {"S1": 1}
        assert audits.contradictions(connection, sequence, 1, EVALUATOR, watermark - 1) == {}
        assert audits.contradictions(connection, sequence, 1, "learned 1", watermark) == {}
        assert audits.contradictions(connection, sequence, 2, EVALUATOR, watermark) == {}


def test_scores_without_steps_are_compared_by_their_scale(connection: Connection) -> None:
    """Rounding is no difference; more than the tolerance of 2 is wrong."""
    sequence, setup, sets = begun(connection, 6)
    simulate(connection, sequence, [cell(0, setup, sets[0], reference_key=KEY)], score=50.25)
    donor = evaluations.own_answers(connection, sequence, "S1", setup, sets)[sets[0]]
    ids: list[int] = []
    for number, score in enumerate([50.25 + 1e-9, 50.26, 52.25, 47.0], 1):
        one = cell(
            number, setup, sets[number], donor=donor, purpose=Purpose.AUDIT, reference_key=KEY if number == 1 else OTHER_KEY
        )
        ids += simulate(connection, sequence, [one], score=score)
    audits.settle(connection, sequence, StageName.CALIBRATION, 0, EVALUATOR, COST)
    assert audits.count(connection, sequence, EVALUATOR, COST) == [AuditCount("S1", audited=4, different=3, wrong=1)]
    agrees = {item.id: item.agrees for item in results.stream(connection, sequence) if item.purpose == "audit"}
    assert [agrees[entry] for entry in ids] == [True, False, False, False]
    assert audits.contradictions(connection, sequence, 0, EVALUATOR, 10**6, COST) == {"S1": 1}
