"""Prints PyPI's advisories on the packages in deploy/requirements.lock, which include the packages of the images: `make audit`.

Exits with 1 if a weakness is known, else with 0. Also exits with 0 without a network, or without an answer within SECONDS.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "deploy" / "requirements.lock"
SECONDS = 300.0
"""For all packages together: a registry that does not answer must not hold up CI."""


def command() -> list[str]:
    """Returns the command that runs pip-audit, with the system's uv or else the uv of the installation."""
    uv = shutil.which("uv") or shutil.which("uv", path=Path(sys.executable).parent) or "uv"
    auditing = [
        "tool",
        "run",
        "--quiet",
        "--from",
        "pip-audit>=2.9,<3",
        "pip-audit",
        "--format",
        "json",
        "--progress-spinner",
        "off",
    ]
    return [uv, *auditing, "--require-hashes", "--disable-pip", "--requirement", str(LOCK)]


def asked(command: Sequence[str], seconds: float) -> list[dict[str, Any]]:
    """Returns pip-audit's answer for each package. Raises LookupError with the reason if there is none."""
    try:
        auditing = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
    except OSError as error:
        raise LookupError(f"{command[0]}: {error.strerror}") from None
    try:
        answer, messages = auditing.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        os.killpg(auditing.pid, signal.SIGKILL)  # uv does not pass signals on to what it runs
        auditing.communicate()
        raise LookupError(f"no answer within {seconds:g} s") from None
    try:
        packages: list[dict[str, Any]] = json.loads(answer)["dependencies"]
    except (ValueError, KeyError, TypeError):
        raise LookupError((messages.strip().splitlines() or ["no answer"])[-1].strip()) from None
    return packages


def report(packages: Sequence[dict[str, Any]]) -> tuple[list[str], bool]:
    """Returns the lines to print, and whether a weakness is known. Raises LookupError if PyPI knows no package."""
    known = [package for package in packages if "skip_reason" not in package]
    if not known:
        raise LookupError(f"the package index knows nothing of the {len(packages)} packages")
    lines = [
        f"{package['name']} {package['version']}: {', '.join([weakness['id'], *weakness['aliases']])};"
        f" mended in {', '.join(weakness['fix_versions']) or 'no release'}"
        for package in known
        for weakness in package["vulns"]
    ]
    unknown = [package["name"] for package in packages if "skip_reason" in package]
    rest = f"; nothing is known of {', '.join(unknown)}" if unknown else ""
    return [*lines, f"audit: {len(lines) or 'no'} known weaknesses in {len(known)} packages{rest}"], bool(lines)


def main() -> int:
    """Asks and prints."""
    try:
        lines, weak = report(asked(command(), SECONDS))
    except LookupError as reason:
        print(f"audit: nothing was learned about weaknesses: {reason}")
        return 0
    print("\n".join(lines))
    return int(weak)


if __name__ == "__main__":
    sys.exit(main())
