"""The tutorials as a reader follows them: their files, their commands in their order, on a real server with real simulations."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.support.command import command
from tests.support.documentation import DOCS, blocks
from tests.support.serve import Server, serving

from drivecal.client import Client

pytestmark = pytest.mark.slow
PUSH = "drivecal problem push"
TUTORIALS = sorted((DOCS / "pages" / "tutorials").glob("*.md"))


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    """A server, and commands of its user in an empty folder."""
    with serving(tmp_path, workers=2, DRIVECAL_BACKEND="processes", DRIVECAL_BUNDLE_CACHE=str(tmp_path / "cache")) as running:
        monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))
        monkeypatch.setenv("DRIVECAL_URL", running.url)
        (tmp_path / "reader").mkdir()
        monkeypatch.chdir(tmp_path / "reader")
        yield running


def typed(line: str, server: Server) -> None:
    """Runs a line of a tutorial; ID and ID2 are the newest campaign, CELL is its first cell."""
    words = shlex.split(line, comments=True)
    assert words[0] == "drivecal", line
    if {"ID", "ID2"} & set(words):
        with Client(server.url) as client:
            newest = client.campaigns(limit=1).items[0]
            cell = client.evaluations(newest.id).to_pandas()["id"].iloc[0]
        assert newest.state == "succeeded", newest.error
        names = {"ID": newest.id[:8], "ID2": newest.id[:8], "CELL": str(cell)}
        words = [names.get(word, word) for word in words]
    result = command(*words[1:])
    assert result.exit_code == 0, (line, result.output, result.stderr)


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_works_as_it_is_written(page: Path, server: Server) -> None:
    lines: list[str] = []
    edits = [("4*peak", "8*peak"), ("", "  duration: {formula: time_s, direction: minimise, range: [0, 20], failed: 60}\n")]
    for block in blocks(page):
        if block.title:
            Path(block.title).write_text(block.text)
        elif block.language == "sh":
            for line in block.text.splitlines():
                if line.startswith(PUSH) and any(
                    earlier.startswith(PUSH) for earlier in lines
                ):  # the reader has edited the scores
                    manifest = Path(line.split()[3]) / "problem.yaml"
                    before, after = edits.pop(0)
                    text = manifest.read_text()
                    assert before in text
                    manifest.write_text(text.replace(before, after) if before else text + after)
                if not line.startswith("drivecal serve"):  # it runs already
                    typed(line, server)
                lines.append(line)
    assert len(lines) > 5
    with Client(server.url) as client:
        campaigns = client.campaigns(limit=10).items
    assert {campaign.state for campaign in campaigns} == {"succeeded"}
    assert len(campaigns) > 1
    assert [campaign.rerun_of for campaign in campaigns] == [*(campaign.id for campaign in campaigns[1:]), None]
    assert campaigns[0].best is not None
