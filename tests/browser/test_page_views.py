"""The page in a browser, on campaigns whose simulation is a formula."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect
from tests.browser.conftest import Opening
from tests.support.computed import ComputedBackend
from tests.support.runs import SMALL, WITH_ANALYSIS, dispatcher, get, influenced, run, submit
from tests.support.server import RunningApi, free_port, serving
from tests.support.tree import PROJECT

from drivecal.storage.campaigns import StoredCampaign

AXE = PROJECT / "services" / "web" / "node_modules" / "axe-core" / "axe.min.js"
TABS = ("overview", "ranking", "evaluations", "curves", "influence", "trust")
TOKEN = "reader-0123456789abcdef"


@dataclass(frozen=True)
class Shown:
    """A server with one campaign that has ended."""

    api: RunningApi
    campaign: StoredCampaign

    def at(self, *path: str) -> str:
        return f"{self.api.url}/#/campaigns/{'/'.join([self.campaign.id, *path])}"


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    with serving(f"sqlite:///{tmp_path_factory.mktemp('browser') / 'drivecal.db'}") as api:
        yield Shown(api, run(api.database, submit(api.database, **WITH_ANALYSIS), ComputedBackend(answer=influenced)))


def rows_shown(page: Page) -> tuple[int, int]:
    """The numbers that are told above the table."""
    said = page.get_by_text(re.compile(r"^Showing [\d,]+ of [\d,]+ rows$")).inner_text()
    shown, of = re.findall(r"[\d,]+", said)
    return int(shown.replace(",", "")), int(of.replace(",", ""))


def test_a_campaign_is_followed_live_and_through_a_restart_of_the_server(tmp_path: Path, opening: Opening) -> None:
    database, port = f"sqlite:///{tmp_path / 'drivecal.db'}", free_port()
    with serving(database, port) as api:
        campaign = submit(api.database, **SMALL)
        page = opening(f"{api.url}/#/campaigns/{campaign.id}", expected=("WebSocket", "ERR_CONNECTION_REFUSED"))
        expect(page.get_by_text("Waiting for its turn.").first).to_be_visible()
        page.evaluate("window.neverReloaded = true")
        working = dispatcher(api.database)
        while get(api.database, campaign).cells.requested < 60:
            working.step()
        expect(page.get_by_text(re.compile(r"Searching: iteration \d"))).to_be_visible()
    expect(page.get_by_text("Connection lost")).to_be_visible()
    with serving(database, port) as api:
        run(api.database, campaign)
        expect(page.get_by_text("Finished.")).to_be_visible()
        expect(page.get_by_text("Connection lost")).not_to_be_visible()
        requested = get(api.database, campaign).cells.requested
        expect(page.get_by_role("img", name=f"{requested} requested")).to_be_visible()
        assert page.evaluate("window.neverReloaded")


@pytest.mark.parametrize(("dark", "phone"), [(False, False), (True, False), (False, True)], ids=["light", "dark", "phone"])
def test_every_view_can_be_used_by_everybody(shown: Shown, opening: Opening, *, dark: bool, phone: bool) -> None:
    if not AXE.is_file():
        pytest.skip("axe-core is not there: make check fetches it")
    page = opening(f"{shown.api.url}/", dark=dark, phone=phone)
    page.evaluate(AXE.read_text())
    found: dict[str, Any] = {}
    others = ("", "submit", f"compare?a={shown.campaign.id}&b={shown.campaign.id}")
    for address in [*(f"{shown.api.url}/#/{other}" for other in others), *(shown.at(tab) for tab in TABS)]:
        page.goto(address)
        expect(page.locator("main h1")).to_be_visible()
        expect(page.get_by_role("main")).not_to_contain_text(re.compile("Loading|Reading|Counting|Choose two"))
        # What differs in the dark is contrast, and on a phone the width.
        rules = "{runOnly: ['color-contrast']}" if dark or phone else "{}"
        violations = page.evaluate(f"axe.run({rules}).then((found) => found.violations)")
        found[address] = [(one["id"], [node["html"][:150] for node in one["nodes"]][:3]) for one in violations]
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), address
    assert {address: one for address, one in found.items() if one} == {}


def test_what_is_selected_stands_in_the_address(shown: Shown, opening: Opening) -> None:
    page = opening(shown.at("evaluations"))
    expect(page.get_by_role("grid")).to_be_visible()
    whole = rows_shown(page)
    assert whole[0] == whole[1]
    page.get_by_role("button", name=re.compile("^S1")).click()
    axis = page.get_by_role("slider", name="Range of P1")
    axis.focus()
    for _ in range(6):
        axis.press("ArrowDown")
    page.get_by_role("columnheader", name="score").get_by_role("button").click()
    page.get_by_role("row").nth(3).get_by_role("gridcell").nth(1).click()
    some = rows_shown(page)
    assert 0 < some[0] < some[1] == whole[1]
    page.wait_for_url(re.compile("row="))
    again = opening(page.url)
    expect(again.locator("[aria-selected=true]")).to_have_count(1)
    assert rows_shown(again) == some
    expect(again.get_by_role("columnheader", name="score")).to_have_attribute("aria-sort", "ascending")
    again.get_by_role("button", name="Show all again").click()
    assert rows_shown(again) == whole


def test_a_table_of_any_length_is_scrolled_row_by_row(shown: Shown, opening: Opening) -> None:
    page = opening(shown.at("evaluations"))
    grid = page.get_by_role("grid")
    expect(grid).to_be_visible()
    assert page.get_by_role("row").count() < 60
    grid.focus()
    grid.press("End")
    last = page.locator("[role=row][aria-selected=true]")
    expect(last).to_have_attribute("aria-rowindex", str(rows_shown(page)[0] + 1))
    grid.press("Enter")
    expect(page.get_by_role("heading", level=1)).to_contain_text("evaluation")


def test_a_score_of_the_ranking_leads_to_its_evaluation(shown: Shown, opening: Opening) -> None:
    page = opening(shown.at("ranking"), expected=("409",))
    expect(page.get_by_role("grid")).to_be_visible()
    score = page.get_by_role("row").nth(1).get_by_role("button").nth(1)
    value = score.inner_text()
    score.click()
    expect(page.get_by_role("heading", level=1)).to_contain_text("S2 · evaluation")
    expect(page.get_by_text(f"score {value} of 7")).to_be_visible()
    expect(page.get_by_role("heading", name="Where the answer comes from")).to_be_visible()


def test_other_weights_rank_anew_at_once_and_can_be_searched_with(shown: Shown, opening: Opening) -> None:
    page = opening(shown.at("ranking"))
    page.get_by_text("Weigh the scenarios differently").click()
    slider = page.get_by_role("slider", name="S2")
    slider.fill("0")
    expect(page.get_by_text("Ranked anew under S1=1,S2=0")).to_be_visible()
    page.get_by_role("button", name="Search anew under these weights").click()
    expect(page.get_by_text("rerun of")).to_be_visible()
    rerun = page.url.rpartition("/")[2]
    assert shown.api.http.get(f"/api/v1/campaigns/{rerun}").json()["spec"]["weights"] == {"S1": 1, "S2": 0}
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Really cancel").click()
    expect(page.get_by_text("cancelled", exact=False).first).to_be_visible()


def test_a_campaign_is_submitted_from_a_form_that_says_what_it_costs_and_what_is_wrong(shown: Shown, opening: Opening) -> None:
    page = opening(f"{shown.api.url}/#/submit", expected=("422",))
    page.get_by_role("checkbox", name="sensitivity").uncheck()
    page.get_by_label("population").fill("10")
    page.get_by_label("iterations").fill("2")
    page.get_by_label("name").fill("from the form")
    expect(page.get_by_text("runs for 120 proposed cells")).to_be_visible()
    page.get_by_label("weights").fill('{"S9": 1}')
    expect(page.get_by_role("alert")).to_contain_text("S9")
    expect(page.get_by_role("button", name="Start it")).to_be_disabled()
    page.get_by_label("weights").fill('{"S1": 3}')
    page.get_by_role("button", name="Start it").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("from the form")
    stored = shown.api.http.get(f"/api/v1/campaigns/{page.url.rpartition('/')[2]}").json()["spec"]
    assert (stored["sensitivity"], stored["weights"], stored["optimizer"]["population"]) == (None, {"S1": 3}, 10)
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Really cancel").click()
    expect(page.get_by_text("cancelled").first).to_be_visible()


def test_tables_and_charts_are_exported(shown: Shown, opening: Opening, tmp_path: Path) -> None:
    page = opening(shown.at("curves"))
    with page.expect_download() as saved:
        page.get_by_role("link", name="CSV").click()
    saved.value.save_as(tmp_path / "generations.csv")
    assert (tmp_path / "generations.csv").read_text().startswith("iteration,proposed,")
    page.get_by_text("As a table, export").first.click()
    for kind, begins in (("SVG", b"<svg"), ("PNG", b"\x89PNG"), ("CSV", b"iteration,best so far")):
        with page.expect_download() as saved:
            page.get_by_role("button", name=kind, exact=True).first.click()
        saved.value.save_as(tmp_path / kind)
        assert (tmp_path / kind).read_bytes().startswith(begins)
    page.get_by_role("button", name="CLI").click()
    expect(page.get_by_text(f"drivecal export {shown.campaign.id[:8]} --table generations")).to_be_visible()


def test_where_tokens_are_asked_for_the_page_asks_for_one_and_keeps_none(tmp_path: Path, opening: Opening) -> None:
    (tmp_path / "tokens").write_text(f"anna read {TOKEN}\n")
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}", tokens_file=str(tmp_path / "tokens")) as api:
        campaign = run(api.database, submit(api.database, optimizer={"kind": "genetic", "population": 6, "iterations": 2}))
        page = opening(f"{api.url}/#/campaigns/{campaign.id}", expected=("401", "WebSocket"))
        page.get_by_label("Token").fill("wrong-0123456789abcdef")
        page.get_by_role("button", name="Log in").click()
        expect(page.get_by_text("does not know this token")).to_be_visible()
        page.get_by_label("Token").fill(TOKEN)
        page.get_by_role("button", name="Log in").click()
        expect(page.get_by_text("Finished.")).to_be_visible()
        expect(page.get_by_text("anna (may read)")).to_be_visible()
        page.reload()
        expect(page.get_by_text("Finished.")).to_be_visible()
        kept = page.evaluate("JSON.stringify([document.cookie, {...localStorage}, {...sessionStorage}])")
        assert json.loads(kept) == ["", {}, {}]
