"""Predicted answers over HTTP and on the command line: counted, listed and exported as every other outcome."""

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from tests.integration.test_predicted_campaigns import SPACE, slowly
from tests.support.computed import ComputedBackend
from tests.support.runs import run_posted
from tests.support.server import RunningApi, serving

from drivecal.contracts.accounting import Accounting
from drivecal.contracts.campaign import Campaign
from drivecal.domain.evaluations import Outcome

CAMPAIGN = {
    "parameters": SPACE,
    "catalogue": ["S1", "S2"],
    "optimizer": {"kind": "genetic", "population": 400, "iterations": 4, "seed": 3},
    "reduction": {"mode": "predicted", "tolerance": 0.0, "limit": 0.05},
    "sensitivity": None,
}


@dataclass(frozen=True)
class Ended:
    api: RunningApi
    campaign: Campaign
    rows: list[dict[str, str]]
    """Rows of the exported table of evaluations."""


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ended]:
    with serving(f"sqlite:///{tmp_path_factory.mktemp('predicted') / 'drivecal.db'}") as api:
        identifier = run_posted(api, CAMPAIGN, ComputedBackend(answer=slowly))
        links = api.http.get(f"/api/v1/campaigns/{identifier}").json()["links"]
        exported = api.http.get(links["evaluations"], params={"format": "csv"}).text
        campaign = Campaign.model_validate(api.http.get(links["self"]).json())
        yield Ended(api, campaign, list(csv.DictReader(io.StringIO(exported))))


def test_the_account_has_what_predictions_saved_and_what_they_cost(ended: Ended) -> None:
    account = Accounting.model_validate(ended.api.http.get(ended.campaign.links["results"]).json()["accounting"])
    assert sum(scenario.predicted for scenario in account.scenarios) == ended.campaign.cells.predicted
    balance = {item.name: item.seconds for item in account.balance}
    assert balance["predicted"] > 0
    assert balance["predictor"] == pytest.approx(-sum(lots.seconds for lots in ended.campaign.released.values()))
    assert balance["dispatcher"] < 0, "look-ups, planning, and loading the predictors"
    assert account.net_seconds == pytest.approx(sum(balance.values()))


def test_no_ranked_set_has_a_predicted_score(ended: Ended) -> None:
    names = [parameter["name"] for parameter in SPACE]
    cells = {id(row): (row["scenario"], *(row[name] for name in names)) for row in ended.rows}
    known = {
        cells[id(row)] for row in ended.rows if row["outcome"] != Outcome.PREDICTED
    }  # a set may be proposed, and simulated, again
    predicted = {
        (row["iteration"], row["individual"])
        for row in ended.rows
        if row["outcome"] == Outcome.PREDICTED and cells[id(row)] not in known
    }
    assert predicted
    solutions = ended.api.http.get(ended.campaign.links["solutions"], params={"limit": 1000}).json()["items"]
    assert solutions
    assert not {(str(solution["iteration"]), str(solution["individual"])) for solution in solutions} & predicted
