"""Tests of what validations and audits showed of an influence map stays with it: later campaigns are warned."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from tests.support.computed import ComputedBackend
from tests.support.runs import get, influenced, nothing_matters, post_map, run, submit

from drivecal.api.dependencies import Limits
from drivecal.api.submission import expected, rerun
from drivecal.configuration.settings import load_settings
from drivecal.contracts.specification import CampaignSpecification, RerunSpecification
from drivecal.domain.events import EventKind
from drivecal.storage import events
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

LIMITS = Limits.of(load_settings())
VALIDATION = {"samples": 20, "references": 3, "largest": 20}


def validated(database: Database, stored: str) -> StoredCampaign:
    study = submit(database, stored_map=stored, catalogue=["S1", "S3"], optimizer=None, validation=VALIDATION)
    return run(database, study, ComputedBackend(answer=influenced))


@pytest.mark.slow
def test_a_map_that_a_validation_refuted_is_used_with_a_warning(database: Database) -> None:
    stored = post_map(database, nothing_matters())
    before = run(database, submit(database, stored_map=stored, reduction={"audit": 0.0}), ComputedBackend(answer=influenced))
    assert before.notes == ()
    study = validated(database, stored)
    after = submit(database, stored_map=stored, reduction={"audit": 0.0, "max_error": 0.02})
    ended = run(database, after, ComputedBackend(answer=influenced))
    (note,) = (note for note in ended.notes if "wrong in S1" in note)
    assert study.id in note
    assert get(database, before).notes == (), "what was known when it began"
    uninspected = submit(database, stored_map=stored, reduction={"audit": 0.0, "max_error": 1})
    assert any("wrong in S1" in note for note in run(database, uninspected, ComputedBackend(answer=influenced)).notes)
    narrowed = submit(database, stored_map=stored, reduction={"mode": "predicted", "narrow": True})
    assert any("wrong in S1" in note for note in run(database, narrowed, ComputedBackend(answer=influenced)).notes)
    again = rerun(database, LIMITS, before.id, RerunSpecification(weights={"S1": 2.0}), None)
    assert any("wrong in S1" in note for note in again.notes), "the answer of the submission says it"
    with database.read() as connection:
        told = [
            event.data["text"] for event in events.since(connection, again.sequence, 0, 100) if event.kind == EventKind.NOTE
        ]
    assert told == list(again.notes)
    assert any("wrong in S1" in note for note in run(database, again, ComputedBackend(answer=influenced)).notes)
    unaffected = run(
        database, submit(database, stored_map=stored, reduction={"mode": "exact"}), ComputedBackend(answer=influenced)
    )
    assert unaffected.notes == ()


def test_the_preview_of_a_campaign_warns_as_well(database: Database) -> None:
    stored = post_map(database, nothing_matters())
    study = validated(database, stored)
    document = {**study.spec, "optimizer": {"kind": "random"}, "validation": None}
    assert document["sensitivity"] == {"map": stored}
    limits: Any = SimpleNamespace(largest_campaign=10**9)
    warned = [{"mode": "influence"}, {"mode": "both", "max_error": 1}, {"mode": "predicted", "narrow": True}]
    for reduction in warned:
        notes = expected(database, limits, CampaignSpecification.model_validate(document | {"reduction": reduction})).notes
        assert any(study.id in note for note in notes)
    predicted = CampaignSpecification.model_validate(document | {"reduction": {"mode": "predicted"}})
    assert not any(study.id in note for note in expected(database, limits, predicted).notes)
