"""What validations and audits showed of an influence map stays with it: later campaigns are warned."""

from __future__ import annotations

from datetime import timedelta
from types import SimpleNamespace
from typing import Any

from tests.support.computed import ComputedBackend
from tests.support.runs import get, influenced, nothing_matters, post_map, run, submit

from drivecal.api.submission import expected
from drivecal.campaigns.resolve.maps import doubts
from drivecal.contracts.specification import CampaignSpecification
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

VALIDATION = {"samples": 20, "references": 3, "largest": 20}


def validated(database: Database, stored: str) -> StoredCampaign:
    study = submit(database, stored_map=stored, catalogue=["S1", "S3"], optimizer=None, validation=VALIDATION)
    return run(database, study, ComputedBackend(answer=influenced))


def test_a_map_that_a_validation_refuted_is_used_with_a_warning(database: Database) -> None:
    stored = post_map(database, nothing_matters())
    before = run(database, submit(database, stored_map=stored, reduction={"audit": 0.0}), ComputedBackend(answer=influenced))
    assert before.notes == ()
    study = validated(database, stored)
    after = submit(database, stored_map=stored, reduction={"audit": 0.0})
    ended = run(database, after, ComputedBackend(answer=influenced))
    (note,) = (note for note in ended.notes if "S1" in note)
    assert study.id in note
    assert get(database, before).notes == (), "what was known when it began"
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
    notes = expected(database, limits, CampaignSpecification.model_validate(document)).notes
    assert any(study.id in note for note in notes)


def test_a_stopped_reuse_counts_and_small_errors_do_not(database: Database) -> None:
    stored = post_map(database, nothing_matters())
    stopped = run(
        database,
        submit(database, stored_map=stored, catalogue=["S1"], reduction={"audit": 1.0, "max_error": 0.001}),
        ComputedBackend(answer=influenced),
    )
    assert stopped.error_rate["S1"].stopped
    assert stopped.ended_at is not None
    with database.read() as connection:
        (note,) = doubts(connection, stored, 0.9, stopped.ended_at + timedelta(seconds=1))
        assert doubts(connection, stored, 0.9, stopped.ended_at) == []
    assert stopped.id in note
    study = validated(database, stored)
    assert study.ended_at is not None
    with database.read() as connection:
        scenarios = [note.split()[9] for note in doubts(connection, stored, 1.0, study.ended_at + timedelta(seconds=1))]
    assert scenarios == ["S1:"], "nothing is more wrong than wholly"
