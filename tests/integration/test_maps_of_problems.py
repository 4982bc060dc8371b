"""Influence maps of user problems: posted maps, and maps of analyses after another push."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support.computed import ComputedBackend
from tests.support.problems import LIMITS, store, submit_checked
from tests.support.runs import dispatcher

from drivecal.api import submission
from drivecal.campaigns.resolve.maps import basis_of, resolve_map
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.resolved_spec import problem_of
from drivecal.campaigns.resolve.spaces import space_to_document
from drivecal.campaigns.resolve.workbench import stored_bundles
from drivecal.contracts.specification import InfluenceMapSpecification, RerunSpecification
from drivecal.domain.errors import InvalidInputError
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps

EXAMPLE = Path(__file__).parents[2] / "deploy" / "examples" / "problems" / "python-function"
SCORES = {"cost": {"formula": "rms_jerk", "direction": "minimise", "range": [0, 100], "tolerance": 2, "failed": 100}}


def _ended_with_a_map(database: Database) -> StoredCampaign:
    """A cancelled campaign on a pushed problem, with the map of an analysis."""
    _push(database, "f1", SCORES)
    analysis = {"intervals": 3, "samples": 4, "threshold": 0.02}
    document = {"problem": "python-function", "sensitivity": analysis, "optimizer": {"population": 10, "iterations": 2}}
    queued = submit_checked(database, document)
    problem = problem_of(queued, stored_bundles(database))
    assert isinstance(problem, CalibrationProblem)
    with database.transaction() as connection:
        made = influence_maps.insert(
            connection,
            name="made",
            source=queued.id,
            driving_function=problem.bench.function,
            parameters=space_to_document(problem.space.searched),
            scenarios={},
            basis=basis_of(problem),
        )
        campaigns.set_influence_map(connection, queued.sequence, made.id)
        campaigns.request_action(connection, queued.id, "cancel")
    dispatcher(database, ComputedBackend()).step()
    with database.read() as connection:
        return campaigns.get(connection, queued.id)


def test_a_campaign_uses_a_map_that_was_posted_for_its_problem_and_no_other(database: Database) -> None:
    _push(database, "f1", SCORES)
    given = {"problem": "python-function", "scenarios": {"wet": {"warning": {"influential": False}}}}
    motorway = {"scenarios": {"S1": {"P1": {"influential": False}}}}
    posted, other = (
        resolve_map(InfluenceMapSpecification.model_validate(each), stored_bundles(database)) for each in (given, motorway)
    )
    with database.transaction() as connection:
        own, foreign = (influence_maps.insert(connection, **each).id for each in (posted, other))
    document = {"problem": "python-function", "optimizer": {"population": 10, "iterations": 2}}

    def submitted(map_id: str) -> StoredCampaign:
        return submit_checked(database, document | {"sensitivity": {"map": map_id}})

    assert submitted(own).influence_map_id == own
    with pytest.raises(InvalidInputError, check=lambda error: error.problems[0].field == "sensitivity.map"):
        submitted(foreign)


def _push(database: Database, file: str, scores: Mapping[str, Any]) -> str:
    """Stores a problem; gives its digest."""
    document = yaml.safe_load((EXAMPLE / "problem.yaml").read_text()) | {"scores": dict(scores)}
    return store(database, document, {"braking.py": file})


@pytest.mark.parametrize(
    ("file", "change", "again"),
    [("f1", {"unit": "EUR"}, False), ("f2", {}, True), ("f1", {"tolerance": 9}, True), ("f1", {"range": [0, 90]}, True)],
)
def test_a_rerun_analyses_again_if_no_map_holds(database: Database, file: str, change: dict[str, Any], *, again: bool) -> None:
    first = _ended_with_a_map(database)
    digest = _push(database, file, {"cost": SCORES["cost"] | change})
    changes = RerunSpecification.model_validate({"weights": {}, "problem": "python-function"})
    rerun = submission.rerun(database, LIMITS, first.id, changes, None)
    assert rerun.spec["problem"] == digest
    if again:
        assert rerun.spec["sensitivity"] == first.spec["sensitivity"]
        assert rerun.influence_map_id is None
    else:
        assert rerun.influence_map_id == first.influence_map_id
