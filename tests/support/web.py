"""The build hook of the page, which is no module of a package, and the system's Chromium. As a program it fetches what tests need."""

import json
import shutil
import sys
from types import ModuleType

import pytest
from tests.support.tree import PROJECT, loaded

WEB = PROJECT / "services" / "web"
CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def hook() -> ModuleType:
    """`services/web/build_hook.py`, loaded anew."""
    return loaded("build_hook", WEB / "build_hook.py")


def chromium() -> str:
    """The command. Skips the test where there is none."""
    result = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if result is None:
        pytest.skip(f"no Chromium is installed (looked for {', '.join(CHROMIUM)}); Debian: apt-get install chromium")
    return result


def fetch() -> None:
    """Fetches the libraries that check and test the page. Prints the reason if they cannot be fetched."""
    module = hook()
    wanted = json.loads((WEB / "package.json").read_text(encoding="utf-8"))["devDependencies"]
    if module._complete() and all((WEB / "node_modules" / name).is_dir() for name in wanted):
        return
    try:
        node, npm = module._node()
        module._run([*npm, *module.FETCHING], node, module.SECONDS_TO_FETCH, module.UNFETCHED)
    except (module.PageError, OSError) as error:
        print(f"the unit tests of the page are skipped: {error}", file=sys.stderr)


if __name__ == "__main__":
    fetch()
