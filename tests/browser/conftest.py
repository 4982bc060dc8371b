"""A headless Chromium of the system, driven by Playwright, and what a user's browser would complain about or ask strangers for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright
from tests.support.browser import chromium

from drivecal.api.routes.page import FILES, REASON, START

Opening = Callable[..., Page]
expect.set_options(timeout=30_000)


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
    asked but the server whose page it is. `expected`: parts of complaints that belong to the test."""
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
