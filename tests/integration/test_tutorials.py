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
    """Runs a line of a tutorial; ID is the newest campaign."""
    words = shlex.split(line, comments=True)
    assert words[0] == "drivecal", line
    if "ID" in words:
        with Client(server.url) as client:
            newest = client.campaigns(limit=1).items[0]
        assert newest.state == "succeeded", newest.error
        words = [newest.id[:8] if word == "ID" else word for word in words]
    result = command(*words[1:])
    assert result.exit_code == 0, (line, result.output, result.stderr)


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_works_as_it_is_written(page: Path, server: Server) -> None:
    lines: list[str] = []
    for block in blocks(page):
        if block.title:
            Path(block.title).write_text(block.text)
        elif block.language == "sh":
            for line in block.text.splitlines():
                if line.startswith("drivecal problem push") and line in lines:  # the reader has edited the formula
                    manifest = Path(line.split()[3]) / "problem.yaml"
                    edited = manifest.read_text().replace("4*peak", "8*peak")
                    assert edited != manifest.read_text()
                    manifest.write_text(edited)
                if not line.startswith("drivecal serve"):  # it runs already
                    typed(line, server)
                lines.append(line)
    assert len(lines) > 5
    with Client(server.url) as client:
        campaigns = client.campaigns(limit=10).items
    assert [campaign.state for campaign in campaigns] == ["succeeded", "succeeded"]
    assert campaigns[0].rerun_of == campaigns[1].id
    assert campaigns[0].best is not None
