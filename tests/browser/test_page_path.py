"""The whole way of a user on a real server, with a campaign that SUMO drives."""

import re
from pathlib import Path

import pytest
from playwright.sync_api import expect
from tests.browser.conftest import GONE, Opening, barriers, unfold
from tests.support.serve import serving
from tests.support.server import free_port

from drivecal.client import Client

pytestmark = pytest.mark.slow

PLAYED = """async () => {
  const shown = () => parseFloat(document.querySelector("output").textContent);
  const press = (name) => document.querySelector(`button[aria-label="${name}"]`).click();
  const [own, waiting, moments, start] = [window.requestAnimationFrame, [], [], performance.now()];
  window.requestAnimationFrame = (frame) => waiting.push(frame);
  press("Play");
  for (let time = start; time <= start + 5000; time += 100) {
    await new Promise((after) => setTimeout(after));
    for (const frame of waiting.splice(0)) frame(time);
    await new Promise((after) => setTimeout(after));
    moments.push(shown());
  }
  press("Pause");
  window.requestAnimationFrame = own;
  return moments.at(-1) - moments[0];
}"""
"""Plays frames of 5 s, which are 100 ms apart however busy the machine is; returns the seconds of the replay that they show."""


def test_from_the_form_to_the_replay_and_back_through_a_restart(tmp_path: Path, opening: Opening) -> None:
    port = free_port()
    with serving(tmp_path, port=port, DRIVECAL_BACKEND="processes") as server:
        page = opening(f"{server.url}/#/submit", expected=(*GONE, "409"))
        page.evaluate("window.neverReloaded = true")
        page.get_by_label("name").fill("the whole way")
        for scenario in ("S1", "S2", "S4", "S6"):
            page.get_by_role("checkbox", name=scenario).uncheck()
        unfold(page, "Search")
        page.get_by_label("kind").select_option("random")
        page.get_by_label("population").fill("30")
        page.get_by_label("iterations").fill("3")
        expect(page.get_by_text("for 180 proposed cells")).to_be_visible()
        page.get_by_role("button", name="Start it").click()
        page.get_by_role("button", name="Pause").click()
        expect(page.get_by_text(re.compile("Asked to pause|Paused\\. All"))).to_be_visible()
    expect(page.get_by_text("Connection lost")).to_be_visible()

    with serving(tmp_path, port=port, DRIVECAL_BACKEND="processes"):
        expect(page.get_by_text("Connection lost")).not_to_be_visible()
        page.get_by_role("button", name="Resume").click()
        expect(page.get_by_text("Finished.")).to_be_visible(timeout=180_000)
        expect(page.get_by_role("img", name=re.compile(r"^\d+ requested: .*; 0 pending"))).to_be_visible()
        assert page.evaluate("window.neverReloaded")
        first = page.url.rpartition("/")[2]

        page.get_by_role("link", name="Ranking", exact=True).click()
        page.get_by_role("row").nth(1).get_by_role("button").nth(1).click()
        expect(page.get_by_role("heading", level=1)).to_contain_text("S5 · evaluation")
        expect(page.get_by_role("img", name=re.compile("Top view of the road at 0 s"))).to_be_visible()
        expect(page.get_by_role("heading", name="Lateral jerk")).to_be_visible()
        expect(page.get_by_role("heading", name="Origin of the result")).to_be_visible()
        assert barriers(page) == []
        page.get_by_role("slider", name="Moment").fill("3.5")
        page.get_by_role("button", name="A step ahead").click()
        expect(page.get_by_role("img", name=re.compile("Top view of the road at 3.6 s"))).to_be_visible()
        page.wait_for_url(re.compile(r"t=3\.6"))
        with page.expect_download() as drawn:
            page.get_by_role("button", name="SVG").first.click()
        assert drawn.value.path().read_text().startswith("<svg")
        assert page.evaluate(PLAYED) == pytest.approx(5.0, abs=0.11)  # shown in tenths
        expect(page.get_by_role("img", name=re.compile(r"Top view of the road at ([4-9]|\d\d)"))).to_be_visible()
        played = opening(page.url.partition("?")[0] + "?play=2")
        expect(played.get_by_role("img", name="Top view of the road at 2 s", exact=False)).to_be_visible()
        expect(played.get_by_role("button", name="Play", exact=True)).to_be_visible()
        expect(opening(page.url).get_by_role("img", name=re.compile(r"Top view of the road at ([3-9]|\d\d)"))).to_be_visible()

        page.get_by_role("link", name="In its campaign").click()
        page.get_by_role("link", name="Ranking", exact=True).click()
        page.get_by_text("Weigh the scenarios differently").click()
        page.get_by_role("slider", name="S5").fill("3")
        expect(page.get_by_text("Ranked under S3=1,S5=3")).to_be_visible()
        page.get_by_role("button", name="Search again under these weights").click()
        page.get_by_role("link", name="compare", exact=True).click()
        expect(page.get_by_role("row", name="weights.S5")).to_contain_text("3")
        page.get_by_role("link", name="the whole way").last.click()
        page.get_by_role("link", name="Overview", exact=True).click()
        expect(page.get_by_text("Finished.")).to_be_visible(timeout=180_000)
        assert first not in page.url

        page.get_by_role("link", name="Evaluations", exact=True).click()
        with page.expect_download() as table:
            page.get_by_role("link", name="CSV").click()
        assert table.value.path().read_text().startswith("id,stage,iteration,individual,scenario,P1")
        assert page.evaluate("window.neverReloaded")

        campaign = searched_for_two(f"http://127.0.0.1:{port}")
        page.goto(f"http://127.0.0.1:{port}/#/campaigns/{campaign}/front?row=2&with=1")
        page.get_by_role("button", name="in S3").click()
        beside = page.get_by_role("img", name=re.compile("Top view of the road at 0 s"))
        expect(beside).to_have_count(2, timeout=120_000)  # the workers of the new server may still start
        both = page.get_by_role("group", name="Both in S3")
        both.get_by_role("slider", name="Moment").fill("2")
        expect(both.get_by_role("img", name=re.compile("Top view of the road at 2 s"))).to_have_count(2)
        for name in ("Set 1", "Set 2"):
            expect(both.get_by_role("table", name="Measures of both")).to_contain_text(name)
        assert barriers(page) == []


def searched_for_two(url: str) -> str:
    """The id of a small search for comfort and little jerk that has ended."""
    spec = {
        "catalogue": ["S3"],
        "objectives": [{"score": "comfort"}, {"measure": "peak_lateral_jerk_mps3", "direction": "minimise", "failed": 20.0}],
        "budget": {"simulations": 16},
        "sensitivity": None,
        "reduction": {"mode": "exact"},
    }
    with Client(url) as client:
        campaign = client.wait(client.submit(spec).id)
        assert len(client.front(campaign.id)) > 1
        return campaign.id
