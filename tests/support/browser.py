"""Opens pages in a headless Chromium, where one is installed, and tells what a user's browser would complain about or ask for."""

import json
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--hide-scrollbars", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)  # fmt: skip
"""It is root in containers, where its sandbox does not start; its own questions to its maker are answered by nobody."""
OWN = "not an origin"
"""Who asks for what the browser itself wants."""


@dataclass(frozen=True)
class Opened:
    """`dom`: the page once it was loaded; `console`: what it wrote there, errors included; `requests`: addresses it asked for."""

    dom: str
    console: list[str]
    requests: list[str]


def chromium() -> str:
    """The command. Skips the test where there is none."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip(f"no Chromium is installed (looked for {', '.join(NAMES)}); Debian: apt-get install chromium")
    return found


def opened(page: Path, scratch: Path) -> Opened:
    """The page in a browser that has never been used; `scratch`: a folder for what it leaves."""
    log = scratch / "network.json"
    ran = _run(page, scratch, "--enable-logging=stderr", f"--log-net-log={log}", "--dump-dom")
    events = json.loads(log.read_text())
    started = events["constants"]["logEventTypes"]["URL_REQUEST_START_JOB"]
    asked = [event.get("params", {}) for event in events["events"] if event["type"] == started]
    requests = [one["url"] for one in asked if "url" in one and one.get("initiator") != OWN]
    return Opened(ran.stdout, re.findall(r":CONSOLE[^]]*\] (.*)", ran.stderr), requests)


def printed(page: Path, scratch: Path) -> bytes:
    """The page as a PDF."""
    target = scratch / "page.pdf"
    _run(page, scratch, "--no-pdf-header-footer", f"--print-to-pdf={target}")
    return target.read_bytes()


def _run(page: Path, scratch: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [chromium(), *QUIET, f"--user-data-dir={scratch / 'profile'}", *options, page.as_uri()]
    return subprocess.run(command, check=True, capture_output=True, text=True, timeout=120)
