"""Predicted answers over HTTP, counted as every other outcome."""

import pytest
from tests.integration.test_predicted_campaigns import SPACE, slowly
from tests.support.computed import ComputedBackend
from tests.support.runs import run_posted
from tests.support.server import RunningApi

from drivecal.contracts.accounting import Accounting
from drivecal.contracts.campaign import Campaign

CAMPAIGN = {
    "parameters": SPACE,
    "catalogue": ["S1", "S2"],
    "optimizer": {"kind": "genetic", "population": 400, "iterations": 4, "seed": 3},
    "reduction": {"mode": "predicted", "tolerance": 0.0, "limit": 0.05},
    "sensitivity": None,
}


def test_the_account_has_what_predictions_saved_and_what_they_cost(api: RunningApi) -> None:
    path = f"/api/v1/campaigns/{run_posted(api, CAMPAIGN, ComputedBackend(answer=slowly))}"
    campaign = Campaign.model_validate(api.http.get(path).json())
    account = Accounting.model_validate(api.http.get(campaign.links["results"]).json()["accounting"])
    assert sum(scenario.predicted for scenario in account.scenarios) == campaign.cells.predicted
    balance = {item.name: item.seconds for item in account.balance}
    assert balance["predicted"] > 0
    assert balance["predictor"] == pytest.approx(-sum(lots.seconds for lots in campaign.released.values()))
    assert balance["dispatcher"] < 0, "look-ups, planning, and loading the predictors"
    assert account.net_seconds == pytest.approx(sum(balance.values()))
