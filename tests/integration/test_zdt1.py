"""ZDT1 as a user's problem with two scores, whose dispatchers die. `test_problems_whole_way` kills a server of real workers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.support.computed import ComputedBackend
from tests.support.deaths import ends_in_spite_of_deaths
from tests.support.problems import store
from tests.support.runs import everything
from tests.support.user_problems import ZDT1, ZDT1_MODEL, ZDT1_SPEC

from drivecal.api import submission
from drivecal.api.dependencies import Limits
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.results.front import front_of
from drivecal.configuration.settings import load_settings
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database


def evaluated(scenario: str, cell: Cell) -> CellResult:
    namespace: dict[str, Any] = {}
    exec(ZDT1_MODEL, namespace)
    return CellResult(cell.id, None, None, namespace["evaluate"](dict(cell.parameters), scenario), None, 7.0)


def test_a_search_of_two_scores_ends_alike_in_spite_of_deaths(tmp_path: Path) -> None:
    search = ZDT1_SPEC["optimizer"] | {"population": 16, "iterations": 6}
    bound = [{"measure": "f2", "at_most": 4.0}]
    document = ZDT1_SPEC | {"optimizer": search, "constraints": bound, "reduction": {"mode": "exact"}}

    def begin(database: Database) -> StoredCampaign:
        store(database, ZDT1, {"model.py": ZDT1_MODEL})
        return submission.submit(database, Limits.of(load_settings()), CampaignSpecification.model_validate(document), None)

    def find(database: Database, campaign: StoredCampaign) -> Any:
        with database.read() as connection:
            ended = campaigns.get(connection, campaign.id)
        front = front_of(database, ended, resolved_spec(ended))
        return everything(database, campaign), front.points.tolist(), front.hypervolumes()

    ends = ends_in_spite_of_deaths(tmp_path, begin, lambda seed: ComputedBackend(seed=seed, answer=evaluated), find, stride=7)
    assert len(ends) > 5
    assert all(end == ends[0] for end in ends)
    _, front, growth = ends[0]
    assert len(front) > 2
    assert [volume for _, volume, _ in growth] == sorted(volume for _, volume, _ in growth)
