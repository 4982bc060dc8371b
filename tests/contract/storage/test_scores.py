"""Scores of any scale are stored to the last bit, and whole ones come back as integers."""

from typing import Any

import pytest
from sqlalchemy import Connection
from tests.support.storage import EVALUATOR, campaign, cell, new_run, sample_set_ids, setup_id

from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import CellScore, Outcome, Rating
from drivecal.storage import campaigns, evaluations, results
from drivecal.storage.engine.database import Database
from drivecal.storage.evaluations import AnsweredCell
from drivecal.storage.references import ratings, reference_keys, runs

SCORES = (6, 6.0, 0.1 + 0.2, -3.25, 99.999999999, 1e-300, 1e18, 1e300, 0)
SHOWN = ["6", "6", repr(0.1 + 0.2), "-3.25", "99.999999999", "1e-300", "1e+18", "1e+300", "0"]


def test_scores_of_runs_and_of_their_keys(database: Database) -> None:
    with database.transaction() as connection:
        setup, sets = setup_id(connection), sample_set_ids(connection, len(SCORES))
        new = [new_run(setup, one, score=score, rating=score) for one, score in zip(sets, SCORES, strict=True)]
        stored = runs.insert_results(connection, new)
        assert runs.insert_results(connection, new) == stored
        ratings.insert(connection, "other 1", [(run.id, Rating(each, each)) for run, each in zip(stored, SCORES, strict=True)])
    keys = [number.to_bytes(16) for number in range(len(SCORES))]
    watermark = stored[-1].id
    reference_keys.sync(database, 1, setup, EVALUATOR, watermark, lambda _, values: keys[: len(values)])
    with database.read() as connection:
        for evaluator in (EVALUATOR, "other 1"):
            by_set = runs.look_up_exact(connection, setup, sets, evaluator, watermark)
            assert [repr(by_set[item].score) for item in sets] == SHOWN
        by_key = reference_keys.look_up(connection, 1, setup, keys, EVALUATOR, watermark)
        assert [repr(by_key[key].score) for key in keys] == SHOWN


@pytest.mark.parametrize("predicted", [False, True])
def test_scores_of_cells(connection: Connection, predicted: bool) -> None:
    sequence, setup = campaign(connection).sequence, setup_id(connection)
    cells = [
        cell(number, setup, one, predicted_score=score if predicted else None)
        for number, (one, score) in enumerate(zip(sample_set_ids(connection, len(SCORES)), SCORES, strict=True))
    ]
    ids = evaluations.insert(connection, sequence, cells)
    answers = [AnsweredCell(one, Outcome.SIMULATED, score, score, None) for one, score in zip(ids, SCORES, strict=True)]
    evaluations.answer(connection, answers)
    rows = list(results.stream(connection, sequence))
    assert [repr(row.score) for row in rows] == SHOWN
    assert [repr(row.predicted_score) for row in rows] == (SHOWN if predicted else ["None"] * len(SCORES))
    answered: list[CellScore] = list(results.answers(connection, sequence, StageName.CALIBRATION, corrected_by=EVALUATOR))
    assert [repr(each.score) for each in answered] == SHOWN


def test_campaigns_of_other_setups_rated_nothing_that_is_asked_for(connection: Connection) -> None:
    def rated_all(evaluator: str, *fingerprints: str) -> bool:
        return ratings.are_all_by(connection, evaluator, fingerprints)

    def start(spec: dict[str, Any], resolution: dict[str, Any] | None) -> int:
        sequence = campaigns.insert(connection, name="x", spec=spec).sequence
        campaigns.start(connection, sequence)
        if resolution is not None:
            campaigns.set_resolution(connection, sequence, resolution)
        return sequence

    assert rated_all("a 1", "f1")
    start({"robustness": None}, {"evaluator": "b 1", "setups": {"S1": "f1", "S2": "f2"}})
    assert (rated_all("a 1", "f2", "f3"), rated_all("a 1", "f3", "f4"), rated_all("b 1", "f1")) == (False, True, True)
    unknown = start({}, None)
    assert not rated_all("a 1", "f3")
    campaigns.set_resolution(connection, unknown, {"evaluator": "b 1", "setups": {"S1": "f2"}})
    assert rated_all("a 1", "f3")
    start({"robustness": {"samples": 5}}, {"evaluator": "b 1", "setups": {"S1": "f2"}})
    assert not rated_all("a 1", "f3"), "it simulates other vehicles, whose setups it does not list"
