"""Lots of a campaign that was interrupted."""

from types import SimpleNamespace
from typing import Any

import pytest

from drivecal.campaigns.cells.inspection import Inspection
from drivecal.domain.evaluations import Outcome
from drivecal.domain.scales import COMFORT
from drivecal.storage import audits, lots
from drivecal.storage.lots import LotVerdict, StoredLot

REFERENCE = 17


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
    waiting: Any = {REFERENCE: SimpleNamespace(id=REFERENCE, lot=None, sampled=False, audited=False)}
    resumed = Inspection(1, "reference 1", COMFORT)
    assert resumed.load(connection, waiting) == {}
    assert resumed.conclude(connection, waiting) == ([], [])
    assert verdicts == {}
    assert resumed.conclude(connection, {}) == ([], [])
    assert verdicts == {1: (LotVerdict.RELEASED, 0)}
