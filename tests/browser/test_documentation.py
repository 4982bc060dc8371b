"""The documentation as a browser shows it: its search, its colours, nothing inline, no other host."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Locator, Page, expect
from tests.browser.conftest import Opening
from tests.support.effort import sample
from tests.support.server import RunningApi, serving

from drivecal.api.routes.page import MANUAL, REASON, START

QUESTIONS = {
    "limit simulations": "How do I limit the number of simulations?",
    "50 simulations": "What do I take for 50, 500 or 5,000 simulations?",
    "how long": "How long will it take",
    "why is a set the best": "Why is this set the best?",
    "add a parameter": "May I add a scenario or a parameter?",
    "calibrate curve": "How do I calibrate a curve",
    "random simulation": "What if my simulation is random?",
    "licence": "Licences and other scarce things",
    "license": "My simulator needs a licence",
    "crash": "My simulator crashes or hangs",
    "four machines": "How do I use four machines?",
    "where is what stored": "What is stored where?",
    "move the database": "How do I move or copy the database?",
    "CI": "In CI",
    "lot": "Lot",
    "how many parameters": "How many parameters and scenarios",
    "which seeds": "How many runs does each set get",
    "same result": "Do I get the same result",
    "floating licence": "My simulator needs a licence",
    "power cut": "What is lost after a power cut?",
    "excel": "How do I get results into Excel",
    "red light": "What does the red or amber light mean?",
    "cost saves": "Does reuse cost more than it saves?",
    "forbid combinations": "How do I forbid combinations of values?",
    "limit measure": "How do I set a limit for a measure",
    "collision": "What is a collision or a failed run worth?",
    "old database": "May I keep my old database",
    "compare two campaigns": "How do I compare two campaigns?",
    "range too narrow": "The best value is at an end",
    "lookup table": "How do I calibrate a curve",
    "cancel campaign": "How do I stop or cancel",
    "drag a folder": "How do I upload a problem?",
    "add a machine": "How do I add a machine",
    "How do I handle licences?": "Licences and other scarce things",
    "How do I move the database to another machine?": "How do I move or copy the database?",
    "How do I add a parameter and what does it cost?": "May I add a scenario or a parameter?",
    "What does our Jenkins call?": "What do I call from CI",
    "stochastic": "What if my simulation is random?",
}
"""Words that readers type, and the heading that the search should find first."""


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningApi]:
    """Skips if the documentation was not built."""
    if not (MANUAL / START).is_file():
        reason = (MANUAL / REASON).read_text().strip() if (MANUAL / REASON).is_file() else "make docs builds it"
        pytest.skip(f"the documentation was not built: {reason}")
    with serving(f"sqlite:///{tmp_path_factory.mktemp('help') / 'drivecal.db'}") as running:
        yield running


def search(page: Page) -> Locator:
    """Opens the search and returns its field."""
    # The theme's script answers the key as soon as it runs, which nothing on the page shows: the key is pressed until the search opens.
    words = page.get_by_role("combobox", name="Search")
    for _ in range(600):
        page.keyboard.press("/")
        if words.is_visible():
            break
        page.wait_for_timeout(100)
    return words


def test_the_search_answers_questions_first(api: RunningApi, opening: Opening) -> None:
    page = opening(f"{api.url}/help")
    words = search(page)
    for typed, heading in sample(list(QUESTIONS.items()), 4):
        words.fill(typed)
        expect(page.get_by_role("option").first).to_contain_text(heading)


@pytest.mark.slow
def test_a_reader_finds_a_page_by_searching_and_follows_links(api: RunningApi, opening: Opening) -> None:
    page = opening(f"{api.url}/help")
    expect(page.get_by_role("heading", level=1)).to_contain_text("drivecal")
    expect(page.get_by_role("img", name="A campaign on the built-in motorway")).to_be_visible()
    page.get_by_role("link", name="tokens", exact=True).click()
    expect(page.get_by_role("heading", level=1)).to_contain_text("Tokens")
    search(page).fill("prediction")
    expect(page.get_by_role("option", name="Predictions").first).to_be_visible()
    page.goto(f"{api.url}/help/concepts/cells.html")
    page.get_by_role("link", name="To the page").first.click()
    expect(page.get_by_role("heading", name="Campaigns")).to_be_visible()


@pytest.mark.slow
def test_every_page_opens_without_a_complaint(api: RunningApi, opening: Opening) -> None:
    files = [file for file in sorted(MANUAL.rglob("*.html")) if file.parent.name != "decisions" and file.name != "404.html"]
    page = opening(f"{api.url}/help/", dark=True)
    for file in files:
        page.goto(f"{api.url}/help/{file.relative_to(MANUAL).as_posix()}")
        expect(page.locator("h1").first).to_be_visible()
