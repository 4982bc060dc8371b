"""The page on a phone: nothing that is needed lies outside of the screen, and a finger scrolls."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from time import sleep

import pytest
from playwright.sync_api import Browser, CDPSession, Locator, Page, expect
from tests.browser.conftest import PHONE, Opening, too_wide, unfold
from tests.support.runs import SMALL, run, submit
from tests.support.server import RunningApi, serving
from tests.support.values import present

from drivecal.storage.campaigns import StoredCampaign

RESTING_SECONDS = 0.3


@dataclass(frozen=True)
class Shown:
    """A server with a campaign that has ended."""

    api: RunningApi
    campaign: StoredCampaign

    def at(self, tab: str) -> str:
        return f"{self.api.url}/#/campaigns/{self.campaign.id}/{tab}"


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    with serving(f"sqlite:///{tmp_path_factory.mktemp('phone') / 'drivecal.db'}") as api:
        baseline = {f"P{i}": 0.5 for i in range(1, 12)}
        yield Shown(api, run(api.database, submit(api.database, **SMALL | {"baseline": baseline})))


@pytest.fixture
def touched(browser: Browser) -> Iterator[Page]:
    """A page that fingers touch."""
    context = browser.new_context(viewport=PHONE, has_touch=True)
    yield context.new_page()
    context.close()


def on_screen(place: Locator) -> bool:
    """Returns whether a part of the page lies within the screen's width."""
    box = present(place.bounding_box())
    return box["x"] >= 0 and box["x"] + box["width"] <= PHONE["width"]


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
    touched.evaluate(
        "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
    )  # until it is on the screen
    scrolled, (x, y) = touched.evaluate("scrollY"), middle(axis)
    drag(fingers, x, y, -80)
    expect(axis).not_to_have_attribute("aria-valuetext", "all")
    assert abs(touched.evaluate("scrollY") - scrolled) < 40
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
        assert on_screen(start)
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
