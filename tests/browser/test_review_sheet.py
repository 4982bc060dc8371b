"""The review sheet in a browser: it opens offline, and prints on A4 with every number."""

import io
import re
import unicodedata
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import Browser
from pypdf import PdfReader
from tests.unit.report.test_review import BOTH, compromise, review, summary

from drivecal.contracts.setup import CampaignSetup, ScenarioSetup, SearchedParameter
from drivecal.report.data import ReviewedSet, ScoreOrigin
from drivecal.report.review import sheet
from drivecal.report.sheet import digest_in

A4_MM = (210.0, 297.0)
POINTS_PER_MM = 72 / 25.4
PRINTED_PIXELS = round((210 - 2 * 14) / 25.4 * 96)
"""Width of the page between its margins."""
NARROW = """[...document.querySelectorAll('td, th, p, pre, figure, li')]
    .filter((each) => each.scrollWidth > each.clientWidth + 1).map((each) => each.textContent)"""
"""The texts that are wider than their place."""


def large(identifier: str) -> ReviewedSet:
    """Returns a set of 25 scenarios and 30 parameters with long names and all digits."""
    scenarios = [f"scenario_with_a_long_name_{number:03d}" for number in range(25)]
    names = [f"ACC_ComfortLongitudinalControl_tGapDesired_{number:03d}_C" for number in range(30)]
    setups = [
        ScenarioSetup(scenario=name, weight=0.04, fingerprint=f"{number:064x}", title="A vehicle cuts in closely on a wet road")
        for number, name in enumerate(scenarios)
    ]
    parameters = [
        SearchedParameter(
            name=name,
            unit="m/s^2",
            lower=-1e5 / 3,
            upper=1e5 / 3,
            n_values=1001,
            fixed=None,
            description="desired gap at low speed",
        )
        for name in names
    ]
    made = compromise(identifier)
    chosen = made.chosen.model_copy(
        update={"scores": dict.fromkeys(scenarios, 4.123456), "parameters": dict.fromkeys(names, 100000.0 / 7)}
    )
    cells = {name: ScoreOrigin(10**6 + number, "repeated") for number, name in enumerate(scenarios)}
    setup = CampaignSetup(evaluator="score 1", parameters=parameters, scenarios=setups, server="1.2.3")
    results = made.results.model_copy(update={"setup": setup})
    return replace(made, results=results, chosen=chosen, cells=cells, summary=summary())


@pytest.mark.slow("large")
@pytest.mark.parametrize("page", [BOTH, sheet(review(large("a" * 32), large("b" * 32)))], ids=["small", "large"])
def test_a_sheet_opens_offline_and_prints_on_a4_with_every_number(browser: Browser, page: str, tmp_path: Path) -> None:
    file = tmp_path / "sheet.html"
    file.write_text(page)
    complaints: list[str] = []
    requests: list[str] = []
    context = browser.new_context(offline=True, java_script_enabled=True, viewport={"width": PRINTED_PIXELS, "height": 900})
    opened = context.new_page()
    opened.on("console", lambda message: complaints.append(message.text))
    opened.on("request", lambda request: requests.append(request.url))
    opened.goto(file.as_uri())
    opened.emulate_media(media="print")
    assert opened.evaluate(NARROW) == []
    assert opened.evaluate("document.documentElement.scrollWidth") <= PRINTED_PIXELS
    document = PdfReader(io.BytesIO(opened.pdf(prefer_css_page_size=True)))
    context.close()
    assert complaints == []
    assert [url for url in requests if not url.startswith(("file:", "data:"))] == []

    texts = [each.extract_text() for each in document.pages]
    assert len(texts) > 1
    for number, (printed, text) in enumerate(zip(document.pages, texts, strict=True), 1):
        size = float(printed.mediabox.width) / POINTS_PER_MM, float(printed.mediabox.height) / POINTS_PER_MM
        assert size == pytest.approx(A4_MM, abs=1.0)
        assert letters(f"{number} of {len(texts)}") in letters(text)
        assert digest_in(page) in letters(text)
    together = letters("".join(texts))
    shown = {letters(text) for text in re.findall(r"<t[dh][^>]*>([^<&]*)</t[dh]>", page)}
    assert {text for text in shown if text not in together} == set()


def letters(text: str) -> str:
    """The text without spaces and ligatures."""
    return re.sub(r"\s", "", unicodedata.normalize("NFKC", text))
