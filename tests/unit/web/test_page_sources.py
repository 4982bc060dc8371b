"""The unit tests of the page's own sources, where what runs them is there."""

import re
import subprocess

import pytest
from tests.support.tree import PROJECT
from tests.support.web import WEB, hook


def test_the_pure_parts_of_the_page_do_what_their_tests_say() -> None:
    if not (WEB / "node_modules" / "vitest").is_dir():
        pytest.skip("vitest is not there: `make test` could not fetch it")
    module = hook()
    node, npm = module._node()
    command = [*npm, "run", "--silent", "test"]
    ran = subprocess.run(command, cwd=WEB, env=module._environment(node), capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr


def test_every_word_that_the_page_explains_is_in_the_glossary() -> None:
    headings = re.findall(r"^## (.+)$", (PROJECT / "docs/pages/concepts/glossary.md").read_text(), re.MULTILINE)
    anchors = {heading.lower().replace(" ", "-") for heading in headings}
    terms = set(re.findall(r'^  "?([\w-]+)"?: "', (WEB / "src/lib/text/terms.ts").read_text(), re.MULTILINE))
    assert len(terms) > 5
    assert terms - anchors == set()
