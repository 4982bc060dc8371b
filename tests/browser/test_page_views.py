"""The page's views in a browser, on a desktop and on a phone, on campaigns whose simulation is a formula."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from time import sleep
from typing import Any

import pytest
from playwright.sync_api import Browser, CDPSession, Locator, Page, Route, expect
from sqlalchemy import update
from tests.browser.conftest import AWAY, BUSY, PHONE, TABS, Opening, away_and_back, barriers_everywhere, leave, too_wide, unfold
from tests.support.comparisons import finish_comparison, submit_comparison
from tests.support.computed import ComputedBackend
from tests.support.runs import WITH_ANALYSIS, influenced, run, submit
from tests.support.server import RunningApi, serving
from tests.support.values import present

from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.tables import campaigns

STUDIED = WITH_ANALYSIS | {
    "robustness": {"delta": 0.2, "steps": 3, "samples": 2, "solutions": 3},
    "validation": {"samples": 20, "references": 3, "largest": 40},
}
REDUCTIONS: list[Any] = ["off", "exact"]
RESTING_SECONDS = 0.3
MARKUP = "<img src=x onerror='window.carriedOut = 1'><script>window.carriedOut = 1</script>"


@dataclass(frozen=True)
class Shown:
    """A server with a campaign, a study of its best sets and a comparison that have ended."""

    api: RunningApi
    campaign: StoredCampaign
    study: StoredCampaign
    tag: str

    def at(self, *path: str) -> str:
        return f"{self.api.url}/#/campaigns/{'/'.join([self.campaign.id, *path])}"


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    with serving(f"sqlite:///{tmp_path_factory.mktemp('browser') / 'drivecal.db'}") as api:
        campaign = run(api.database, submit(api.database, **STUDIED), ComputedBackend(answer=influenced))
        alone: dict[str, Any] = {"optimizer": None, "sensitivity": None, "validation": None}
        alone["robustness"] = STUDIED["robustness"] | {"of": campaign.id}
        study = run(api.database, submit(api.database, **STUDIED | alone), ComputedBackend(answer=influenced))
        compared = submit_comparison(api.database, populations=[6], reductions=REDUCTIONS)
        finish_comparison(api.database, compared)
        yield Shown(api, campaign, study, compared)


def rows_shown(page: Page) -> tuple[int, int]:
    """The numbers that are told above the table."""
    said = page.get_by_text(re.compile(r"^Showing [\d,]+ of [\d,]+ rows$")).inner_text()
    shown, of = re.findall(r"[\d,]+", said)
    return int(shown.replace(",", "")), int(of.replace(",", ""))


def views(shown: Shown) -> list[str]:
    """The addresses of all views of these campaigns."""
    both = f"compare?ids={shown.campaign.id},{shown.campaign.id}"
    study = f"campaigns/{shown.study.id}"
    beside = f"compare?ids={shown.study.id},{shown.campaign.id}"
    three = f"compare?ids={shown.campaign.id},{shown.study.id},{shown.campaign.id}"
    alone = ("", "submit", "submit?kind=comparison", "workers", "problems", "compare")
    paths = (*alone, both, three, beside, f"comparisons/{shown.tag}", study, "evaluations/1")
    return [*(f"{shown.api.url}/#/{path}" for path in paths), *(shown.at(tab) for tab in TABS)]


@pytest.mark.slow
def test_every_view_can_be_used_by_everybody(shown: Shown, opening: Opening) -> None:
    page = opening(f"{shown.api.url}/#/nowhere", expected=("409",))
    broken: dict[str, Any] = {}
    charts = [f"{shown.at('evaluations')}?chart={kind}" for kind in ("scatter", "map")]
    for address in [*views(shown), *charts]:
        page.goto(address)
        expect(page.locator("main h1")).to_be_visible()
        broken[address] = barriers_everywhere(page)
        page.emulate_media(media="print")
        buttons = page.locator("header, .button, main button:not(.link, .chip, :has(+ .meaning), th *, [role=columnheader] *)")
        broken[address] += [("printed", [left.inner_text()]) for left in buttons.filter(visible=True).all()]
        page.emulate_media(media="screen")
    assert {address: rules for address, rules in broken.items() if rules} == {}


@pytest.mark.slow
def test_every_view_comes_back_with_the_server(shown: Shown, opening: Opening) -> None:
    page = opening(f"{shown.api.url}/#/nowhere", expected=(*AWAY, "409"))
    for address in views(shown):
        away_and_back(page, address)


def test_overviews_answer_two_questions_or_lead_with_what_a_study_found(shown: Shown, opening: Opening) -> None:
    page = opening(shown.at())
    light = page.get_by_role("region", name="Trust in the result")
    judged = shown.api.http.get(f"/api/v1/campaigns/{shown.campaign.id}/results").json()["trust"]
    for verdict in judged["verdicts"]:
        expect(light).to_contain_text(verdict["text"], use_inner_text=True)  # without the closed meanings of its words
    said = [f"{each['title']} {each['text']}" for each in judged["answers"]]
    assert [each["question"] for each in judged["answers"]][:2] == ["scores", "search"]
    for heading, text in zip(light.get_by_role("heading", level=2).all(), said, strict=True):
        expect(heading).to_contain_text(text)
    expect(light.get_by_role("link")).to_have_count(len(judged["verdicts"]))
    light.get_by_role("link", name="course").first.click()
    expect(page.locator("#course")).to_be_in_viewport()
    best = page.get_by_role("table", name="Parameters of the set")
    expect(best.get_by_role("row", name="P1")).to_contain_text("smoothing")
    expect(page.get_by_text("Held: P5 0.5")).to_be_visible()
    expect(page.get_by_text(re.compile("genetic: .*population 40, iterations 5"))).to_be_visible()
    page.get_by_role("table", name="Scores by scenario").get_by_role("button").first.click()
    expect(page.get_by_role("heading", level=1)).to_contain_text("S1 · evaluation")
    page.goto(f"{shown.api.url}/#/campaigns/{shown.study.id}")
    expect(page.get_by_role("heading", name="A robustness study")).to_be_visible()
    expect(page.get_by_role("link", name="test", exact=True)).to_have_attribute("href", f"#/campaigns/{shown.campaign.id}")
    expect(page.get_by_role("table", name="Robustness by set").get_by_role("row", name="place 1")).to_be_visible()
    expect(page.get_by_text("Best objective", exact=True)).to_have_count(0)


def test_campaigns_are_searched_sorted_and_ticked_to_be_compared(shown: Shown, opening: Opening) -> None:
    page = opening(f"{shown.api.url}/")
    table, search = page.get_by_role("table"), page.get_by_label("Search campaigns")
    expect(table.get_by_role("checkbox", name=f"Compare test {shown.study.id[:8]}")).to_be_visible()
    search.fill(shown.study.id[:12])
    expect(table.get_by_role("checkbox")).to_have_count(1)
    search.fill("no such campaign")
    expect(page.get_by_text("fits “no such campaign”")).to_be_visible()
    search.fill("")
    page.get_by_role("columnheader", name="campaign").get_by_role("button").click()
    expect(page.get_by_role("columnheader", name="campaign")).to_have_attribute("aria-sort", "ascending")
    expect(page.get_by_role("button", name="Compare")).to_be_disabled()
    for campaign in (shown.campaign, shown.study):
        table.get_by_role("checkbox", name=campaign.id[:8]).check()
    page.get_by_role("button", name="Compare 2").click()
    expect(page.get_by_role("heading", name="Compare campaigns")).to_be_visible()
    heads = page.get_by_role("region", name="Settings").get_by_role("columnheader")
    expect(heads).to_have_count(3)
    page.goto(f"{shown.api.url}/#/compare?ids={shown.campaign.id},{shown.campaign.id}")
    expect(page.get_by_role("img", name=re.compile("Best scores of the searches")).locator("path")).to_have_count(2)


@pytest.mark.slow
def test_best_sets_of_campaigns_are_compared_under_one_weighting(shown: Shown, opening: Opening) -> None:
    database, get = shown.api.database, shown.api.http.get
    small: dict[str, Any] = {
        "catalogue": ["S1"],
        "weights": {},
        "optimizer": {"kind": "random", "population": 6, "iterations": 2},
    }
    less = submit(database, **small)
    page = opening(f"{shown.api.url}/#/compare?ids={shown.campaign.id},{less.id}&weights=S1=1,S2=0&rows=all")
    results = page.get_by_role("region", name="Results of each")
    expect(results).to_contain_text("queued")
    run(database, less, ComputedBackend(answer=influenced))
    expect(results).not_to_contain_text("queued", timeout=15_000)
    for campaign, weights in ((shown.campaign, "S1=1,S2=0"), (less, "S1=1")):
        best = get(f"/api/v1/campaigns/{campaign.id}/solutions?weights={weights}").json()["items"][0]
        expect(results.get_by_role("row", name=re.compile("^weighted score"))).to_contain_text(told(best["objective"]))
    page.get_by_label("Weights").select_option(index=0)
    expect(results.get_by_role("row", name=re.compile("^weighted score"))).to_contain_text("not simulated: S2")
    page.get_by_label("differences only").uncheck()
    expect(results.get_by_role("row", name="best by its own objective")).to_contain_text("this set")
    expect(page.get_by_role("table", name="Settings of each").get_by_role("row", name="problem")).to_be_visible()


def test_a_scatter_keeps_ranges_that_the_table_and_the_export_follow(shown: Shown, opening: Opening) -> None:
    page = opening(f"{shown.at('evaluations')}?chart=scatter&x=P1&y=score")
    plot = page.get_by_role("img", name=re.compile("score over P1"))
    expect(plot).to_be_visible()
    whole = rows_shown(page)
    box = present(plot.bounding_box())
    page.mouse.move(box["x"] + box["width"] * 0.6, box["y"] + box["height"] * 0.1)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.9, box["y"] + box["height"] * 0.5, steps=3)
    page.mouse.up()
    expect(page.get_by_label("P1 from")).to_be_visible()
    expect(page.get_by_label("score from")).to_be_visible()
    some = rows_shown(page)
    assert 0 < some[0] < whole[1] == some[1]
    with page.expect_download() as saved:
        page.get_by_role("link", name="CSV").click()
    assert len(saved.value.path().read_text().splitlines()) == some[0] + 1
    page.get_by_role("button", name="Smoothed").click()
    expect(page.get_by_role("img", name=re.compile("^P[0-9]+.* over P1"))).to_be_visible()
    assert rows_shown(page) == some


@pytest.mark.slow
def test_what_matters_is_told_once_with_the_reason_of_a_disagreement(shown: Shown, opening: Opening) -> None:
    changes = {"reduction": {"mode": "off"}, "optimizer": {"kind": "random", "population": 60, "iterations": 2, "seed": 2}}
    ended = run(shown.api.database, submit(shown.api.database, **WITH_ANALYSIS | changes), ComputedBackend(answer=influenced))
    page = opening(f"{shown.api.url}/#/campaigns/{ended.id}/ranking")
    page.get_by_role("link", name="Which parameters matter", exact=True).click()
    said = shown.api.http.get(f"/api/v1/campaigns/{ended.id}/importance").json()
    rows = page.get_by_role("table", name="What matters: objective", exact=True).get_by_role("row")
    expect(rows).to_have_count(1 + len(said["items"]))
    for place, item in enumerate(said["items"], start=1):
        expect(rows.nth(place)).to_contain_text(re.compile(rf"^{item['parameter']}( / \S+?)?{told(item['importance'])}"))
    first, second = (item["parameter"] for item in said["items"][:2])
    expect(page.get_by_role("img", name=re.compile(f"^{second}.* over {first}.* points$"))).to_be_visible()
    expect(page.get_by_role("img", name=re.compile(f"^objective along {first}.* through the best set"))).to_be_visible()
    expect(page.get_by_role("img", name=re.compile("^Scores by scenario: S1: median"))).to_be_visible()
    assert barriers_everywhere(page) == []
    page.route(re.compile("/influence"), lambda route: opposite(route, said["items"][0]["parameter"]))
    page.reload()
    expect(rows.nth(1)).to_contain_text("nowhere")
    reason = page.get_by_text(re.compile(f"^{first}, only in the search: the map"))
    expect(reason).to_be_visible()
    page.get_by_label("What matters for").select_option("S1")
    expect(page.get_by_role("heading", name="What matters: S1")).to_be_visible()
    rows = page.get_by_role("table", name="What matters: S1", exact=True).get_by_role("row")
    expect(rows.nth(1)).to_contain_text(re.compile("P1|P2"))
    rows.nth(1).get_by_role("link").press("Enter")
    expect(page.get_by_role("img", name=re.compile("objective over P[12]"))).to_be_visible()
    page.unroute_all(behavior="ignoreErrors")


def told(share: float) -> str:
    """A share as the page writes it, if it is not small."""
    return f"{round(share, 3):g}" if share > 0.01 else ""


def opposite(route: Route, parameter: str) -> None:
    """Answers with a map that calls a parameter non-influential."""
    sent = route.fetch()
    table = sent.json()
    items = [row | {"influential": row["parameter"] != parameter and row["influential"]} for row in table["items"]]
    route.fulfill(response=sent, json=table | {"items": items})


@pytest.mark.slow
def test_a_ranked_set_leads_on_and_two_sets_stand_beside_each_other(shown: Shown, opening: Opening) -> None:
    page = opening(shown.at("ranking"))
    ranked = shown.api.http.get(f"/api/v1/campaigns/{shown.campaign.id}/solutions", params={"limit": 3}).json()["items"]
    grid, bar = page.get_by_role("grid"), page.get_by_role("group", name="Chosen sets")
    grid.focus()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Space")
    page.keyboard.press("ArrowDown")
    both = page.get_by_role("region", name="Chosen sets")
    expect(both.get_by_role("heading", level=2)).to_have_text("Set 2 against set 1")
    grid.get_by_role("row").nth(3).click(modifiers=["Shift"])
    expect(both.get_by_role("heading", level=2)).to_have_text("Set 2 against set 3")
    expect(both.get_by_role("button", name="both in S1")).to_be_visible()
    bar.get_by_label("beside").select_option("the best set")
    expect(both.get_by_role("heading", level=2)).to_have_text("Set 2 against set 1")
    assert barriers_everywhere(page) == []
    bar.get_by_role("button", name="Set 2: next steps").press("Enter")
    menu = page.get_by_role("list").filter(has_text="Replay")
    assert barriers_everywhere(page) == []
    with page.expect_download() as saved:
        menu.get_by_role("button", name="JSON").click()
    assert json.loads(saved.value.path().read_text()) == ranked[1]["parameters"]
    with page.expect_download() as saved:
        menu.get_by_role("link", name="DCM").click()
    assert b"rank: 2" in saved.value.path().read_bytes()
    menu.get_by_role("link", name="Start a search with these 3 sets").click()
    expect(page.get_by_label("start sets")).to_be_visible()
    started = json.loads(page.get_by_label("start sets").input_value())
    assert len(started) == len(ranked)
    assert all(row["parameters"] in started for row in ranked)


def test_an_evaluated_set_is_checked_again(shown: Shown, opening: Opening) -> None:
    row = shown.api.http.get(f"/api/v1/campaigns/{shown.campaign.id}/evaluations", params={"limit": 1}).json()["items"][0]
    page = opening(f"{shown.api.url}/#/evaluations/{row['id']}", expected=("409",))
    page.get_by_role("button", name="This set: next steps").click()
    page.get_by_role("button", name="Check it").click()
    expect(page.get_by_role("link", name="Evaluations", exact=True)).to_have_attribute("aria-current", "page")
    spec = shown.api.http.get(f"/api/v1/campaigns/{page.url.split('/')[-2]}").json()["spec"]
    parameters = {name: row[name] for name in spec["parameters"]}
    assert (spec["parameters"], spec["scenario"], spec["fresh"]) == (parameters, row["scenario"], True)


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
    expect(page.get_by_role("slider", name="Range of P7")).to_have_count(0)  # it is constant
    page.get_by_role("columnheader", name="score").get_by_role("button").click()
    page.get_by_role("row").nth(3).get_by_role("gridcell").nth(1).click()
    some = rows_shown(page)
    assert 0 < some[0] < some[1] == whole[1]
    page.wait_for_url(re.compile("row="))
    page.reload()
    expect(page.locator("[aria-selected=true]")).to_have_count(1)
    assert rows_shown(page) == some
    expect(page.get_by_role("columnheader", name="score")).to_have_attribute("aria-sort", "descending")  # the best first
    page.get_by_role("button", name="Show all again").click()
    assert rows_shown(page) == whole


def test_a_campaign_is_submitted_from_a_form_that_says_what_it_costs_and_what_is_wrong(shown: Shown, opening: Opening) -> None:
    page = opening(f"{shown.api.url}/#/submit", expected=("422", *AWAY))
    expect(page.get_by_role("group", name="budget").get_by_label("simulations")).to_be_visible()
    expect(page.get_by_label("kind")).not_to_be_visible()
    unfold(page, "Saving simulations", "Search")
    page.get_by_label("kind").select_option("genetic")
    page.get_by_label("population").fill("10")
    page.get_by_label("iterations").fill("2")
    mode, analysed = page.get_by_label("mode", exact=True), page.get_by_role("checkbox", name="sensitivity")
    expect(mode).to_have_value("predicted")
    analysed.check()
    expect(mode).to_have_value("both")
    expect(page.get_by_text("the sensitivity analysis does not pay")).to_be_visible()
    analysed.uncheck()
    expect(mode).to_have_value("predicted")
    page.get_by_label("name").fill("from the form")
    page.reload()
    expect(page.get_by_label("name")).to_have_value("from the form")
    expect(page.get_by_text("runs for 120 proposed cells")).to_be_visible()
    lower = page.get_by_label("P1 from")
    lower.fill("20")
    lower.blur()
    expect(page.get_by_role("row", name="P1, to: ")).to_be_visible()  # below the row of its fields
    upper = page.get_by_label("P1 to", exact=True)
    expect(upper).to_have_attribute("aria-invalid", "true")
    page.get_by_role("alert").get_by_role("button", name="P1, to").click()
    expect(upper).to_be_focused()
    lower.fill("-15")
    lower.blur()
    expect(page.get_by_text("runs for 120 proposed cells")).to_be_visible()
    kind = page.get_by_label("kind", exact=True)
    kind.select_option("another, by its name …")
    expect(kind).to_have_role("textbox")
    page.get_by_role("button", name="Choose kind from the list").click()
    expect(kind).to_have_role("combobox")
    expect(kind).to_have_value("genetic")
    page.get_by_role("button", name="+ start sets").click()
    sets = page.get_by_label("start sets")
    sets.fill('[{"P1": 3')
    expect(page.get_by_role("alert")).to_contain_text("optimizer, start sets: this is not valid JSON")
    sets.fill(json.dumps([{"S" * 63: 1}]))
    expect(page.get_by_role("alert")).to_contain_text("S" * 63)
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    page.get_by_label("population").fill("")
    expect(page.get_by_label("population")).to_have_attribute("placeholder", "1000 by default")
    page.get_by_label("population").fill("-3")
    expect(page.get_by_text("-3 is too small; give at least 2")).to_have_count(2)  # at the field, and in the list of all
    expect(page.get_by_text("undefined")).to_have_count(0)
    page.get_by_label("population").fill("10")
    expect(page.get_by_role("button", name="Start it")).to_be_disabled()
    sets.fill("")
    page.get_by_label("Weight of S1").fill("3")
    expect(page.get_by_role("button", name="Start it")).to_be_enabled()
    page.context.set_offline(True)
    page.get_by_role("button", name="Start it").click()
    expect(page.get_by_role("group", name="Start")).to_contain_text("cannot be reached")
    page.context.set_offline(False)
    page.get_by_role("button", name="Start it").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("from the form")
    stored = shown.api.http.get(f"/api/v1/campaigns/{page.url.rpartition('/')[2]}").json()["spec"]
    assert (stored["sensitivity"], stored["weights"], stored["optimizer"]["population"]) == (None, {"S1": 3}, 10)
    assert stored["reduction"]["mode"] == "predicted"
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Really cancel").click()
    expect(page.get_by_text("cancelled").first).to_be_visible()


@pytest.mark.slow
def test_a_comparison_is_submitted_and_shows_all_of_its_runs(shown: Shown, opening: Opening) -> None:
    page = opening(f"{shown.api.url}/#/submit?kind=comparison")
    page.get_by_label("populations").fill("10, 20")
    page.get_by_label("mutation").first.fill("0.2")
    page.get_by_role("button", name="Take optimizer 3 away").click()
    expect(page.get_by_text(re.compile(r"at most [\d,]+ for 3,600 proposed cells"))).to_be_visible()
    page.get_by_role("button", name="Start it").click()
    expect(page.get_by_role("heading", level=1)).to_contain_text("comparison-")
    made = shown.api.http.get(f"/api/v1/comparisons/{page.url.rpartition('/')[2]}").json()["runs"]
    assert [(run["optimizer"], run["population"]) for run in made[::3]] == [
        *(("genetic", 10), ("genetic", 20), ("swarm", 10), ("swarm", 20))
    ]
    page.goto(f"{shown.api.url}/#/campaigns?tag={shown.tag}")
    page.get_by_role("link", name="Compare all with this tag").click()
    expect(page.get_by_text("12 of 12 campaigns have ended")).to_be_visible()
    expect(page.get_by_role("table", name="Groups of runs")).to_be_visible()
    expect(page.get_by_role("img", name="genetic").locator("path")).to_have_count(6)
    page.get_by_role("link", name="swarm, 6 individuals, exact").first.click()
    expect(page.get_by_role("link", name="Ranking", exact=True)).to_be_visible()


@pytest.fixture
def touched(browser: Browser) -> Iterator[Page]:
    """A page that fingers touch."""
    context = browser.new_context(viewport=PHONE, has_touch=True)
    yield context.new_page()
    context.close()


def middle(place: Locator) -> tuple[float, float]:
    box = present(place.bounding_box())
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def drag(fingers: CDPSession, x: float, y: float, by: float) -> None:
    """Draws a finger down by this many pixels and rests it there: after a fling, the browser takes the next tap as a tap that stops it."""
    fingers.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
    for step in range(1, 11):
        fingers.send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [{"x": x, "y": y + by * step / 10}]})
    sleep(RESTING_SECONDS)
    fingers.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


@pytest.mark.slow
def test_a_finger_scrolls_over_axes_and_keeps_a_range_after_a_tap(shown: Shown, touched: Page) -> None:
    touched.goto(shown.at("evaluations"))
    fingers = touched.context.new_cdp_session(touched)
    axis = touched.get_by_role("slider", name=re.compile(r"^Range of P1\b"))
    axis.scroll_into_view_if_needed()
    expect(touched.get_by_text("Tap an axis")).to_be_visible()
    before, (x, y) = touched.evaluate("scrollY"), middle(axis)
    drag(fingers, x, y, -150)
    touched.wait_for_function("before => scrollY > before + 50", arg=before)
    expect(axis).to_have_attribute("aria-valuetext", "all")
    axis.tap()
    expect(touched.get_by_text("Drag along P1")).to_be_visible()
    touched.screenshot()  # the compositor, which takes the fingers, knows the axis as it is now
    x, y = middle(axis)
    drag(fingers, x, y, -80)
    expect(axis).not_to_have_attribute("aria-valuetext", "all")
    assert abs(middle(axis)[1] - y) < 40  # the finger moved the range, not the page below it
    axis.tap()
    expect(touched.get_by_text("Drag along P1")).to_be_visible()
    axis.tap()
    expect(axis).to_have_attribute("aria-valuetext", "all")


def test_the_start_of_a_form_is_always_in_sight_and_hides_nothing(shown: Shown, opening: Opening) -> None:
    page = opening(f"{shown.api.url}/#/submit", phone=True, expected=("422",))
    bar, start = page.get_by_role("group", name="Start"), page.get_by_role("button", name="Start it")
    expect(bar).to_contain_text(re.compile(r"At most [\d,]+ cells"))
    expect(page.get_by_label("kind")).to_be_attached()  # the cost may be there before the form
    for place in (0, 1500, 1_000_000):
        page.evaluate("y => scrollTo(0, y)", place)
        expect(start).to_be_in_viewport(ratio=1)
        box = present(start.bounding_box())
        assert 0 <= box["x"] <= PHONE["width"] - box["width"], "within the screen's width"
    card, under = page.get_by_role("heading", name="Maximum cost").locator("xpath=ancestor::section[1]"), bar.bounding_box()
    above = present(card.bounding_box())
    assert above["y"] + above["height"] <= present(under)["y"]
    unfold(page, "Search")
    page.get_by_label("kind").select_option("genetic")
    page.get_by_label("population").fill("-3")
    expect(bar).to_contain_text("optimizer, population")
    expect(start).to_be_disabled()
    page.get_by_label("population").fill("10")
    upper = page.get_by_label("P2 to", exact=True)
    upper.fill("1e9")
    upper.blur()
    expect(bar).to_contain_text("P2, to")
    expect(upper).to_have_attribute("aria-invalid", "true")
    page.evaluate("scrollTo(0, 0)")
    bar.get_by_role("button", name="One fault at P2, to").click()
    expect(upper).to_be_focused()
    expect(upper).to_be_in_viewport(ratio=1)
    assert too_wide(page) == []


def test_a_name_in_markup_is_shown_letter_by_letter(shown: Shown, opening: Opening) -> None:
    rename = update(campaigns).where(campaigns.c.id == shown.campaign.id)
    with shown.api.database.transaction() as connection:
        connection.execute(rename.values(name=MARKUP, revision=campaigns.c.revision + 1))
    page = opening(f"{shown.api.url}/#/nowhere")
    both = f"{shown.api.url}/#/compare?ids={shown.campaign.id},{shown.study.id}"
    for address in (f"{shown.api.url}/#/", shown.at(), shown.at("ranking"), both):
        leave(page, f"{shown.api.url}/")
        page.goto(address)
        expect(page.get_by_role("main").get_by_text(MARKUP).first).to_be_visible()
        expect(page.get_by_role("main")).not_to_contain_text(BUSY)
        expect(page.locator("img[src='x'], main script")).to_have_count(0)
        assert not page.evaluate("'carriedOut' in window")
    with shown.api.database.transaction() as connection:
        connection.execute(rename.values(name=shown.campaign.spec["name"], revision=campaigns.c.revision + 1))
