"""The page on a real server: a campaign that SUMO drives, and its replay."""

from __future__ import annotations

import re
from pathlib import Path

import httpx
from playwright.sync_api import expect
from tests.browser.conftest import Opening
from tests.support.serve import serving

SMALL = {"sensitivity": None, "catalogue": ["S3"], "optimizer": {"kind": "random", "population": 4, "iterations": 1}}


def test_from_the_ranking_to_the_replay_in_two_clicks(tmp_path: Path, opening: Opening) -> None:
    with serving(tmp_path) as server:
        made = httpx.post(f"{server.url}/api/v1/campaigns", json=SMALL, timeout=30).json()
        page = opening(f"{server.url}/#/campaigns/{made['id']}")
        expect(page.get_by_text("Finished.")).to_be_visible()
        page.get_by_role("link", name="Ranking").click()
        page.get_by_role("row").nth(1).get_by_role("button").click()
        expect(page.get_by_role("img", name=re.compile("Top view of the road at 0 s"))).to_be_visible()
        expect(page.get_by_role("heading", name="Jerk")).to_be_visible()
        page.get_by_role("slider", name="Moment").fill("3.5")
        page.get_by_role("button", name="A step ahead").click()
        expect(page.get_by_role("img", name=re.compile("Top view of the road at 3.6 s"))).to_be_visible()
        page.wait_for_url(re.compile(r"t=3\.6"))
        page.get_by_role("button", name="Play").click()
        expect(page.get_by_role("img", name=re.compile(r"Top view of the road at [45]"))).to_be_visible()
        again = opening(page.url)
        expect(again.get_by_role("button", name="Play")).to_be_visible()
