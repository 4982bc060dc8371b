"""The page on a phone: nothing that is needed lies outside of the screen."""

from __future__ import annotations

from pathlib import Path

from playwright.sync_api import Locator, expect
from tests.browser.conftest import PHONE, Opening
from tests.support.runs import SMALL, run, submit
from tests.support.server import serving


def on_screen(place: Locator) -> bool:
    """Whether a part of the page lies within the screen's width."""
    box = place.bounding_box()
    assert box is not None
    return box["x"] >= 0 and box["x"] + box["width"] <= PHONE["width"]


def test_menus_and_numbers_lie_on_the_screen(tmp_path: Path, opening: Opening) -> None:
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as api:
        campaign = run(api.database, submit(api.database, **SMALL))
        page = opening(f"{api.url}/#/campaigns/{campaign.id}", phone=True)
        for menu, content in (
            ("Views", page.get_by_label("Name of the view")),
            ("Export", page.get_by_text("settings as JSON")),
        ):
            page.get_by_text(menu, exact=True).click()
            expect(content).to_be_visible()
            assert on_screen(content.locator("xpath=ancestor::*[contains(@class, 'card')][1]")), menu
            page.get_by_role("heading", level=1).click()
            expect(content).to_be_hidden()
        page.goto(f"{api.url}/#/submit")
        for what in ("from", "to", "step", "held at", "baseline"):
            assert on_screen(page.get_by_label(f"P4 {what}", exact=True)), what
        assert page.get_by_label("P4 to", exact=True).evaluate("field => field.scrollWidth <= field.clientWidth")
        page.close()
