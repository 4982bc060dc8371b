"""Films the product for the README: a real campaign on a real server, its ranking under other weights, and a replay.

python docs/picture.py     # needs a Chromium; writes docs/pages/media/drivecal.webp
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from drivecal.client import Client

TARGET = Path(__file__).parent / "pages" / "media" / "drivecal.webp"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
VIEWPORT = {"width": 1100, "height": 700}
WIDTH = 880
QUALITY = 55
MIDDLE = {"P1": 0, "P2": 1, "P3": 100, "P4": 1000, "P5": 750, "P6": 0.5, "P7": 100, "P8": 1000, "P9": 5, "P10": 10, "P11": 100}
CAMPAIGN = {
    "name": "motorway comfort",
    "baseline": MIDDLE,
    "optimizer": {"kind": "genetic", "population": 150, "iterations": 15},
}
REPLAYED = "S2"

Frames = list[tuple[Image.Image, int]]
"""Images, and for how many milliseconds each is shown."""


@contextmanager
def server(home: Path) -> Iterator[str]:
    """Runs `drivecal serve` with an empty home folder and yields its address."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("DRIVECAL_")}
    process = subprocess.Popen(
        [sys.executable, "-m", "drivecal.cli", "serve", "--port", "0", "--json"],
        env=kept | {"DRIVECAL_HOME": str(home), "DRIVECAL_BACKEND": "processes"},
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        yield json.loads(process.stdout.readline())["url"]
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(60)


def shot(page: Page, frames: Frames, milliseconds: int) -> None:
    """Adds the page as it is; a frame that shows nothing new lasts longer instead."""
    image = Image.open(BytesIO(page.screenshot())).convert("RGB")
    image = image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
    if frames and frames[-1][0].tobytes() == image.tobytes():
        frames[-1] = (image, frames[-1][1] + milliseconds)
    else:
        frames.append((image, milliseconds))


def film(page: Page, url: str) -> Frames:
    """Returns the frames of the whole way."""
    frames: Frames = []
    with Client(url) as client:
        campaign = client.submit(CAMPAIGN)
        page.goto(f"{url}/#/campaigns/{campaign.id}")
        iteration = None
        while (now := client.campaign(campaign.id)).state not in {"succeeded", "failed"}:
            page.wait_for_timeout(500)
            if now.iteration != iteration:
                iteration = now.iteration
                shot(page, frames, 450)
        page.get_by_text("Finished.").wait_for()
        shot(page, frames, 2000)
        page.goto(f"{url}/#/campaigns/{campaign.id}/ranking?weights=S1=1")
        for weight in ("1", "2", "3"):
            page.get_by_role("slider", name="S5").fill(weight)
            page.wait_for_timeout(1200)
            shot(page, frames, 900)
        best = client.solutions(campaign.id, limit=1).items[0].individual
        cell = next(
            row["id"]
            for row in client.rows(campaign.id, "evaluations", where=f"scenario={REPLAYED}")
            if row["individual"] == best and row["score"] is not None
        )
    page.goto(f"{url}/#/evaluations/{cell}")
    page.get_by_role("img", name="Top view of the road").wait_for(timeout=60_000)
    slider = page.get_by_role("slider", name="Moment")
    for step in range(13):
        slider.fill(f"{0.8 * step:.1f}")
        page.wait_for_timeout(250)
        shot(page, frames, 300)
    return frames


def main() -> None:
    """Films and writes the picture."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        sys.exit(f"no Chromium is installed (looked for {', '.join(BROWSERS)})")
    with TemporaryDirectory() as home, server(Path(home)) as url, sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        frames = film(chromium.new_page(viewport=VIEWPORT), url)  # type: ignore[arg-type]  # a TypedDict of playwright's
        chromium.close()
    first, *others = (image for image, _ in frames)
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    durations = [milliseconds for _, milliseconds in frames]
    first.save(TARGET, save_all=True, append_images=others, duration=durations, loop=0, quality=QUALITY, method=6)
    print(f"{TARGET}: {len(frames)} frames, {sum(durations) / 1000:.0f} s, {TARGET.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main()
