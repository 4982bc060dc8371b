"""A problem on its way to a server and back: the command line, the client, and who may."""

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.support.command import command
from tests.support.server import RunningApi, serving

from drivecal.client import Client
from drivecal.configuration.problems import read_bundle
from drivecal.domain.errors import NotFoundError

EXAMPLE = Path(__file__).parents[2] / "deploy" / "examples" / "problems" / "python-function"


@pytest.fixture
def api(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[RunningApi]:
    """A server without tokens, and commands with its home folder."""
    monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}", home=str(tmp_path / "home")) as running:
        yield running


def test_a_problem_is_pushed_listed_and_shown(api: RunningApi) -> None:
    pushed = command("problem", "push", str(EXAMPLE), "--url", api.url, "--json")
    assert pushed.exit_code == 0, pushed.stderr
    answer = json.loads(pushed.stdout)
    assert (answer["name"], answer["latest"]) == ("python-function", True)
    again = command("problem", "push", str(EXAMPLE), "--url", api.url, "--json")
    assert json.loads(again.stdout) == answer
    listed = json.loads(command("problem", "list", "--url", api.url, "--json").stdout)
    assert listed["items"][0]["digest"] == answer["digest"]
    assert [item["name"] for item in listed["items"]] == ["python-function", "highway-random", "highway"]
    for name in ("python-function", answer["digest"]):
        assert json.loads(command("problem", "show", name, "--url", api.url, "--json").stdout) == answer
    shown = command("problem", "show", "python-function", "--url", api.url)
    assert {*answer["parameters"], *answer["scores"]} <= set(shown.stdout.split())
    table = command("problem", "list", "--name", "python-function", "--url", api.url)
    assert answer["digest"] in table.stdout
    assert command("problem", "show", "nothing", "--url", api.url).exit_code == 5


def test_a_push_names_what_it_replaces(api: RunningApi, tmp_path: Path) -> None:
    folder = tmp_path / "problem"
    shutil.copytree(EXAMPLE, folder)
    digests, said = [], []
    for description in ("first", "first", "second", "first"):
        manifest = re.sub(r"(?m)^description:.*$", f"description: {description}", (EXAMPLE / "problem.yaml").read_text())
        (folder / "problem.yaml").write_text(manifest)
        pushed = command("problem", "push", str(folder), "--url", api.url, "--json")
        digests.append(json.loads(pushed.stdout)["digest"][:12])
        said.append([digest for digest in dict.fromkeys(digests) if digest in pushed.stderr])
    first, second = digests[0], digests[2]
    assert said == [[first], [first], [first, second], [first, second]]
    (folder / "problem.yaml").write_text(f"{manifest}\nremoved: {{old: 1}}\n")
    (folder / "braking.py").write_text((EXAMPLE / "braking.py").read_text() + "\n")
    [note] = json.loads(command("problem", "push", str(folder), "--url", api.url, "--json").stdout)["notes"]
    assert note.startswith("braking.py")


def test_the_client_takes_a_folder_an_archive_and_its_bytes(api: RunningApi, tmp_path: Path) -> None:
    archive = read_bundle(EXAMPLE)[1]
    (tmp_path / "problem.zip").write_bytes(archive)
    with Client(api.url) as client:
        pushed = [client.push_problem(given) for given in (EXAMPLE, str(tmp_path / "problem.zip"), archive)]
        assert pushed[0] == pushed[1] == pushed[2] == client.problem("python-function")
        assert [item.name for item in client.problems().items] == ["python-function", "highway-random", "highway"]
        with pytest.raises(NotFoundError, check=lambda error: error.kind == "problem"):
            client.problem("nothing")
        with pytest.raises(NotFoundError, match="did you mean python-function"):
            client.problem("pyton-function")
