"""The page with answers that come late, are refused, or say what few campaigns say; and choices of every spelling."""

import csv
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

import pytest
from playwright.sync_api import Page, Route, expect
from tests.browser.conftest import Opening, barriers, barriers_everywhere
from tests.support.computed import ComputedBackend
from tests.support.problems import store, submit_checked
from tests.support.runs import run
from tests.support.server import RunningApi, serving

from drivecal.contracts.work import Cell, CellResult, SetupRequest
from drivecal.storage.campaigns import StoredCampaign

pytestmark = pytest.mark.slow

MODEL = "def evaluate(parameters, scenario): ...\n"
MODES = ("-soft", "=1+1", "a,b", "50 %")
GEARS = ("1", "2.0", "05")
CART: dict[str, Any] = {
    "problem": "cart",
    "parameters": {"gain": {"lower": 0, "upper": 1}, "sort": {"choices": list(MODES)}, "gear": {"choices": list(GEARS)}},
    "simulator": {"kind": "python", "file": "model.py", "function": "evaluate"},
    "scenarios": {"flat": {}, "hill": {}},
    "measures": {"error": "m", "energy": "J"},
    "scores": {"accuracy": {"formula": "10 - error", "direction": "maximise", "range": [0, 10]}},
}
SPEC: dict[str, Any] = {
    "problem": "cart",
    "optimizer": {"kind": "random", "population": 30, "iterations": 2, "seed": 1},
    "reduction": {"mode": "exact"},
}
FRUGAL: dict[str, Any] = {
    "objectives": [{"measure": "energy", "direction": "minimise"}, {"score": "accuracy"}],
    "optimizer": {"kind": "surrogate"},
    "budget": {"simulations": 60},
}


def carted(scenario: str, cell: Cell) -> CellResult:
    gain = cell.parameters["gain"] + MODES.index(cell.parameters["sort"]) + GEARS.index(cell.parameters["gear"])
    return CellResult(cell.id, None, None, {"error": abs(2 - gain), "energy": gain + len(scenario)}, None, 7.0)


@dataclass(frozen=True)
class Shown:
    """A server with three campaigns that have ended: a rerun refers to the second, the third searches for two objectives."""

    api: RunningApi
    first: StoredCampaign
    second: StoredCampaign
    frugal: StoredCampaign

    def at(self, campaign: StoredCampaign, tab: str) -> str:
        return f"{self.api.url}/#/campaigns/{campaign.id}/{tab}"


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    with serving(f"sqlite:///{tmp_path_factory.mktemp('answers') / 'drivecal.db'}") as api:
        store(api.database, CART, {"model.py": MODEL})
        ended = [
            run(api.database, submit_checked(api.database, SPEC | changes), ComputedBackend(answer=carted))
            for changes in ({"name": "first"}, {"name": "second"}, FRUGAL | {"name": "frugal"})
        ]
        yield Shown(api, *ended)


def changed(page: Page, address: str, change: Callable[[Any], Any]) -> None:
    """Lets the page have other JSON than the server sends from an address."""

    def answer(route: Route) -> None:
        sent = route.fetch(headers={name: value for name, value in route.request.headers.items() if name != "if-none-match"})
        route.fulfill(response=sent, json=change(sent.json()))

    page.route(re.compile(address), answer)


@pytest.mark.parametrize(("column", "words"), [("sort", MODES), ("gear", GEARS)])
def test_choices_of_every_spelling_are_exported_also_of_a_parameter_named_as_a_part_of_the_address(
    shown: Shown, opening: Opening, column: str, words: tuple[str, ...]
) -> None:
    page = opening(shown.at(shown.first, "evaluations"))
    group = page.get_by_role("group", name=f"Only of {column}")
    for word in words:
        group.get_by_role("button", name=re.compile(rf"^{re.escape(word)}\s+\d+$")).click()
        if word != words[-1]:
            group.get_by_role("button", name=re.compile(rf"^{re.escape(word)}\s+\d+$")).click()
    last = f"w.{column}={words[-1].replace('%', '%25').replace(',', '%2C')}"
    page.wait_for_function(
        "last => new URLSearchParams(location.hash.split('?')[1]).get(last.split('=')[0]) === last.split('=')[1]", arg=last
    )
    page.reload()
    selected = int(page.get_by_text(re.compile(r"^Showing \d+ of \d+ rows$")).inner_text().split()[1])
    with page.expect_download() as saved:
        page.get_by_role("link", name="CSV").click()
    rows = list(csv.DictReader(saved.value.path().read_text().splitlines()))
    assert len(rows) == selected > 0
    assert {row[column] for row in rows} == {words[-1]}
    for word in words[:-1]:
        group.get_by_role("button", name=re.compile(rf"^{re.escape(word)}\s+\d+$")).click()
    everything = shown.api.http.get(f"/api/v1/campaigns/{shown.first.id}/evaluations?limit=1000").json()["items"]
    expect(page.get_by_text(f"Showing {len(everything)} of {len(everything)} rows")).to_be_visible()
    with page.expect_download() as saved:
        page.get_by_role("link", name="CSV").click()
    assert len(list(csv.DictReader(saved.value.path().read_text().splitlines()))) == len(everything)


def test_refusals_stay_until_they_are_dismissed_and_what_was_typed_is_kept(shown: Shown, opening: Opening) -> None:
    page = opening(f"{shown.api.url}/#/", expected=("409",))
    page.route(
        re.compile(f"/campaigns/{shown.first.id}$"),
        lambda route: route.fulfill(status=409, json={"detail": "it is locked"}) if route.request.method == "PATCH" else None,
    )
    ticked, refusals = page.get_by_role("group", name="Ticked campaigns"), page.get_by_role("alert")
    page.get_by_role("checkbox", name=shown.first.id[:8]).check()
    ticked.get_by_label("Tag for the ticked campaigns").fill("good car-7")
    ticked.get_by_role("button", name="Add tag").click()
    expect(refusals).to_contain_text("first: it is locked")
    for _ in range(2):
        page.wait_for_event("response", lambda answer: "/campaigns?limit" in answer.url)
    expect(refusals).to_contain_text("first: it is locked")
    expect(ticked.get_by_label("Tag for the ticked campaigns")).to_have_value("good car-7")
    assert barriers(page) == []
    page.get_by_role("button", name="Dismiss").click()
    expect(refusals).to_have_count(0)
    page.unroute_all()
    rerun = shown.api.http.post(f"/api/v1/campaigns/{shown.second.id}/rerun", json={"weights": {"hill": 2}}).json()["id"]
    page.get_by_role("checkbox", name=shown.first.id[:8]).uncheck()
    page.get_by_role("checkbox", name=shown.second.id[:8]).check()
    ticked.get_by_role("button", name="Delete").click()
    ticked.get_by_role("button", name="Really delete").click()
    expect(refusals).to_contain_text(rerun)
    expect(page.get_by_role("checkbox", name=shown.second.id[:8])).to_be_checked()


def test_the_start_page_says_what_happened_since_the_last_visit(shown: Shown, opening: Opening) -> None:
    now = time.time()

    def listed(page: dict[str, Any]) -> dict[str, Any]:
        second, first = (next(item for item in page["items"] if item["name"] == name) for name in ("second", "first"))
        better = second["best"] | {"objective": first["best"]["objective"] + 5}
        going = second | {"state": "running", "ended_at": None}
        broken = {"state": "failed", "error": "no licence file", "best": None}
        odd = [
            second | broken | {"id": "a", "name": "broken"},
            going | {"id": "b", "name": "slow", "degraded": "a worker is gone"},
            going | {"id": "c", "name": "waits", "waiting": "cells wait for `bench`"},
            going | {"id": "d", "name": "rests", "state": "paused"},
            second | {"id": "e", "name": "strict", "best": better | {"violation": 0.25}},
        ]
        long_ago = datetime.fromtimestamp(now - 200_000, UTC).isoformat()
        return page | {"items": [*odd, second | {"best": better}, first | {"ended_at": long_ago}]}

    page = opening(f"{shown.api.url}/#/nowhere", expected=("404", "409"))
    page.evaluate("localStorage.removeItem('visit')")
    changed(page, r"/campaigns\?limit=100", listed)
    changed(page, "/problems/[0-9a-f]+$", lambda problem: problem | {"simulator": {"kind": "highway"}})
    page.goto(f"{shown.api.url}/#/campaigns")
    news = page.get_by_role("region", name="Since the last visit")
    expect(news).to_contain_text("the last 24 hours: this browser knows no earlier visit")
    needs = [
        ("broken", "no licence file", "Start it again", "#/submit?from=a"),
        ("slow", "a worker is gone", "See the workers", "#/workers"),
        ("strict", "breaks them by 25.0 %", "Change the constraints", "#/submit?from=e"),
        ("waits", "cells wait for bench", "See who holds it", "#/workers"),
    ]
    for name, why, title, place in needs:
        line = news.get_by_role("listitem").filter(has_text=why)
        expect(line.get_by_role("link", name=name, exact=True)).to_be_visible()
        expect(line.get_by_role("link", name=title, exact=True)).to_have_attribute("href", place)
    best = shown.api.http.get(f"/api/v1/campaigns/{shown.first.id}").json()["best"]["objective"]
    gained = news.get_by_role("listitem").filter(has_text=f"before {round(best, 3):g}")
    expect(gained).to_contain_text(f"second {round(best + 5, 3):g}")
    expect(gained.get_by_role("link", name="first", exact=True)).to_be_visible()
    expect(news.get_by_role("heading", name="Ended: 3")).to_be_visible()
    expect(news).to_contain_text("Does the result hold?")
    assert barriers_everywhere(page) == []
    gained.get_by_role("button", name="10 s of").press("Enter")
    page.wait_for_url(re.compile(r"/evaluations/\d+\?play=10"))
    page.evaluate("seen => localStorage.setItem('visit', `1 ${seen}`)", (now - 7200) * 1000)
    page.goto(f"{shown.api.url}/#/campaigns")
    expect(news).to_contain_text("the end of your last visit in this browser")
    expect(news.locator("h2")).to_contain_text(str(datetime.fromtimestamp(now - 7200, UTC).day))
    page.unroute_all(behavior="ignoreErrors")


def test_a_verdict_on_failed_runs_leads_to_their_causes(shown: Shown, opening: Opening) -> None:
    page = opening(f"{shown.api.url}/#/nowhere", expected=("404",))
    cause = {"kind": "retried", "cause": "crash", "detail": "no licence", "scenarios": ["hill"], "cells": 3, "example": 1}
    light = {"question": "scores", "light": "amber", "text": "Runs fail."}
    trust = {"answers": [light | {"title": "Does it hold?"}], "verdicts": [light | {"code": "fails", "numbers": {}}]}
    failing = {"failures": [cause], "trust": trust}
    changed(page, f"/campaigns/{shown.first.id}/results", lambda answer: answer | failing)
    page.goto(shown.at(shown.first, "overview"))
    page.get_by_role("link", name="failed runs").click()
    row = page.get_by_role("table", name="Causes").get_by_role("row").nth(1)
    expect(row).to_contain_text("no result at first")
    row.get_by_role("link", name="1", exact=True).click()
    page.wait_for_url(re.compile("/evaluations/1$"))


def test_the_workers_show_what_they_did_and_what_waits_for_what(shown: Shown, opening: Opening) -> None:
    page = opening(f"{shown.api.url}/#/nowhere", expected=("404",))
    resources = [{"name": "bench", "total": 2, "held": 2}, {"name": "rig", "total": 1, "held": 0}]
    idle = {"id": "worker-9", "node": "here", "state": "idle", "cells": 0}
    waits = {"waiting": [{"id": "a" * 32, "name": "mine", "reason": "2 of 2 bench are in use"}]}
    changed(page, "/workers", lambda answer: answer | waits | {"items": [idle], "resources": resources})
    page.goto(f"{shown.api.url}/#/workers?minutes=15")
    figures, queue = page.get_by_role("region", name="Figures"), page.get_by_role("table", name="Waiting campaigns")
    expect(figures.get_by_text("campaigns that wait for it: 1")).to_have_count(1)
    expect(figures.get_by_text("campaigns that wait for it: 0")).to_have_count(1)
    expect(queue.get_by_role("row", name="mine")).to_contain_text("2 of 2 bench are in use")
    workers = page.get_by_role("table", name="Workers", exact=True)
    expect(workers.get_by_role("row", name="worker-9")).to_contain_text("no run yet")
    expect(workers.get_by_role("row", name="worker-1")).to_contain_text(re.compile(r"s, \d+ %"))
    done = workers.get_by_role("img", name=re.compile("worker-1: [1-9][0-9]* stored runs"))
    expect(done).to_be_visible()
    expect(done.locator("title").last).to_contain_text(re.compile("busy, (first|second|frugal)"))
    assert barriers_everywhere(page) == []
    page.get_by_label("Minutes shown").select_option("60 minutes")
    page.wait_for_url(re.compile("minutes=60"))
    expect(workers.get_by_role("columnheader", name="busy in the last 60 minutes")).to_be_visible()
    page.unroute_all(behavior="ignoreErrors")


def test_older_campaigns_stay_listed_and_follow_the_filter(shown: Shown, opening: Opening) -> None:
    page = opening(f"{shown.api.url}/#/nowhere")
    page.route(
        re.compile(r"/campaigns\?limit=100"),
        lambda route: route.continue_(url=route.request.url.replace("limit=100", "limit=1")),
    )
    page.goto(f"{shown.api.url}/#/campaigns")
    boxes = page.get_by_role("table").get_by_role("checkbox")
    expect(boxes).to_have_count(1)
    page.get_by_role("button", name="Load older ones").click()
    expect(boxes).to_have_count(2)
    new = submit_checked(shown.api.database, SPEC | {"name": "newest"})
    expect(page.get_by_role("checkbox", name=new.id[:8])).to_be_visible()
    page.get_by_label("Search campaigns").fill("first")
    expect(page.get_by_role("checkbox", name=shown.first.id[:8])).to_be_visible()
    page.get_by_label("Search campaigns").fill("")
    page.get_by_label("State").select_option("queued")
    expect(boxes).to_have_count(1)
    shown.api.http.post(f"/api/v1/campaigns/{new.id}/cancel").raise_for_status()


def test_a_review_says_what_the_runs_of_a_random_simulator_tell(shown: Shown, opening: Opening) -> None:
    store(
        shown.api.database, CART | {"problem": "noisy", "simulator": CART["simulator"] | {"random": True}}, {"model.py": MODEL}
    )
    start = {"gain": 0.5, "sort": MODES[0], "gear": GEARS[0]}
    spec = {"problem": "noisy", "budget": {"simulations": 80}, "baseline": start}

    def driven(setup: SetupRequest, cell: Cell) -> CellResult:
        result = carted(setup.scenario, cell)
        return replace(result, metrics={"error": result.metrics["error"] + setup.seed % 97 / 970, "energy": 1.0})

    ended = run(shown.api.database, submit_checked(shown.api.database, spec), ComputedBackend(driven=driven))
    best, *_ = shown.api.http.get(f"/api/v1/campaigns/{ended.id}/solutions").json()["items"]
    reviewed = opening(shown.at(ended, "review")).get_by_role("region", name="Set 1")
    expect(reviewed).to_contain_text(
        re.compile(rf"Objective [\d.]+ to [\d.]+ by {len(best['seeds'])} of its {best['replicates']} seeds")
    )
    expect(reviewed.get_by_role("row", name="objective")).to_contain_text(f"{best['objective']:.4f}")
    assert best["replicates"] > 1
