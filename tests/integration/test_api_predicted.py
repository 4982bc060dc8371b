"""Predicted answers over HTTP and on the command line: counted, listed and exported as every other outcome."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import pytest
from tests.integration.test_predicted_campaigns import SPACE, slowly
from tests.support.command import command
from tests.support.computed import ComputedBackend
from tests.support.runs import run, run_posted
from tests.support.server import RunningApi, serving

from drivecal.contracts.accounting import Accounting
from drivecal.contracts.campaign import Campaign
from drivecal.domain.evaluations import Outcome
from drivecal.storage import campaigns

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
    """Of the table of evaluations, exported."""


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ended]:
    with serving(f"sqlite:///{tmp_path_factory.mktemp('predicted') / 'drivecal.db'}") as api:
        identifier = run_posted(api, CAMPAIGN, ComputedBackend(answer=slowly))
        links = api.http.get(f"/api/v1/campaigns/{identifier}").json()["links"]
        exported = api.http.get(links["evaluations"], params={"format": "csv"}).text
        campaign = Campaign.model_validate(api.http.get(links["self"]).json())
        yield Ended(api, campaign, list(csv.DictReader(io.StringIO(exported))))


def later_of(ended: Ended) -> list[dict[str, Any]]:
    verdicts = ended.api.http.get(ended.campaign.links["results"]).json()["trust"]["verdicts"]
    return [each for each in verdicts if each["code"].startswith("later")]


def test_the_account_has_what_predictions_saved_and_what_they_cost(ended: Ended) -> None:
    account = Accounting.model_validate(ended.api.http.get(ended.campaign.links["results"]).json()["accounting"])
    assert sum(scenario.predicted for scenario in account.scenarios) == ended.campaign.cells.predicted
    assert account.predicted_saved_seconds > 0
    assert account.predictor_seconds == pytest.approx(sum(lots.seconds for lots in ended.campaign.released.values()))
    assert account.net_seconds == pytest.approx(account.saved_seconds - sum(account.deductions.values()))


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


def test_a_better_set_that_a_study_shows_later_is_told_with_the_origin_of_its_scores(ended: Ended) -> None:
    """The study simulates every released prediction, and each has the highest score."""
    best = ended.campaign.best
    assert best is not None
    study = {
        "parameters": SPACE,
        "catalogue": ["S1", "S2"],
        "optimizer": None,
        "validation": {"of": ended.campaign.id, "samples": 10**6},
    }
    submitted = ended.api.http.post("/api/v1/campaigns", json=study).raise_for_status().json()["id"]
    assert later_of(ended) == []
    with ended.api.database.read() as connection:
        stored = campaigns.get(connection, submitted)
    highest = ComputedBackend(answer=lambda scenario, cell: replace(slowly(scenario, cell), score=7.0, rating=7.0))
    run(ended.api.database, stored, highest)
    [later] = later_of(ended)
    first = ended.api.http.get(ended.campaign.links["solutions"]).json()["items"][0]
    assert later["light"] == "amber"
    assert first["objective"] > best.objective == ended.api.http.get(ended.campaign.links["self"]).json()["best"]["objective"]
    assert (later["numbers"]["objective"], later["numbers"]["by"]) == (first["objective"], [submitted])

    place = (str(first["iteration"]), str(first["individual"]))
    answered = {row["scenario"]: row["outcome"] for row in ended.rows if (row["iteration"], row["individual"]) == place}
    page = ended.api.http.get(f"{ended.campaign.links['self']}/review?set=1").text
    page = page[page.index("<h2>Result</h2>") :]
    scores = page[: page.index("<h2>Parameters</h2>")]
    origins = dict(re.findall(r"<td>(S\d)</td>(?:<td[^>]*>[^<]*</td>){3}<td[^>]*>([^<]*)</td>", scores))
    assert origins.keys() == {"S1", "S2"}
    predicted = {scenario for scenario, outcome in answered.items() if outcome == Outcome.PREDICTED}
    assert predicted
    for scenario, origin in origins.items():
        assert (re.fullmatch(rf"simulated later \(\d+ of campaign {submitted[:8]}\)", origin) is not None) == (
            scenario in predicted
        )
    assert "chosen set is the best" in page
    cell = next(row for row in ended.rows if (row["iteration"], row["individual"], row["scenario"]) == (*place, min(predicted)))
    simulated = re.findall(r"\d+", origins[min(predicted)])[0]
    explained = command("explain", ended.campaign.id, cell["id"], "--url", ended.api.url)
    assert f"Evaluation {simulated} of campaign {submitted} simulated this very cell later: score 7" in explained.stdout
