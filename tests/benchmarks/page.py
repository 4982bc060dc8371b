"""How the page bears large campaigns: `python tests/benchmarks/run.py page [--evaluations 12000 100000] [--sets 2000]`.

A campaign of each size, whose simulation is a formula, is shown by the API in a process of its own to a headless Chromium of the system.
Measured: from an empty tab to the campaign's state, to the first chart and table of its evaluations, and until all of them are there and
drawn; the longest frame while a brush is drawn along two axes and while the table is scrolled, by the
browser's own animation frames, at the first try and the least of several; the memory of the page's script; by how much the server grows
for each page that is open; and, of a campaign that this process carries out, the longest time from a stored iteration to
its point on the overview. Then the view Front of a campaign whose sets are all on the front: the longest frame, the least of several
tries, while a slider of weights is drawn, the weights are moved on their map, and a range is drawn along an axis and in the scatter.

Where there is no Chromium or the page was not built, it says so and ends with 0.

Writes `.drivecal/bench/page.json`.
"""

import argparse
import json
import math
import random
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Locator, Page, expect, sync_playwright
from tests.support.api_process import ApiProcess, api_process
from tests.support.computed import ComputedBackend
from tests.support.runs import dispatcher, get, submit
from tests.support.several import installed
from tests.support.values import present
from tests.support.web import CHROMIUM

from drivecal.api.routes.page import FILES, START
from drivecal.contracts.work import Cell, CellResult
from drivecal.storage import generations
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

TARGET = Path(".drivecal/bench/page.json")
SCENARIOS = 6
PAGES = 3
"""Open at once, for what each costs the server."""
MOST_SECONDS, MOST_FRAME, MOST_SERVER = 3.0, 51.0, 100.0
"""To the first view, of a frame in milliseconds, of the server's growth for each page in MB."""
MOST_FRONT_FRAME = 50.0
"""Milliseconds."""
ITERATIONS = 12
"""Length of the campaign that the page follows."""
STEPS = 40
"""Moves of the pointer along an axis."""
TRIES = 3
"""Repeats of a measurement. The smallest value counts: other work of the machine only lengthens a frame."""
OBJECTIVES = ("offset_peak_m", "peak_lateral_jerk_mps3")
WATCH = """() => {
    window.longest = 0;
    let last = performance.now();
    const tick = (now) => {
        window.longest = Math.max(window.longest, now - last);
        last = now;
        window.watching = requestAnimationFrame(tick);
    };
    window.watching = requestAnimationFrame(tick);
}"""
DRAWN = """(iterations) => [...document.querySelectorAll('[aria-label^="Best score by simulations"] path[stroke-dasharray="7 3"]')]
    .some((path) => path.getAttribute('d').split('L').length >= iterations)"""
LONGEST = "() => { cancelAnimationFrame(window.watching); return window.longest; }"


def main(arguments: Sequence[str]) -> int:
    """Measures, prints and writes; 0 where nothing was slower or larger than promised, or where there is nothing to measure with."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--evaluations", type=int, nargs="*", default=[12_000, 100_000], help="sizes of the campaign")
    parser.add_argument("--sets", type=int, default=2000, help="on the front")
    options = parser.parse_args(arguments)
    sizes = options.evaluations
    command = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if command is None or not (FILES / START).is_file():
        print("not measured: " + ("no Chromium is installed" if command is None else "the page was not built (make page)"))
        return 0
    figures: dict[str, dict[str, float]] = {}
    for size in sizes:
        with tempfile.TemporaryDirectory(prefix="drivecal-page-") as name:
            url = f"sqlite:///{name}/drivecal.db"
            campaign = carried_out(url, size)
            with api_process(url, Path(name)) as api, sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=command, args=["--no-sandbox"])
                measured = measure(browser, api, campaign)
                figures[f"{campaign.cells.requested}"] = measured | {"seconds_to_overview": followed(browser, api, url)}
                browser.close()
    with tempfile.TemporaryDirectory(prefix="drivecal-page-") as name:
        url = f"sqlite:///{name}/drivecal.db"
        campaign = with_front(url, options.sets)
        with api_process(url, Path(name)) as api, sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=command, args=["--no-sandbox"])
            frames = measure_front(browser, api, campaign)
            browser.close()
    if figures:
        show(figures)
    print(
        f"longest frames of a front of {options.sets:,} sets: "
        + ", ".join(f"{name} {most:.0f} ms" for name, most in frames.items())
    )
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(figures | {"front": {"sets": options.sets} | frames}, indent=2))
    limits = {"seconds_to_state": 1.0, "seconds_to_evaluations": MOST_SECONDS, "server_megabytes_for_each_page": MOST_SERVER}
    limits |= {"seconds_to_overview": 1.0, "brush_longest_frame_ms": MOST_FRAME, "scroll_longest_frame_ms": MOST_FRAME}
    missed = [f"{size}: {what}" for size, found in figures.items() for what, most in limits.items() if found[what] > most]
    for item in missed:
        print(f"missed: {item} (at most {limits[item.partition(': ')[2]]:g})")
    slow = [name for name, most in frames.items() if most > MOST_FRONT_FRAME]
    for name in slow:
        print(f"missed: front, {name} (at most {MOST_FRONT_FRAME:g})")
    return int(bool(missed or slow))


def carried_out(url: str, size: int) -> StoredCampaign:
    """A campaign of at least `size` evaluations in a new database: of a start population no cell is carried over."""
    optimizer = {"kind": "random", "population": math.ceil(size / SCENARIOS), "iterations": 1, "seed": 1}
    return ended(url, ComputedBackend(), optimizer=optimizer, catalogue="highway")


def with_front(url: str, sets: int) -> StoredCampaign:
    """A campaign of this many sets in a new database, which lie on a quarter of a circle, so that none dominates another."""

    def on_circle(_: str, cell: Cell) -> CellResult:
        angle = random.Random(str(cell.parameters)).random() * math.pi / 2
        metrics = dict(zip(OBJECTIVES, (1 - math.cos(angle), 1 - math.sin(angle)), strict=True))
        return CellResult(cell.id, 5.0, 5, metrics, None, 7.0)

    optimizer = {"kind": "several", "population": sets, "iterations": 1, "seed": 1}
    objectives = [{"measure": name, "direction": "minimise"} for name in OBJECTIVES]
    backend = ComputedBackend(answer=on_circle)
    with installed():
        return ended(
            url, backend, optimizer=optimizer, catalogue=["S1", "S2"], objectives=objectives, reduction={"mode": "exact"}
        )


def ended(url: str, backend: ComputedBackend, **specification: Any) -> StoredCampaign:
    """A campaign that was carried out in a new database."""
    database = Database.open(url)
    database.upgrade()
    campaign = submit(database, parameters="highway", **specification)
    working = dispatcher(database, backend)
    started = time.perf_counter()
    while not get(database, campaign).state.ended:
        for _ in range(20):
            working.step()
    carried = get(database, campaign)
    assert carried.error is None, carried.error
    print(f"{carried.cells.requested:,} evaluations made in {time.perf_counter() - started:.0f} s", flush=True)
    database.dispose()
    return carried


def measure(browser: Browser, api: ApiProcess, campaign: StoredCampaign) -> dict[str, float]:
    """The figures of one campaign."""
    address = f"{api.url}/#/campaigns/{campaign.id}"
    api.http.get("/api/v1/campaigns").raise_for_status()
    before = api.megabytes
    result: dict[str, float] = {}

    first = browser.new_page(viewport={"width": 1280, "height": 900})
    result["seconds_to_state"] = seconds_to(first, address, first.get_by_text("Finished.").wait_for)
    first.close()

    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(120_000)
    result["seconds_to_evaluations"] = seconds_to(page, f"{address}/evaluations", page.get_by_role("grid").wait_for)
    began = time.perf_counter()
    expect(page.get_by_text(re.compile("Reading|drawing"))).to_have_count(0, timeout=120_000)
    result["seconds_to_all"] = result["seconds_to_evaluations"] + time.perf_counter() - began
    for what, frame in (("brush", brushed), ("scroll", scrolled)):
        frames = [frame(page) for _ in range(TRIES)]
        result[f"{what}_first_longest_frame_ms"], result[f"{what}_longest_frame_ms"] = frames[0], min(frames)
    memory: Any = page.context.new_cdp_session(page).send("Runtime.getHeapUsage")
    result["heap_megabytes"] = (memory["usedSize"] + memory.get("backingStorageSize", 0)) / 2**20

    others = [browser.new_page() for _ in range(PAGES - 1)]
    for other in others:
        other.goto(f"{address}/evaluations")
        expect(other.get_by_role("grid")).to_be_visible(timeout=120_000)
    result["server_megabytes_for_each_page"] = max(0.0, api.megabytes - before) / PAGES
    for item in (page, *others):
        item.close()
    return result


def seconds_to(page: Page, address: str, there: Any) -> float:
    """From an empty tab to what `there` waits for."""
    started = time.perf_counter()
    page.goto(address)
    there()
    return time.perf_counter() - started


def followed(browser: Browser, api: ApiProcess, url: str) -> float:
    """The longest time from a stored iteration to the course on the overview that shows it, while this process carries the search out."""
    database = Database.open(url)
    campaign = submit(database, optimizer={"kind": "random", "population": 50, "iterations": ITERATIONS, "seed": 2})
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto(f"{api.url}/#/campaigns/{campaign.id}")
    expect(page.get_by_text("Waiting for its turn.").first).to_be_visible()
    working = dispatcher(database, ComputedBackend())
    longest = 0.0
    for iteration in range(2, ITERATIONS + 1):
        while iterations(database, campaign) < iteration:
            working.step()
        began = time.perf_counter()
        page.wait_for_function(DRAWN, arg=iteration)
        longest = max(longest, time.perf_counter() - began)
        page.wait_for_timeout(97 * iteration % 500)  # the server looks at any moment between two iterations
    page.close()
    database.dispose()
    return longest


def iterations(database: Database, campaign: StoredCampaign) -> int:
    """The stored iterations of a campaign."""
    with database.read() as connection:
        return len(generations.page(connection, campaign.sequence, limit=ITERATIONS)[0])


def brushed(page: Page) -> float:
    """The longest frame, milliseconds, while ranges are drawn along two axes and taken away again. Finding the button is no part of it:
    the search computes roles and names of the page's elements with the page's own time."""
    axes = [page.get_by_role("slider", name=re.compile(rf"Range of P{number}\b")) for number in (1, 8)]
    boxes = [axis.bounding_box() for axis in axes]
    page.evaluate(WATCH)
    for box in boxes:
        assert box is not None
        x, top, height = box["x"] + box["width"] / 2, box["y"] + 10, box["height"] - 20
        page.mouse.move(x, top)
        page.mouse.down()
        for step in range(1, STEPS + 1):
            page.mouse.move(x, top + 0.6 * height * step / STEPS)
        page.mouse.up()
    page.wait_for_timeout(300)
    drawn = float(page.evaluate(LONGEST))
    button = present(page.get_by_role("button", name="Show all again").bounding_box())
    page.evaluate(WATCH)
    page.mouse.click(button["x"] + button["width"] / 2, button["y"] + button["height"] / 2)
    page.wait_for_timeout(300)
    return max(drawn, float(page.evaluate(LONGEST)))


def scrolled(page: Page) -> float:
    """The longest frame, milliseconds, while the table is scrolled, from its begin and to its end at last."""
    grid = page.get_by_role("grid")
    grid.evaluate("grid => grid.scrollTo(0, 0)")
    grid.scroll_into_view_if_needed()
    grid.hover()
    grid.focus()
    page.evaluate(WATCH)
    for _ in range(STEPS):
        page.mouse.wheel(0, 400)
        page.wait_for_timeout(16)
    page.keyboard.press("End")
    page.wait_for_timeout(300)
    return float(page.evaluate(LONGEST))


def measure_front(browser: Browser, api: ApiProcess, campaign: StoredCampaign) -> dict[str, float]:
    """The longest frames, milliseconds, of the view Front by what is done there."""
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(120_000)
    page.goto(f"{api.url}/#/campaigns/{campaign.id}/front")
    sets = f"{campaign.cells.requested // 2:,}"
    expect(page.get_by_text(f"Showing {sets} of {sets} sets")).to_be_visible(timeout=120_000)
    page.wait_for_timeout(1000)
    places = {
        "slider": page.get_by_role("slider", name=f"Weight of {OBJECTIVES[0]}"),
        "axis": page.get_by_role("slider", name=re.compile(r"Range of P1\b")),
        "scatter": page.get_by_role("slider", name=re.compile("^Set in view")),
    }
    return {name: min(drawn_over(page, place, upright=name == "axis") for _ in range(TRIES)) for name, place in places.items()}


def drawn_over(page: Page, place: Locator, *, upright: bool) -> float:
    """The longest frame, milliseconds, while the pointer is drawn over an element, along it and back."""
    place.scroll_into_view_if_needed()
    box = present(place.bounding_box())
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.evaluate(WATCH)
    page.mouse.down()
    for step in range(1, 2 * STEPS + 1):
        share = 0.4 * (1 - abs(step / STEPS - 1)) + 0.001
        page.mouse.move(x + (0 if upright else share * box["width"]), y + (share * box["height"] if upright else 0))
        page.wait_for_timeout(16)
    page.mouse.up()
    page.wait_for_timeout(300)
    longest = float(page.evaluate(LONGEST))
    if (cleared := page.get_by_role("button", name="Show all again")).count():
        cleared.click()
    return longest


def show(figures: dict[str, dict[str, float]]) -> None:
    """Prints a column for each size."""
    print(f"{'':34}" + "".join(f"{int(size):>12,}" for size in figures))
    for name in next(iter(figures.values())):
        print(f"{name.replace('_', ' '):34}" + "".join(f"{found[name]:12.2f}" for found in figures.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
