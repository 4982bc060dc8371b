"""The tutorials as a reader follows them: their files, their commands in their order, on a real server with real simulations."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.support.command import command
from tests.support.documentation import DOCS, blocks
from tests.support.serve import Server, serving

from drivecal.client import Client

PUSH = "drivecal problem push"
VARYING = re.compile(r"[0-9a-f]{32}|0\.0\d\d")
TUTORIALS = sorted((DOCS / "pages" / "tutorials").glob("*.md"))


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """The server of all tutorials."""
    folder = tmp_path_factory.mktemp("server")
    with serving(folder, workers=2, DRIVECAL_BACKEND="processes", DRIVECAL_BUNDLE_CACHE=str(folder / "cache")) as running:
        yield running


@pytest.fixture
def server(running: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Server:
    """The server, with its user's commands in an empty folder."""
    monkeypatch.setenv("DRIVECAL_HOME", str(running.folder / "home"))
    monkeypatch.setenv("DRIVECAL_URL", running.url)
    monkeypatch.chdir(tmp_path)
    return running


def typed(line: str, server: Server) -> list[list[str]]:
    """Runs a line of a tutorial; ID and ID2 are the newest campaign, CELL is its first cell. Returns the words of each printed line."""
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
    return [printed.split() for printed in result.output.splitlines()]


def is_printed(shown: str, printed: list[list[str]]) -> bool:
    """Returns whether a page shows a printed line. A campaign's id, times and numbers of cells may differ."""

    def same(line: list[str]) -> list[str]:
        kept = [word for word in line if not VARYING.fullmatch(word)]
        return kept[:-1] if line[1:3] == ["failed", "run"] else kept  # with the number of a cell

    return not shown or same(shown.split()) in map(same, printed)


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_works_as_it_is_written(page: Path, server: Server) -> None:
    with Client(server.url) as client:
        earlier_pages = {campaign.id for campaign in client.campaigns(limit=100).items}
    lines: list[str] = []
    printed: list[list[str]] = []
    edits = [("4*peak", "8*peak"), ("", "  duration: {formula: time_s, direction: minimise, range: [0, 20], failed: 60}\n")]
    for block in blocks(page):
        if block.title:
            exact = "reduction: {mode: exact}\n" if block.title == "brake.yaml" else ""  # on a busy machine predictions may pay
            Path(block.title).write_text(block.text + exact)
        elif block.language == "sh":
            for line in block.text.splitlines():
                if line.startswith(PUSH) and any(earlier.startswith(PUSH) for earlier in lines):  # its scores are edited
                    manifest = Path(line.split()[3]) / "problem.yaml"
                    before, after = edits.pop(0)
                    text = manifest.read_text()
                    assert before in text
                    manifest.write_text(text.replace(before, after) if before else text + after)
                if not line.startswith("drivecal serve"):  # it runs already
                    printed += typed(line, server)
                lines.append(line)
        elif block.language == "text":
            assert [shown for shown in block.text.splitlines() if not is_printed(shown, printed)] == []
    assert len(lines) > 5
    with Client(server.url) as client:
        campaigns = [campaign for campaign in client.campaigns(limit=100).items if campaign.id not in earlier_pages]
    assert {campaign.state for campaign in campaigns} == {"succeeded"}
    assert len(campaigns) > 1
    assert [campaign.rerun_of for campaign in campaigns] == [*(campaign.id for campaign in campaigns[1:]), None]
    assert campaigns[0].best is not None
