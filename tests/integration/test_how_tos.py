"""README and how-tos as a reader follows them: each block of commands is typed, on a real server, or stands in `ELSEWHERE`."""

import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import chdir
from functools import cache
from pathlib import Path
from unittest.mock import patch

import pytest
from tests.support.command import command
from tests.support.documentation import DOCS, Block, blocks
from tests.support.serve import Server, serving
from tests.support.tree import PROJECT

from drivecal.client import Client

HOW_TOS = DOCS / "pages" / "how-to"
ELSEWHERE = {
    "README.md make demo": "test_demo.py, and the Makefile",
    "README.md uvx --from": "test_packages.py installs; test_tutorials.py submits this file",
    "backup.md docker compose": "tests/compose",
    "calibration-data.md drivecal parameters": "test_calibration_files.py, on files of its own",
    "cluster.md ": "tests/compose",
    "fmu.md drivecal problem": "test_fmu.py, on FMUs that it makes",
    "install.md ": "test_packages.py",
    "machines.md ": "tests/compose, but for Docker Swarm",
    "plug-ins.md ": "tests/compose, test_example_packages.py",
    "second-cluster.md ": "tests/compose",
    "sensitivity.md ": "test_influence_cli.py: the printed analysis takes 18,730 cells",
    "studies.md ": "test_studies_cli.py, with smaller studies",
    "tokens.md ": "test_api_tokens.py, test_serve.py",
    "upgrade.md ": "test_database_cli.py, tests/compose; no release to upgrade from",
    "without-docker.md ": "test_ray_backend.py, tests/compose",
}
"""Blocks that are not typed here, by page and first words, with the tests that run what they show."""


def shell_blocks(page: Path) -> list[Block]:
    """The blocks of a page that are commands."""
    return [block for block in blocks(page) if block.language == "sh"]


def is_elsewhere(block: Block) -> bool:
    return any(f"{block.page.name} {block.text}".startswith(beginning) for beginning in ELSEWHERE)


TYPED = [
    page
    for page in [PROJECT / "README.md", *sorted(HOW_TOS.glob("*.md"))]
    if any(not is_elsewhere(block) for block in shell_blocks(page))
]


def cut(text: str) -> str:
    """A file with a fifth of a large budget: the commands do the same on a shorter campaign."""
    return re.sub(r"(?<=simulations: )[2-9]\d\d\b", lambda match: str(int(match[0]) // 5), text)


class Reader:
    """A user with a shell in a copy of the project's folder."""

    def __init__(self, server: Server, folder: Path) -> None:
        self.server, self.folder = server, folder
        self.campaign = ""
        shutil.copytree(PROJECT / "deploy" / "examples", folder / "deploy" / "examples")
        for file in (folder / "deploy" / "examples").glob("*.yaml"):
            file.write_text(cut(file.read_text()))

    def follow(self, page: Path, *titles: str) -> None:
        """Writes the files that a page shows, and types its commands; with `titles` only writes these files."""
        for block in blocks(page):
            if block.title and not block.title.startswith("deploy/") and (not titles or block.title in titles):
                (self.folder / block.title).parent.mkdir(exist_ok=True)
                (self.folder / block.title).write_text(cut(block.text))
            elif block.language == "sh" and not titles and not is_elsewhere(block):
                for line in block.text.replace("\\\n", " ").splitlines():  # continued lines are one
                    if not line.startswith("drivecal serve"):
                        self.type(line)

    def type(self, line: str) -> None:
        """Types a command. ID, CELL and TAG belong to the chosen campaign, or to the newest."""
        if re.search(r"\b(ID|CELL|TAG)\b", line):
            line = self.with_names(line)
        line = line.replace("localhost:8000", self.server.url.removeprefix("http://")).replace("curl -s", "curl -sf")
        names = {"DRIVECAL_HOME": str(self.server.folder / "home"), "DRIVECAL_URL": self.server.url}
        if line.startswith(("drivecal db restore", "drivecal db upgrade")):  # the server is stopped: another database
            names["DRIVECAL_HOME"] = str(self.folder / "restored")
        with chdir(self.folder), patch.dict(os.environ, names):
            if line.startswith("drivecal "):
                result = command(*shlex.split(re.sub(r"\s#.*", "", line))[1:])
                assert result.exit_code == 0, (line, result.output, result.stderr)
            else:
                subprocess.run(["bash", "-c", line], check=True, stdout=subprocess.DEVNULL)

    def with_names(self, line: str) -> str:
        with Client(self.server.url) as client:
            newest = client.campaign(self.campaign or client.campaigns(limit=1).items[0].id)
            if "CELL" in line or line.startswith("drivecal delete"):
                client.wait(newest.id)
            cell = str(client.evaluations(newest.id).to_arrow()["id"][0].as_py()) if "CELL" in line else ""
        tag = newest.tags[0] if newest.tags else ""
        return re.sub(r"\b(ID|CELL|TAG)\b", lambda match: {"ID": newest.id, "CELL": cell, "TAG": tag}[match[0]], line)


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Reader]:
    """A reader who has followed the tutorial, with the score `duration` from the start."""
    folder = tmp_path_factory.mktemp("server")
    with serving(folder, workers=2, DRIVECAL_BACKEND="processes", DRIVECAL_BUNDLE_CACHE=str(folder / "cache")) as server:
        reader = Reader(server, folder / "reader")
        reader.follow(
            DOCS / "pages" / "tutorials" / "own-simulation.md", "my-brake/model.py", "my-brake/problem.yaml", "brake.yaml"
        )
        with (reader.folder / "my-brake" / "problem.yaml").open("a") as manifest:
            manifest.write("  duration: {formula: time_s, direction: minimise, range: [0, 20], failed: 60}\n")
        reader.type("drivecal problem push my-brake")
        reader.follow(PROJECT / "README.md", "my-stop/brake.py", "my-stop/problem.yaml")
        reader.type("drivecal problem push my-stop")
        yield reader


@pytest.fixture(scope="module")
def campaign_of(reader: Reader) -> Callable[[str], str]:
    """Returns the id of a campaign that a page presumes, with or without a front, made when it is first asked for."""

    @cache
    def made(presumed: str) -> str:
        reader.campaign = ""
        if presumed == "a front":
            reader.follow(HOW_TOS / "objectives.md")
        else:
            (reader.folder / "presumed.yaml").write_text("{problem: my-brake, budget: {simulations: 60}}")
            reader.type("drivecal submit presumed.yaml --wait")
        with Client(reader.server.url) as client:
            return client.campaigns(limit=1).items[0].id

    return made


PRESUME = dict.fromkeys(["calibration-data.md", "front.md"], "a front") | dict.fromkeys(
    ["check.md", "failures.md", "scores.md"], "a best set"
)
"""Pages that begin with the id of a campaign, and what it has."""


@pytest.mark.slow
@pytest.mark.parametrize("page", TYPED, ids=lambda page: page.stem)
def test_the_commands_of_a_page_work_as_they_are_written(page: Path, reader: Reader, campaign_of: Callable[[str], str]) -> None:
    (reader.folder / "labels.yaml").write_text("P1: ACC_tGap_C\n")
    reader.campaign = campaign_of(PRESUME[page.name]) if page.name in PRESUME else ""
    reader.follow(page)


def test_every_block_of_commands_is_typed_or_run_elsewhere() -> None:
    shown = [block for page in [PROJECT / "README.md", *HOW_TOS.glob("*.md")] for block in shell_blocks(page)]
    unused = {start for start in ELSEWHERE if not any(f"{block.page.name} {block.text}".startswith(start) for block in shown)}
    assert unused == set()
    assert len(TYPED) > 18
