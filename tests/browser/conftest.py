"""A headless Chromium of the system, driven by Playwright, and what a user's browser would complain about or ask strangers for."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright
from tests.support.browser import chromium
from tests.support.tree import PROJECT

from drivecal.api.routes.page import FILES, REASON, START

Opening = Callable[..., Page]
AXE = PROJECT / "services" / "web" / "node_modules" / "axe-core" / "axe.min.js"
TABS = ("overview", "ranking", "evaluations", "curves", "influence", "savings", "trust")
"""Views of a campaign."""
expect.set_options(timeout=30_000)


def barriers(page: Page, *, contrast_alone: bool = False) -> list[tuple[str, list[str]]]:
    """What axe-core finds in the page as it is: the rule, and the first elements that break it. Whatever does not fit into the page's
    width counts as well. Skips where axe-core is not there."""
    if not AXE.is_file():
        pytest.skip("axe-core is not there: `make test` could not fetch it")
    expect(page.get_by_role("main")).not_to_contain_text(re.compile("Loading|Reading|Counting"))
    if not page.evaluate("'axe' in window"):
        page.evaluate(AXE.read_text())
    rules = "{runOnly: ['color-contrast']}" if contrast_alone else "{}"
    found: list[dict[str, Any]] = page.evaluate(f"axe.run({rules}).then((found) => found.violations)")
    broken = [(one["id"], [node["html"][:150] for node in one["nodes"]][:3]) for one in found]
    if not page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"):
        broken.append(("wider than the page", [page.url]))
    return broken


@pytest.fixture(scope="module")  # its event loop must not outlive these tests
def browser() -> Iterator[Browser]:
    """Skips where there is no browser, and where the page was not built."""
    command = chromium()
    if not (FILES / START).is_file():
        reason = (FILES / REASON).read_text().strip() if (FILES / REASON).is_file() else "make page builds it"
        pytest.skip(f"the page was not built: {reason}")
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=command, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture
def opening(browser: Browser) -> Iterator[Opening]:
    """Opens pages, each in a context of its own that has never been used; at the end nothing may have been complained about, and nobody
    asked but the server whose page it is. `expected`: parts of complaints that belong to the test. A test that ends its server closes its
    page before, which complains about a lost connection otherwise."""
    contexts: list[BrowserContext] = []
    complaints: list[str] = []
    strangers: list[str] = []
    excused: list[str] = []

    def open_(address: str, *, dark: bool = False, phone: bool = False, expected: tuple[str, ...] = ()) -> Page:
        context = browser.new_context(
            color_scheme="dark" if dark else "light",
            viewport={"width": 390, "height": 844} if phone else {"width": 1280, "height": 900},
        )
        contexts.append(context)
        excused.extend(expected)
        page = context.new_page()
        page.set_default_timeout(30_000)
        own = urlsplit(address).netloc
        page.on("console", lambda one: complaints.append(one.text) if one.type in {"error", "warning"} else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda one: strangers.append(one.url) if urlsplit(one.url).netloc not in {own, ""} else None)
        page.goto(address)
        return page

    yield open_
    for context in contexts:
        context.close()
    assert [one for one in complaints if not any(part in one for part in excused)] == []
    assert strangers == []
