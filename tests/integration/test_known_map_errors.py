"""Tests of what validations and audits showed of an influence map stays with it: later campaigns are warned."""

from types import SimpleNamespace
from typing import Any

from tests.support.computed import ComputedBackend
from tests.support.runs import influenced, nothing_matters, post_map, run, submit

from drivecal.api.expectation import expected
from drivecal.configuration.settings import Settings
from drivecal.contracts.specification import CampaignSpecification
from drivecal.storage.engine.database import Database


def test_the_preview_of_a_campaign_warns_as_well(database: Database) -> None:
    stored = post_map(database, nothing_matters())
    validation = {"samples": 20, "references": 3, "largest": 20}
    study = submit(database, stored_map=stored, catalogue=["S1", "S3"], optimizer=None, validation=validation)
    run(database, study, ComputedBackend(answer=influenced))
    document = {**study.spec, "optimizer": {"kind": "random"}, "validation": None}
    assert document["sensitivity"] == {"map": stored}
    limits: Any = SimpleNamespace(settings=Settings(largest_campaign=10**9))
    warned = [{"mode": "influence"}, {"mode": "both", "max_error": 1}]
    for reduction in warned:
        notes = expected(database, limits, CampaignSpecification.model_validate(document | {"reduction": reduction})).notes
        assert any(study.id in note for note in notes)
    predicted = CampaignSpecification.model_validate(document | {"reduction": {"mode": "predicted"}})
    assert not any(study.id in note for note in expected(database, limits, predicted).notes)
