"""Chosen sets as files for calibration tools."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from sqlalchemy import update
from tests.integration.test_objectives import TWO, backend
from tests.support.runs import SMALL, run_posted
from tests.support.server import RunningApi, serving
from tests.support.several import SEARCH, installed

from drivecal.calibration_data import dcm
from drivecal.client import Client
from drivecal.contracts.tables import RobustnessRow
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import InvalidInputError, NotFoundError
from drivecal.storage import campaigns, studies
from drivecal.storage.engine import tables

SPEC = SMALL | {"optimizer": SEARCH | {"population": 12, "iterations": 3}, "reduction": {"mode": "exact"}, "objectives": TWO}
BASELINE = dict.fromkeys((f"P{number}" for number in range(1, 12)), 0.5)


@dataclass(frozen=True)
class Ended:
    api: RunningApi
    several: str
    """With two objectives and a baseline."""
    plain: str
    """With the weighted score alone."""


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ended]:
    with installed(), serving(f"sqlite:///{tmp_path_factory.mktemp('files') / 'drivecal.db'}") as api:
        changes: list[dict[str, Any]] = [{"baseline": BASELINE}, {"objectives": None, "optimizer": SMALL["optimizer"]}]
        yield Ended(api, *(run_posted(api, SPEC | change, backend()) for change in changes))


@pytest.mark.parametrize(
    ("query", "field"),
    [("set=0", "set"), ("set=1&front=1", "front"), ("set=999999", "set"), ("front=999999", "front"), ("other=1", "other")],
)
def test_a_set_that_does_not_exist_is_refused_by_its_field(ended: Ended, query: str, field: str) -> None:
    answer = ended.api.http.get(f"/api/v1/campaigns/{ended.several}/calibration-file?format=dcm&{query}")
    assert answer.status_code == 422
    assert [each["field"] for each in answer.json()["errors"]] == [field]


def test_only_studies_that_succeeded_say_how_robust_a_set_is(ended: Ended) -> None:
    with Client(ended.api.url) as client:
        chosen = client.front(ended.several)[0]
    studied = {"optimizer": None, "sensitivity": None, "robustness": {"of": ended.several, "delta": 0.1}}
    made = {}
    for state, degree in ((CampaignState.SUCCEEDED, 7), (CampaignState.CANCELLED, 1), (CampaignState.RUNNING, 2)):
        row = RobustnessRow(
            rank=1, objective=1.0, rating=1.0, degree=degree, at_least=False, radius=0.1, recommended=False, reason=None, region=0,
            scores=dict(chosen.scores), parameters=chosen.parameters, trials=[],
        )  # fmt: skip
        with ended.api.database.transaction() as connection:
            spec = campaigns.get(connection, ended.several).spec
            study = campaigns.insert(connection, name="study", spec={**spec, **studied})
            connection.execute(update(tables.campaigns).where(tables.campaigns.c.id == study.id).values(state=state))
            studies.save(connection, study.sequence, StageName.ROBUSTNESS, {"items": [row.model_dump(mode="json")]})
        made[state] = study.id
    with Client(ended.api.url) as client:
        assert client.front(ended.several)[0].degree == 7
        shown = [each for each in client.results(ended.several).studies if each.study.stage == "robustness"]
    assert [each.study.campaign for each in shown] == [made[CampaignState.SUCCEEDED]]


def facts(content: bytes) -> dict[str, str]:
    """Quality data of a DCM file."""
    lines = (line[2:].partition(": ") for line in content.decode().splitlines() if line.startswith("* "))
    return {name: text for name, _, text in lines}


def test_a_set_is_a_file_for_calibration_tools_in_the_ranking_that_was_asked_for(ended: Ended) -> None:
    with Client(ended.api.url) as client:
        solution = client.solutions(ended.plain, "S1=4", 2).items[1]
        known = facts(client.calibration_file(ended.plain, "dcm", 2, weights="S1=4", labels={"P1": "ACC_tGap_C"}))
        assert known["rank"] == "2"
        assert float(known["objective"]) == pytest.approx(solution.objective)
        assert known["weights"] == "S1=4"
        content = client.calibration_file(ended.plain, "dcm", 2, weights="S1=4", labels={"P1": "ACC_tGap_C"})
        read = {value.name: value.value for value in dcm.read(content, "set.dcm").characteristics}
        assert read["ACC_tGap_C"] == solution.parameters["P1"]
        assert set(read) - {"ACC_tGap_C"} == set(solution.parameters) - {"P1"}

        summary = client.front_summary(ended.several)
        of_front = facts(client.calibration_file(ended.several, "dcm", front=1))
        assert of_front["rank on the front"] == "1"
        assert {f"objective {goal.name}" for goal in summary.objectives} <= set(of_front)
        assert facts(client.calibration_file(ended.several, "dcm")) == of_front
        first = ended.api.http.get(f"/api/v1/campaigns/{ended.several}/calibration-file?format=dcm")
        assert "front-1-" in first.headers["content-disposition"]
        assert client.calibration_file(ended.plain, "csv").decode().startswith("name,value,unit,")
        with pytest.raises(InvalidInputError):
            client.calibration_file(ended.plain, "cdfx", front=1, score="x")
        with pytest.raises(NotFoundError):
            client.calibration_file("0" * 32, "dcm")
