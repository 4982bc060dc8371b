"""Problems of users' own, the whole way: pushed, calibrated on real workers, killed, resumed, and rated anew under another score."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

import pytest
import yaml
from tests.support.serve import Server, serving, until
from tests.support.user_problems import SPEC, problem, rows

from drivecal.client import Client

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of a user, whose servers trust the commands of this process."""
    folder = tmp_path_factory.mktemp("user")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DRIVECAL_HOME", str(folder / "home"))
        yield folder


@pytest.fixture(scope="module")  # the last test kills it
def server(home: Path) -> Iterator[Server]:
    with started(home) as running:
        yield running


def started(folder: Path) -> AbstractContextManager[Server]:
    return serving(folder, workers=2, DRIVECAL_BUNDLE_CACHE=str(folder / "cache"))


@pytest.mark.parametrize("name", ["acc-process", "command-shell", "python-function", "fmu", "acc-highway"])
def test_an_example_is_calibrated_and_rated_anew_without_a_simulation(name: str, server: Server, tmp_path: Path) -> None:
    folder = problem(name, tmp_path)
    with Client(server.url) as client:
        pushed = client.push_problem(folder)
        first = client.wait(client.submit({**SPEC, "problem": name}).id)
        assert (first.state, first.error, first.cells.failed) == ("succeeded", None, 0)
        assert first.spec["problem"] == pushed.digest
        assert first.cells.simulated > 50
        assert first.best is not None
        manifest = yaml.safe_load((folder / "problem.yaml").read_text())
        assert set(first.best.parameters) == set(manifest["parameters"])

        manifest["scores"] = {
            "anew": {"formula": f"2*{next(iter(manifest['measures']))}", "direction": "minimise", "range": [0, 50]}
        }
        (folder / "problem.yaml").write_text(yaml.safe_dump(manifest, sort_keys=False))
        again = client.push_problem(folder)
        assert again.digest != pushed.digest
        sets = [row.parameters for row in client.solutions(first.id, limit=20).items]
        rated = client.wait(
            client.submit({**SPEC, "problem": name, "optimizer": {**SPEC["optimizer"], "iterations": 1, "start_sets": sets}}).id
        )
        assert rated.spec["problem"] == again.digest
        assert rated.cells.repeated >= len(sets) * len(manifest["scenarios"])

        (folder / "extra.txt").write_text("one byte more")
        client.push_problem(folder)
        other = client.wait(client.submit({**SPEC, "problem": name, "optimizer": {**SPEC["optimizer"], "iterations": 1}}).id)
        assert other.cells.repeated == 0


def test_an_upgrade_of_a_tool_outside_of_the_files_reuses_nothing(server: Server, tmp_path: Path) -> None:
    folder, version = problem("python-function", tmp_path), tmp_path / "version"
    manifest = yaml.safe_load((folder / "problem.yaml").read_text())
    manifest["problem"], manifest["simulator"]["probe"] = "probed", ["cat", str(version)]
    (folder / "problem.yaml").write_text(yaml.safe_dump(manifest, sort_keys=False))
    spec = {**SPEC, "problem": "probed", "optimizer": {**SPEC["optimizer"], "iterations": 1}}
    simulated = []
    with Client(server.url) as client:
        client.push_problem(folder)
        for number in ("1.0", "1.0", "2.0", "1.0"):
            version.write_text(f"mysim {number}\n")
            ended = client.wait(client.submit(spec).id)
            assert (ended.state, ended.error) == ("succeeded", None)
            assert any(f"mysim {number}" in note for note in ended.notes)
            simulated.append(ended.cells.simulated)
    assert simulated[0] == simulated[2] > 0
    assert simulated[1] == simulated[3] == 0


def simulates(client: Client, campaign: str) -> bool:
    """Whether a campaign is in the middle of its search."""
    return client.campaign(campaign).cells.simulated > 30


def test_a_killed_server_resumes_problems_to_the_same_results(server: Server, home: Path, tmp_path: Path) -> None:
    expected, begun = {}, {}
    with Client(server.url) as client:
        for name in ("python-function", "acc-highway"):
            client.push_problem(problem(name, tmp_path))
            spec = {**SPEC, "problem": name, "optimizer": {**SPEC["optimizer"], "seed": 4}, "reduction": {"mode": "off"}}
            ended = client.wait(client.submit(spec).id)
            expected[name] = ended.best, rows(client, ended.id)
            begun[name] = client.submit(spec).id
            until(partial(simulates, client, begun[name]), "some cells are simulated")
    family = server.family()
    server.process.kill()
    for process in family:
        process.kill()
    server.process.wait()
    with started(home) as resumed, Client(resumed.url) as client:
        for name, campaign in begun.items():
            ended = client.wait(campaign)
            assert ended.state == "succeeded"
            assert (ended.best, rows(client, campaign)) == expected[name]
