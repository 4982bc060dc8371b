"""The unit tests of the page's own sources, where what runs them is there."""

from __future__ import annotations

import subprocess

import pytest
from tests.support.web import WEB, hook


@pytest.mark.slow
def test_the_pure_parts_of_the_page_do_what_their_tests_say() -> None:
    if not (WEB / "node_modules" / "vitest").is_dir():
        pytest.skip("vitest is not there: `make test` could not fetch it")
    module = hook()
    node, npm = module._node()
    command = [*npm, "run", "--silent", "test"]
    ran = subprocess.run(command, cwd=WEB, env=module._environment(node), capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
