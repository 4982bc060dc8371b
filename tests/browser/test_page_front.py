"""The front of a campaign on the page: two sets next to each other, weights and their winner, what is kept and exported."""

import csv
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from playwright.sync_api import Route, expect
from tests.browser.conftest import Opening
from tests.support.computed import ComputedBackend
from tests.support.problems import store, submit_checked
from tests.support.runs import run
from tests.support.server import RunningApi, serving
from tests.support.several import SEARCH, installed

from drivecal.contracts.work import Cell, CellResult

pytestmark = pytest.mark.slow

SEAT: dict[str, Any] = {
    "problem": "seat",
    "parameters": {name: {"lower": 0, "upper": 1, "unit": "kN/m"} for name in ("spring", "damper")}
    | {"mode": {"choices": ["eco", "sport"]}},
    "baseline": {"spring": 0.5, "damper": 0.5, "mode": "eco"},
    "simulator": {"kind": "python", "file": "model.py", "function": "evaluate", "deterministic": True},
    "scenarios": {"city": {}, "rough": {}},
    "measures": {"heave": "mm", "energy": "W", "roll": "deg"},
    "scores": {
        name: {"formula": name, "direction": "minimise", "range": [0, 10], "unit": unit}
        for name, unit in (("heave", "mm"), ("energy", "W"), ("roll", "deg"))
    },
}
SPEC: dict[str, Any] = {
    "problem": "seat",
    "objectives": [{"score": name} for name in ("heave", "energy")],
    "optimizer": SEARCH,
    "reduction": {"mode": "exact"},
}


def seated(scenario: str, cell: Cell) -> CellResult:
    """ZDT1 of the spring and the damper, with a roll that falls where both others grow."""
    spring, damper = cell.parameters["spring"], cell.parameters["damper"]
    slope = 1 + 3 * damper + (0.5 if cell.parameters["mode"] == "eco" else 0) + (0.2 if scenario == "rough" else 0)
    energy = slope * (1 - (spring / slope) ** 0.5)
    return CellResult(cell.id, None, None, {"heave": spring, "energy": energy, "roll": 3 - spring - damper}, None, 7.0)


@dataclass(frozen=True)
class Shown:
    """A server with a front of two and one of three objectives, another search of the same space, and a campaign that only waits."""

    api: RunningApi
    two: str
    three: str
    waiting: str

    def at(self, campaign: str, tab: str = "front", query: str = "") -> str:
        return f"{self.api.url}/#/campaigns/{campaign}/{tab}{query}"

    def front(self, campaign: str, **query: Any) -> list[dict[str, Any]]:
        items: list[dict[str, Any]] = self.get(campaign, "front", limit=1000, **query)["items"]
        return items

    def get(self, campaign: str, *path: str, **query: Any) -> dict[str, Any]:
        answer: dict[str, Any] = (
            self.api.http.get(f"/api/v1/campaigns/{'/'.join([campaign, *path])}", params=query).raise_for_status().json()
        )
        return answer


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    with installed(), serving(f"sqlite:///{tmp_path_factory.mktemp('front') / 'drivecal.db'}") as api:
        store(api.database, SEAT, {"model.py": "def evaluate(parameters, scenario): ...\n"})
        third = {"objectives": [*SPEC["objectives"], {"score": "roll"}], "optimizer": SPEC["optimizer"] | {"iterations": 3}}
        ended = [
            run(api.database, submit_checked(api.database, SPEC | changes), ComputedBackend(answer=seated)).id
            for changes in ({}, third, {"optimizer": SPEC["optimizer"] | {"seed": 5}})
        ]
        yield Shown(api, ended[0], ended[1], submit_checked(api.database, SPEC | {"name": "waits"}).id)


def test_two_sets_are_chosen_by_keys_and_compared_by_their_objectives(shown: Shown, opening: Opening) -> None:
    rows = shown.front(shown.two)
    page = opening(shown.at(shown.two))
    place = page.get_by_role("slider", name=re.compile("^Set in view"))
    place.press("Home")
    expect(place).to_have_attribute("aria-valuetext", re.compile("^set 1, best heave, heave .* mm, energy .* W$"))
    place.press("Enter")
    place.press("End")
    page.get_by_role("heading", name=f"Set {len(rows)} against set 1").wait_for()
    objectives = page.get_by_role("table", name="Objectives of both sets").get_by_role("row")
    for name, sign in (("heave", "−"), ("energy", "+")):
        gain = abs(rows[-1]["objectives"][name] - rows[0]["objectives"][name])
        expect(objectives.filter(has_text=name)).to_contain_text(sign + str(gain)[:4])
    selected = page.locator("[role=row][aria-selected=true]")
    expect(selected.get_by_role("gridcell").first).to_have_text("1")
    expect(selected.last.get_by_role("gridcell").first).to_have_text(str(len(rows)))
    page.wait_for_url(re.compile(f"row={len(rows)}&with=1|with=1&row={len(rows)}"))
    page.get_by_role("button", name="in city").click()
    beside = page.get_by_role("table", name="Measures of both")
    for name in (f"Set {len(rows)}", "Set 1", "mm"):
        expect(beside).to_contain_text(name)
    page.wait_for_url(re.compile("beside=city"))
    page.reload()
    expect(page.get_by_role("table", name="Measures of both")).to_be_visible()
    page.get_by_role("button", name="Swap").click()
    expect(page.get_by_role("heading", name=f"Set 1 against set {len(rows)}")).to_be_visible()


def test_moved_weights_name_the_winner_at_once_and_files_follow_them(shown: Shown, opening: Opening) -> None:
    page = opening(shown.at(shown.two))
    weights = page.get_by_role("region", name="Weights")
    weights.get_by_role("slider", name="Weight of heave").fill("90")
    [first, *_] = shown.front(shown.two, weights="heave=0.9,energy=0.1")
    rank = next(row["rank"] for row in shown.front(shown.two) if row["parameters"] == first["parameters"])
    expect(weights.get_by_role("status")).to_contain_text(f"Set {rank} wins")
    with page.expect_download() as saved:
        page.get_by_role("link", name="CSV").last.click()
    exported = list(csv.DictReader(io.StringIO(saved.value.path().read_text())))
    assert float(exported[0]["spring"]) == first["parameters"]["spring"]
    assert float(exported[0]["weighted"]) == pytest.approx(first["weighted"])
    expect(page.get_by_role("grid").get_by_role("row").nth(1).get_by_role("gridcell").first).to_have_text(str(rank))
    weights.get_by_role("button", name="Equal weights").click()
    expect(weights.get_by_role("slider", name="Weight of heave")).to_have_value("50")


def test_an_overview_shows_a_small_front_that_leads_to_its_view(shown: Shown, opening: Opening) -> None:
    page = opening(shown.at(shown.two, "overview"))
    front = page.get_by_role("region", name="Front")
    expect(front).to_contain_text("best heave")
    expect(front).to_contain_text("Baseline, dominated")
    front.get_by_role("link", name="Set 1, best heave").click()
    expect(page.get_by_role("heading", name=re.compile("^Set 1 against set"))).to_be_visible()


def test_a_comparison_that_is_left_while_it_reads_says_nothing(shown: Shown, opening: Opening) -> None:
    page = opening(shown.at(shown.two, query="?row=1&with=2"))
    held: list[Route] = []
    page.route(re.compile("/cell[?]"), lambda route: held.append(route))  # noqa: PLW0108  # Playwright marks its handlers
    with page.expect_request(re.compile("/cell[?]")):
        page.get_by_role("button", name="in city").click()
    page.goto(f"{shown.api.url}/#/nowhere")
    expect(page.get_by_role("heading", name="There is no such view")).to_be_visible()
    with page.expect_request_finished(lambda request: request == held[-1].request):
        for route in held:
            route.continue_()
    page.unroute_all()
    expect(page.get_by_role("heading", name="There is no such view")).to_be_visible()
