"""A headless Chromium of the system, driven by Playwright, and what a user's browser would complain about or ask strangers for."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, ViewportSize, expect, sync_playwright
from tests.support.tree import PROJECT
from tests.support.web import chromium

from drivecal.api.routes.page import FILES, REASON, START

Opening = Callable[..., Page]
AXE = PROJECT / "services" / "web" / "node_modules" / "axe-core" / "axe.min.js"
TABS = ("overview", "ranking", "evaluations", "influence", "savings", "trust", "review")
"""Views of a campaign."""
expect.set_options(timeout=90_000)


GONE = ("ERR_CONNECTION_", "ERR_EMPTY_RESPONSE", "ERR_INCOMPLETE_CHUNKED_ENCODING")
"""Complaints of a page whose server ends, between two requests or in one."""
BUSY = re.compile("Loading|Reading|Counting")
"""Words of a view that is not there yet."""
DESKTOP, PHONE = ViewportSize(width=1280, height=900), ViewportSize(width=390, height=844)


def barriers(page: Page, *, contrast_alone: bool = False) -> list[tuple[str, list[str]]]:
    """Returns what axe-core finds in the page as it is: the rule, and the first elements that break it.

    Content that does not fit into the page's width counts as well. Skips where axe-core is not there."""
    if not AXE.is_file():
        pytest.skip("axe-core is not there: `make test` could not fetch it")
    expect(page.get_by_role("main")).not_to_contain_text(BUSY)
    if not page.evaluate("'axe' in window"):
        page.evaluate(AXE.read_text())
    options = {"resultTypes": ["violations"]} | ({"runOnly": ["color-contrast"]} if contrast_alone else {})
    violations: list[dict[str, Any]] = page.evaluate("(options) => axe.run(options).then((found) => found.violations)", options)
    broken = [(rule["id"], [node["html"][:150] for node in rule["nodes"]][:3]) for rule in violations]
    return broken + too_wide(page)


def too_wide(page: Page) -> list[tuple[str, list[str]]]:
    """Returns whether anything does not fit into the page's width."""
    fits = page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    return [] if fits else [("wider than the page", [page.url])]


def barriers_everywhere(page: Page) -> list[tuple[str, list[str]]]:
    """The barriers in the light on a desktop; and in the dark on a phone, where contrast and width differ."""
    broken = barriers(page)
    show(page, dark=True, phone=True)
    broken += barriers(page, contrast_alone=True)
    show(page)
    return broken


def show(page: Page, *, dark: bool = False, phone: bool = False) -> None:
    """Changes colours and size of a page."""
    page.emulate_media(color_scheme="dark" if dark else "light")
    page.set_viewport_size(PHONE if phone else DESKTOP)


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


@dataclass
class Seen:
    """Describes what a test's pages complain about, and whom they ask."""

    complaints: list[str] = field(default_factory=list)
    strangers: list[str] = field(default_factory=list)


@dataclass
class Kept:
    """The page that the tests of a module share: to load a page takes seconds, to change its view a fraction."""

    page: Page | None = None
    origin: str = ""
    busy: bool = False
    seen: Seen = field(default_factory=Seen)


@pytest.fixture(scope="module")
def kept(browser: Browser) -> Iterator[Kept]:  # noqa: ARG001  # the browser outlives its page
    """No page before the first test that opens one."""
    shared = Kept()
    yield shared
    if shared.page is not None:
        shared.page.context.close()


@pytest.fixture
def opening(browser: Browser, kept: Kept) -> Iterator[Opening]:
    """Opens pages: first the module's own, in a new view; then others, each in a context of its own that has never been used.

    At the end no page may have complained, or asked another server. `expected`: parts of complaints that belong to the test. A test that
    ends its server closes its page before, which complains about a lost connection otherwise.
    """
    contexts: list[BrowserContext] = []
    excused: list[str] = []
    kept.seen, kept.busy = Seen(), False

    def new_page(origin: str) -> Page:
        context = browser.new_context(viewport=DESKTOP)
        page = context.new_page()
        page.set_default_timeout(90_000)
        page.on("console", lambda one: kept.seen.complaints.append(one.text) if one.type in {"error", "warning"} else None)
        page.on("pageerror", lambda error: kept.seen.complaints.append(str(error)))
        own = {urlsplit(origin).netloc, ""}
        page.on("request", lambda one: kept.seen.strangers.append(one.url) if urlsplit(one.url).netloc not in own else None)
        return page

    def open_(address: str, *, dark: bool = False, phone: bool = False, expected: tuple[str, ...] = ()) -> Page:
        excused.extend(expected)
        place = urlsplit(address)
        origin = f"{place.scheme}://{place.netloc}/"
        if kept.busy:
            page = new_page(origin)
            contexts.append(page.context)
        else:
            if kept.page is None or kept.page.is_closed() or kept.origin != origin:
                if kept.page is not None:
                    kept.page.context.close()
                kept.page, kept.origin = new_page(origin), origin
            kept.busy, page = True, kept.page
            leave(page, origin)
        show(page, dark=dark, phone=phone)
        page.goto(address)
        return page

    yield open_
    if kept.page is not None and not kept.page.is_closed():
        if GONE[0] in excused:  # it goes on asking for its server
            kept.page.context.close()
        else:
            leave(kept.page, kept.origin)
    for context in contexts:
        context.close()
    assert [complaint for complaint in kept.seen.complaints if not any(part in complaint for part in excused)] == []
    assert kept.seen.strangers == []


def unfold(page: Page, *folds: str) -> None:
    """Opens these folds of the form."""
    for fold in folds:
        page.locator("summary", has_text=re.compile(f"^{fold}")).click()


def leave(page: Page, origin: str) -> None:
    """Leaves the view of a page that shows one, so that the next begins anew."""
    if page.url.startswith(f"{origin}#"):
        page.goto(f"{origin}#/nowhere")
        expect(page.get_by_role("heading", name="There is no such view")).to_be_visible()


AWAY = ("ERR_INTERNET_DISCONNECTED",)
"""Complaints of a page without its server."""


def away_and_back(page: Page, address: str) -> None:
    """Opens a view while the server cannot be reached, and waits until the view is there, by itself, when the server is back."""
    leave(page, address.partition("#")[0])
    page.evaluate("window.neverReloaded = true")
    page.context.set_offline(True)
    page.goto(address)
    expect(page.get_by_text("cannot be reached").first).to_be_visible()
    expect(page.get_by_text("Connection lost")).to_be_visible()
    expect(page.get_by_text(re.compile("^(Nothing to rank|No evaluation|No campaign|No problem) "))).to_have_count(0)
    page.context.set_offline(False)
    expect(page.get_by_text(re.compile("Connection lost|cannot be reached"))).to_have_count(0)
    expect(page.get_by_role("main")).not_to_contain_text(BUSY)
    expect(page.locator("main h1")).to_be_visible()
    assert page.evaluate("window.neverReloaded")
