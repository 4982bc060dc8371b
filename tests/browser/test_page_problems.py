"""The page for a problem of a user's own: other parameters, another scale, other time series, and no road."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect
from tests.browser.conftest import Opening, barriers, leave, unfold
from tests.support.computed import ComputedBackend
from tests.support.problems import MANIFEST, ROADS, heated, push, replayed, store
from tests.support.runs import run, submit, working
from tests.support.server import RunningApi, serving

from drivecal.client import Client
from drivecal.storage import campaigns, results
from drivecal.storage.campaigns import StoredCampaign

pytestmark = pytest.mark.slow

SPEC: dict[str, Any] = {
    "problem": "heater",
    **dict.fromkeys(("catalogue", "parameters", "driving_function")),
    "vehicle": {},
    "sensitivity": {"intervals": 3, "samples": 6, "threshold": "auto"},
    "optimizer": {"kind": "genetic", "population": 40, "iterations": 5, "seed": 2},
    "reduction": {"mode": "exact"},
}


@dataclass(frozen=True)
class Heated:
    """A server with a campaign on a pushed problem that has ended."""

    api: RunningApi
    campaign: StoredCampaign

    def at(self, *path: str) -> str:
        return f"{self.api.url}/#/campaigns/{'/'.join([self.campaign.id, *path])}"


@pytest.fixture(scope="module")
def heater(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Heated]:
    folder = tmp_path_factory.mktemp("heater")
    with serving(f"sqlite:///{folder / 'drivecal.db'}", home=str(folder / "home")) as api:
        push(api.database, folder / "problem")
        yield Heated(api, run(api.database, submit(api.database, **SPEC), ComputedBackend(answer=heated)))


def column(page: Page, name: str) -> list[str]:
    """The first values of a column as they are shown."""
    heads = [text.rstrip(" ↑↓") for text in page.get_by_role("columnheader").all_inner_texts()]
    rows = page.get_by_role("row").all()[1:8]
    return [row.get_by_role("gridcell").nth(heads.index(name)).inner_text() for row in rows]


def test_pushed_problems_are_listed_with_what_they_are(heater: Heated, opening: Opening) -> None:
    page = opening(f"{heater.api.url}/#/problems")
    row = page.get_by_role("table", name="Problems").get_by_role("row", name="heater")
    for text in ("4", "2", "command", "cost / EUR, 0 to 100, less is better", re.compile("just now|min ago")):
        expect(row).to_contain_text(text)
    expect(page.get_by_role("table", name="Problems").get_by_role("row", name="highway-random")).to_contain_text("11")
    assert barriers(page) == []
    page.get_by_role("link", name="heater", exact=True).click()
    expect(page.get_by_role("heading", level=1)).to_have_text("heater")
    parameters = page.get_by_role("table", name="Parameters")
    expect(parameters.get_by_role("row", name="mode")).to_contain_text("eco, normal, boost")
    expect(parameters.get_by_role("row", name="gain")).to_contain_text("Power for each degree below the set point")
    expect(page.get_by_role("table", name="Scores").get_by_role("row", name="cost")).to_contain_text(
        "10*energy_kwh + 5*discomfort"
    )
    expect(page.get_by_role("table", name="Scenarios").get_by_role("row", name="winter")).to_contain_text("outside -10")
    expect(page.get_by_text("gain <= 2*stage")).to_be_visible()
    assert barriers(page) == []
    page.goto(heater.at())
    page.get_by_role("link", name="heater", exact=True).press("Enter")  # a view that loads moves it under a mouse
    expect(page.get_by_role("heading", level=1)).to_have_text("heater")


def test_measured_values_lie_beside_simulated_ones_and_start_a_search(heater: Heated, opening: Opening) -> None:
    best = heater.api.http.get(f"/api/v1/campaigns/{heater.campaign.id}/solutions").json()["items"][0]["parameters"]
    row = {"parameters": best, "scenario": "winter", "scores": {"cost": 30.0}}
    given = {"problem": "heater", "source": "house 7", "date": "2026-11-20", "rows": [row]}
    assert heater.api.http.post("/api/v1/results", json=given).status_code == 201
    [listed] = heater.api.http.get("/api/v1/results?problem=heater").json()["items"]
    page = opening(f"{heater.api.url}/#/problems/heater")
    shown = page.get_by_role("table", name="Measured and simulated").get_by_role("row", name="house 7")
    expect(shown).to_contain_text(f"{listed['difference']:.2f}"[:-1])
    assert barriers(page) == []
    page.get_by_role("link", name="house 7").click()
    expect(page.get_by_label("start results")).to_have_value("house 7")


def test_a_choice_has_an_axis_with_its_words_and_can_be_brushed(heater: Heated, opening: Opening) -> None:
    page = opening(heater.at("evaluations"))
    plot = page.get_by_role("group", name="Parallel coordinates")
    for word in ("eco", "normal", "boost"):
        expect(plot.get_by_text(word, exact=True)).to_be_visible()
    for title in ("gain / W/K", "score / EUR"):
        expect(plot.get_by_role("slider", name=f"Range of {title}")).to_be_visible()
    mode = page.get_by_role("slider", name="Range of mode")
    mode.press("ArrowDown")
    expect(mode).to_have_attribute("aria-valuetext", "eco, normal")
    expect(page.get_by_role("group", name="Range of mode", exact=True)).to_contain_text("eco, normal")
    assert set(column(page, "mode")) <= {"eco", "normal"}


def test_less_is_better_where_the_score_says_so(heater: Heated, opening: Opening) -> None:
    page = opening(heater.at("ranking"))
    expect(page.get_by_text("Colour: objective")).to_contain_text("less is better")
    objective = page.get_by_role("columnheader", name="objective").get_by_role("button")
    objective.click()
    best = column(page, "objective")
    assert heater.campaign.best is not None
    assert best == sorted(best, key=float)
    assert float(best[0]) == round(heater.campaign.best.objective, 4)
    objective.click()
    assert float(column(page, "objective")[0]) > float(best[0])


def test_the_ranking_follows_another_score_at_once(heater: Heated, opening: Opening, tmp_path: Path) -> None:
    few = SPEC | {"sensitivity": None, "optimizer": {"kind": "random", "population": 8, "iterations": 1, "seed": 2}}
    identifier = heater.api.http.post("/api/v1/campaigns", json=few).raise_for_status().json()["id"]
    with heater.api.database.read() as connection:
        campaign = campaigns.get(connection, identifier)
    ranked = Heated(heater.api, run(heater.api.database, campaign, ComputedBackend(answer=heated)))

    def shows(score: str) -> None:
        """Waits until the ranking is that of the API under this score."""
        query = {"score": score, "limit": "1"}
        [best] = heater.api.http.get(f"/api/v1/campaigns/{identifier}/solutions", params=query).json()["items"]
        expect(page.get_by_role("row").nth(1).get_by_role("gridcell").nth(1)).to_have_text(f"{round(best['objective'], 4):.9g}")

    page = opening(ranked.at("ranking"))
    choice = page.get_by_label("Rank by")
    choice.select_option("ease")
    expect(page.get_by_text("Colour: objective")).not_to_contain_text("less is better")
    shows("ease")
    page.wait_for_url("**score=ease*")
    assert barriers(page) == []
    choice.select_option("")
    expect(page.get_by_text("Colour: objective")).to_contain_text("less is better")

    scores = {**MANIFEST["scores"], "cost": MANIFEST["scores"]["cost"] | {"formula": "2*energy_kwh"}}
    later = push(heater.api.database, tmp_path / "later", scores=scores).digest
    page.reload()
    choice.select_option(f"cost@{later}")
    shows(f"cost@{later}")
    push(heater.api.database, tmp_path / "again")


def test_an_evaluation_has_its_measures_and_the_series_of_its_simulator(heater: Heated, opening: Opening) -> None:
    with heater.api.database.read() as connection:
        rows, _ = results.page(connection, heater.campaign.sequence, limit=5)
    page = opening(f"{heater.api.url}/#/evaluations/{rows[0].id}")
    expect(page.get_by_text("Waiting for a worker")).to_be_visible()
    with working(heater.api.database, ComputedBackend(answer=heated)):
        expect(page.get_by_role("img", name="room, wanted: °C over time / s")).to_be_visible()
        expect(page.get_by_role("img", name="power: kW over time / s")).to_be_visible()
    row = page.get_by_role("table", name="Measures of the run").get_by_role("row", name="energy kwh")
    expect(row).to_contain_text("kWh")
    expect(page.get_by_role("heading", level=1)).to_contain_text(rows[0].scenario)
    expect(page.get_by_text("Top view of the road")).to_have_count(0)
    expect(page.get_by_text(MANIFEST["scores"]["cost"]["unit"]).first).to_be_visible()
    assert barriers(page) == []


def test_a_drive_is_replayed_without_declared_series(opening: Opening, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("roads")
    with serving(f"sqlite:///{folder / 'drivecal.db'}") as api:
        store(api.database, ROADS)
        roads = {"problem": "roads", "sensitivity": None, "optimizer": {"kind": "random", "population": 4, "iterations": 1}}
        run(api.database, submit(api.database, **SPEC | roads), ComputedBackend(answer=replayed))
        page = opening(f"{api.url}/#/evaluations/1")
        with working(api.database, ComputedBackend(answer=replayed)):
            expect(page.get_by_role("img", name="Top view of the road at 0 s, the ego vehicle and 1 others")).to_be_visible()
        page.get_by_role("button", name="A step ahead").click()
        expect(page.get_by_role("img", name=re.compile("Top view of the road at 1 s"))).to_be_visible()
        expect(page.get_by_text("108 km/h")).to_be_visible()
        assert barriers(page) == []
        page.close()


def test_a_campaign_on_a_problem_is_submitted_without_json(heater: Heated, opening: Opening) -> None:
    page = opening(f"{heater.api.url}/#/problems", expected=("422",))
    page.get_by_role("link", name="New campaign on heater").click()
    expect(page.get_by_label("score")).to_contain_text("cost / EUR, 0 to 100, less is better")
    unfold(page, "Search")
    page.get_by_role("button", name="quick").click()
    page.get_by_label("kind").select_option("genetic")
    page.get_by_label("population").fill("12")
    page.get_by_label("iterations").fill("2")
    page.get_by_label("mutation").fill("0.2")
    expect(page.get_by_text("for 48 proposed cells")).to_be_visible()
    page.get_by_role("checkbox", name="spring").uncheck()
    page.get_by_label("Weight of winter").fill("2")
    page.get_by_label("gain from").fill("3")
    page.get_by_label("gain from").blur()
    expect(page.get_by_role("group", name="Parameters")).to_contain_text("gain, to: ")
    expect(page.get_by_role("button", name="Start it")).to_be_disabled()
    page.get_by_label("gain from").fill("0.25")
    page.get_by_label("rooms held at").fill("3")
    page.get_by_role("checkbox", name="mode boost").uncheck()
    page.get_by_label("stage baseline").fill("1.5")
    page.get_by_label("stage baseline").blur()
    expect(page.get_by_text("for 24 proposed cells")).to_be_visible()
    assert barriers(page) == []
    page.get_by_role("button", name="Start it").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("campaign")
    stored = heater.api.http.get(f"/api/v1/campaigns/{page.url.rpartition('/')[2]}").json()["spec"]
    digest = heater.api.http.get("/api/v1/problems/heater").json()["digest"]
    assert (stored["problem"], stored["catalogue"], stored["weights"]) == (digest, ["winter"], {"winter": 2})
    assert (stored["fixed"], stored["baseline"]["stage"], stored["baseline"]["mode"]) == ({"rooms": 3}, 1.5, "normal")
    ranges = {entry["name"]: entry for entry in stored["parameters"]}
    assert (ranges["gain"]["lower"], ranges["gain"]["upper"], ranges["gain"]["step"]) == (0.25, 2, None)
    assert (ranges["rooms"]["integer"], ranges["mode"]["choices"]) == (True, ["eco", "normal"])
    assert stored["optimizer"]["mutation"] == 0.2
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Really cancel").click()
    page = opening(f"{heater.api.url}/#/submit")
    expect(page.get_by_label("score")).to_contain_text("cost / EUR, 0 to 100, less is better")  # the problem used last


def test_goals_are_chosen_from_the_problem_and_a_baseline_is_pasted(heater: Heated, opening: Opening) -> None:
    page = opening(f"{heater.api.url}/#/submit?problem=heater", expected=("422",))
    unfold(page, "Search")
    page.get_by_role("button", name="Add objective").click()
    measure = page.get_by_label("measure", exact=True)
    measure.select_option("energy_kwh")
    page.get_by_label("direction", exact=True).select_option("minimise")
    page.get_by_role("group", name="scenarios", exact=True).get_by_label("spring").uncheck()
    page.get_by_role("group", name="objective 1").get_by_label("aggregate").select_option("quantile …")
    share = page.get_by_label("quantile", exact=True)
    expect(share).to_have_value("0.9")
    share.fill("")
    expect(page.get_by_role("group", name="Start")).to_contain_text("objective 1, aggregate, quantile")
    expect(page.get_by_text("is not one of the choices")).to_have_count(0)
    share.fill("0.8")
    page.get_by_role("button", name="Add constraint").click()
    limit = page.get_by_role("group", name="constraint 1")
    limit.get_by_label("measure", exact=True).select_option("energy_kwh")
    limit.get_by_label("aggregate").select_option("mean")
    limit.get_by_label("weights", exact=True).fill("winter=2, spring")
    expect(limit.get_by_text("spring is no name with a number")).to_be_visible()
    limit.get_by_label("weights", exact=True).fill("winter=2, spring=0.5")
    with page.expect_request(lambda request: request.method == "POST" and '"at_most":9' in (request.post_data or "")) as asked:
        limit.get_by_label("at most").fill("9")
    goals: Any = asked.value.post_data_json
    quantile = {"measure": "energy_kwh", "direction": "minimise", "scenarios": ["winter"], "aggregate": {"quantile": 0.8}}
    assert goals["objectives"] == [quantile]
    weighed = {"measure": "energy_kwh", "aggregate": "mean", "weights": {"winter": 2, "spring": 0.5}, "at_most": 9}
    assert goals["constraints"] == [weighed]
    page.get_by_role("button", name="Take constraint 1 away").click()
    expect(page.get_by_role("button", name="Start it")).to_be_enabled()
    measure.select_option("none")
    page.get_by_label("score", exact=True).last.select_option("ease")
    page.get_by_role("button", name="Take objective 1 away").click()
    page.get_by_text("Paste a baseline").click()
    pasted = page.get_by_label("Baseline to paste")
    pasted.fill("gain=0.7\nmode=slow\nstage: 1.5")
    expect(page.get_by_text("mode is one of eco, normal, boost")).to_be_visible()
    page.get_by_role("button", name="Take 2 of 4 values").click()
    values = {name: page.get_by_label(f"{name} baseline") for name in ("gain", "stage", "rooms", "mode")}
    for name, value in {"gain": "0.7", "stage": "1.5", "rooms": "3", "mode": "normal"}.items():
        expect(values[name]).to_have_value(value)
    page.get_by_role("button", name="Back to the problem's baseline").click()
    expect(values["gain"]).to_have_value("0.5")
    assert barriers(page) == []


def test_a_report_is_the_page_and_opens_without_a_server(heater: Heated, opening: Opening, tmp_path: Path) -> None:
    file = tmp_path / "index.html"
    with Client(heater.api.url) as client:
        file.write_bytes(client.report(heater.campaign.id))
    page = opening(file.as_uri())
    expect(page.get_by_role("heading", level=1)).to_have_text(heater.campaign.name)
    for view, text in (
        ("Overview", "Best score by simulations"),
        ("Ranking", "Weigh the scenarios"),
        ("What matters", "winter"),
        ("Savings", "Balance"),
        ("Trust", "Does the result hold?"),
    ):
        page.get_by_role("link", name=view, exact=True).click()
        expect(page.get_by_text(text).first).to_be_visible()
        expect(page.get_by_role("alert")).to_have_count(0)
        assert barriers(page) == []


def test_a_campaign_is_cloned_run_again_and_exported_from_its_overview(heater: Heated, opening: Opening) -> None:
    page = opening(heater.at())
    page.get_by_text("Export", exact=True).first.click()
    with page.expect_download() as table:
        page.get_by_role("link", name="solutions as CSV").click()
    assert table.value.path().read_text().startswith("rank,objective,rating,violation,undecided,score_winter,score_spring")
    with page.expect_download() as best:
        page.get_by_role("link", name="best set as DCM").click()
    assert heater.campaign.id in best.value.path().read_text()
    assert barriers(page) == []
    page.get_by_role("button", name="Report").click()
    expect(page.get_by_text(f"drivecal report {heater.campaign.id[:8]}")).to_be_visible()
    page.get_by_role("link", name="Review", exact=True).first.click()
    expect(page.get_by_role("heading", name="Signatures")).to_be_visible()
    page.get_by_label("against").fill("2")
    page.get_by_label("against").blur()
    expect(page.get_by_role("columnheader", name="set 2").first).to_be_visible()
    assert barriers(page) == []
    page.goto(heater.at())

    page.get_by_role("link", name="Clone", exact=True).click()
    expect(page.get_by_label("name")).to_have_value("test again")
    unfold(page, "Search")
    expect(page.get_by_label("population")).to_have_value("40")
    expect(page.get_by_label("gain to")).to_have_value("2")
    page.get_by_label("population").fill("10")
    page.get_by_role("button", name="Start it").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("test again")
    cloned = heater.api.http.get(f"/api/v1/campaigns/{page.url.rpartition('/')[2]}").json()["spec"]
    ours = heater.campaign.spec
    settled = {"problem", "catalogue", "evaluator"}  # names that submission makes exact
    assert {name for name in ours if cloned[name] != ours[name]} - settled == {"name", "optimizer"}
    assert (cloned["catalogue"], cloned["evaluator"]) == (["winter", "spring"], "cost")
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Really cancel").click()

    page.goto(heater.at())
    page.get_by_role("button", name="Rerun").click()
    page.get_by_role("slider", name=re.compile("^winter")).fill("3")
    page.get_by_role("button", name="Search again under these weights").click()
    expect(page.get_by_role("link", name=heater.campaign.id[:8]).first).to_be_visible()
    again = heater.api.http.get(f"/api/v1/campaigns/{page.url.rpartition('/')[2]}").json()
    assert again["rerun_of"] == heater.campaign.id
    assert again["spec"]["weights"]["winter"] == 3
    page.goto(f"{heater.api.url}/")
    expect(page.get_by_role("row").filter(has_text=again["id"][:8])).to_contain_text("rerun, weights winter 3")
    leave(page, f"{heater.api.url}/")
    heater.api.http.post(f"/api/v1/campaigns/{again['id']}/cancel").raise_for_status()
