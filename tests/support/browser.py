"""The Chromium of the system, where one is installed."""

import shutil

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def chromium() -> str:
    """The command. Skips the test where there is none."""
    result = next(filter(None, map(shutil.which, NAMES)), None)
    if result is None:
        pytest.skip(f"no Chromium is installed (looked for {', '.join(NAMES)}); Debian: apt-get install chromium")
    return result
