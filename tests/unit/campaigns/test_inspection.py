"""Lots of a campaign that was interrupted."""

from types import SimpleNamespace
from typing import Any

import pytest

from drivecal.campaigns.cells.inspection import Inspection, check_reuse
from drivecal.contracts.campaign import ErrorRate
from drivecal.domain.evaluations import Outcome
from drivecal.domain.scales import COMFORT
from drivecal.storage import audits, lots
from drivecal.storage.lots import LotVerdict, StoredLot

REFERENCE = 17
NOTHING: Any = None


def test_a_lot_that_was_sampled_whole_still_has_its_verdict_when_its_reference_is_simulated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    verdicts: dict[int, tuple[LotVerdict, int]] = {}
    lot = StoredLot(1, 0, "S1", 3, 3, 0, 1.0, 0.02, 0, 0.0, Outcome.REUSED, 1, None, None)
    monkeypatch.setattr(lots, "of_campaign", lambda *_: [lot])
    monkeypatch.setattr(lots, "errors_so_far", lambda *_: {})
    monkeypatch.setattr(lots, "references", lambda *_: {1: {REFERENCE}})
    monkeypatch.setattr(lots, "conclude", lambda _, concluded: verdicts.update(concluded))
    monkeypatch.setattr(audits, "wrong_in_lots", lambda *_: {})
    monkeypatch.setattr(audits, "trusted", lambda *_: {})
    connection: Any = None
    waiting: Any = {REFERENCE: SimpleNamespace(id=REFERENCE, lot=None, inspected=False)}
    resumed = Inspection(1, "reference 1", COMFORT)
    assert resumed.load(connection, waiting) == {}
    assert resumed.conclude(connection, waiting) == ([], [])
    assert verdicts == {}
    assert resumed.conclude(connection, {}) == ([], [])
    assert verdicts == {1: (LotVerdict.RELEASED, 0)}


@pytest.mark.parametrize(("score", "verdict"), [(4.0, LotVerdict.RELEASED), (5.0, LotVerdict.REJECTED)])
def test_released_predictions_are_answered_by_lot(monkeypatch: pytest.MonkeyPatch, score: float, verdict: LotVerdict) -> None:
    """A statement for each cell, with an end for a lease that it never had, took as long as the plan of the next batch."""
    verdicts: dict[int, tuple[LotVerdict, int]] = {}
    answered: list[int] = []
    lot = StoredLot(1, 0, "S1", 3, 1, 0, 0.0, 0.05, 400, 0.0, Outcome.PREDICTED, 7, None, None)
    monkeypatch.setattr(lots, "of_campaign", lambda *_: [lot])
    monkeypatch.setattr(lots, "errors_so_far", lambda *_: {})
    monkeypatch.setattr(lots, "conclude", lambda _, concluded: verdicts.update(concluded))
    monkeypatch.setattr(lots, "release_predictions", lambda _, __, numbers: answered.extend(numbers))
    cells: Any = {
        number: SimpleNamespace(id=number, lot=7, inspected=number == 1, predicted_score=4.0, predicted_rating=4.2)
        for number in (1, 2, 3)
    }
    inspection = Inspection(1, "reference 1", COMFORT)
    assert inspection.load(NOTHING, cells) == {}
    assert inspection.conclude(NOTHING, cells) == ([], [])
    assert inspection.compare(cells[1], score) is (verdict is LotVerdict.RELEASED)
    released, simulated = inspection.conclude(NOTHING, {2, 3})
    assert {number: told for number, (told, _) in verdicts.items()} == {7: verdict}
    if verdict is LotVerdict.RELEASED:
        answers = [(answer.outcome, answer.score, answer.rating) for _, answer in released]
        assert answers == [(Outcome.PREDICTED, 4.0, 4.2)] * 2
        assert (answered, simulated) == ([7], [])
    else:
        assert (answered, released) == ([], [])
        assert simulated == [cells[2], cells[3]]


def test_reuse_without_an_influence_map_is_not_checked() -> None:
    view: Any = SimpleNamespace(influence_map=None)
    assert check_reuse(NOTHING, view, 3, ["S1", "S2"], {}) == {"S1": ErrorRate(), "S2": ErrorRate()}
