"""Lots of a campaign, over stored rows."""

from collections.abc import Collection, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from sqlalchemy import Connection
from tests.support.databases import migrated
from tests.support.storage import EVALUATOR, campaign, cell, new_run, sample_set_ids, setup_id

from drivecal.campaigns.cells.inspection import Inspection, check_reuse, notes_on_lots
from drivecal.contracts.campaign import ErrorRate
from drivecal.domain.evaluations import Outcome
from drivecal.domain.scales import COMFORT
from drivecal.storage import evaluations, lots, results
from drivecal.storage.evaluations import AnsweredCell
from drivecal.storage.lots import LotVerdict, NewLot
from drivecal.storage.references import runs
from drivecal.storage.results import StoredEvaluation

NOTHING: Any = None


@pytest.fixture
def connection(tmp_path: Path) -> Iterator[Connection]:
    with migrated(f"sqlite:///{tmp_path / 'drivecal.db'}").transaction() as opened:
        yield opened


def stored(connection: Connection, kind: Outcome, sample: int, **members: Any) -> tuple[int, int]:
    """Stores a cell that is to be simulated and a lot of three others. Returns the ids of the campaign and of the lot."""
    sequence, setup, sets = campaign(connection).sequence, setup_id(connection), sample_set_ids(connection, 4)
    (number,) = lots.insert(connection, sequence, [NewLot(0, 0, "S1", 3, sample, 0, 0.0, 0.05, 400, 0.0, kind)])
    others = [cell(place, setup, sets[place], plan=kind, lot=number, **members) for place in (1, 2, 3)]
    evaluations.insert(connection, sequence, [cell(0, setup, sets[0]), *others])
    return sequence, number


def simulate(connection: Connection, cells: Collection[StoredEvaluation], score: float) -> None:
    for each in cells:
        run = new_run(each.setup_id, each.parameter_set_id, evaluation=each.id, individual=each.individual, score=score)
        (result,) = runs.insert_results(connection, [run])
        evaluations.answer(connection, [AnsweredCell(each.id, Outcome.SIMULATED, score, score, result.id)])


def resumed(connection: Connection, number: int) -> tuple[Inspection, dict[int, StoredEvaluation], dict[int, StoredEvaluation]]:
    """Returns an inspection that starts from the rows, the cells that it drew, and all that wait."""
    inspection = Inspection(number, EVALUATOR, COMFORT)
    waiting = {each.id: each for each in results.pending(connection, number)}
    return inspection, inspection.load(connection, waiting), waiting


def test_a_lot_that_was_sampled_whole_has_its_verdict_after_its_reference(connection: Connection) -> None:
    sequence, number = stored(connection, Outcome.REUSED, sample=3, leader=0)
    _, drawn, _ = resumed(connection, sequence)
    simulate(connection, drawn.values(), 5.0)
    inspection, drawn, waiting = resumed(connection, sequence)
    assert (len(drawn), len(waiting)) == (0, 1)
    assert inspection.conclude(connection, waiting) == ([], [])
    assert lots.by_id(connection, number).verdict is None
    simulate(connection, waiting.values(), 5.0)
    assert inspection.conclude(connection, {}) == ([], [])
    concluded = lots.by_id(connection, number)
    assert (concluded.verdict, concluded.errors) == (LotVerdict.RELEASED, 0)


@pytest.mark.parametrize(("score", "verdict"), [(4.0, LotVerdict.RELEASED), (5.0, LotVerdict.REJECTED)])
def test_predictions_of_a_released_lot_answer_its_cells(connection: Connection, score: float, verdict: LotVerdict) -> None:
    prediction = {"predicted_score": 4.0, "predicted_rating": 4.2, "confidence": 0.9}
    sequence, number = stored(connection, Outcome.PREDICTED, sample=1, **prediction)
    inspection, drawn, waiting = resumed(connection, sequence)
    (sampled,) = drawn.values()
    assert inspection.conclude(connection, waiting) == ([], [])
    simulate(connection, [sampled], score)
    assert inspection.compare(sampled, score) is (verdict is LotVerdict.RELEASED)
    _, simulated = inspection.conclude(connection, waiting.keys() - drawn.keys())
    assert lots.by_id(connection, number).verdict is verdict
    rows = [each for each in results.stream(connection, sequence) if each.lot == number and each.id not in drawn]
    if verdict is LotVerdict.RELEASED:
        assert [(each.outcome, each.score, each.rating) for each in rows] == [(Outcome.PREDICTED, 4.0, 4.2)] * 2
        assert simulated == []
    else:
        assert [(each.outcome, each.id) for each in rows] == [(None, each.id) for each in simulated]


def test_reuse_without_an_influence_map_is_not_checked() -> None:
    view: Any = SimpleNamespace(influence_map=None)
    assert check_reuse(NOTHING, view, 3, ["S1", "S2"], {}) == {"S1": ErrorRate(), "S2": ErrorRate()}


@pytest.mark.parametrize(("sampled", "rejected", "notes"), [(50, 0, 0), (51, 0, 1), (51, 1, 2), (20, 1, 1), (0, 0, 0)])
def test_lots_that_save_little_are_noted(sampled: int, rejected: int, notes: int) -> None:
    rates = {
        "S1": ErrorRate(audited=200, lots=9, inspected=100, sampled=sampled, rejected=rejected),
        "S2": ErrorRate(audited=3),
    }
    assert len(notes_on_lots(rates)) == notes
