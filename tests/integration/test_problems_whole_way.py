"""Problems of users' own, the whole way: pushed, calibrated on real workers, killed, resumed, and rated anew under another score."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
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
        assert first.cells.simulated > 100
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


@pytest.mark.parametrize("name", ["python-function", "acc-highway"])
def test_a_killed_server_resumes_a_problem_to_the_same_results(name: str, server: Server, home: Path, tmp_path: Path) -> None:
    folder = problem(name, tmp_path)
    spec = {**SPEC, "problem": name, "optimizer": {**SPEC["optimizer"], "seed": 4}, "reduction": {"mode": "off"}}
    with Client(server.url) as client:
        client.push_problem(folder)
        expected = client.wait(client.submit(spec).id)
        results = rows(client, expected.id)
        begun = client.submit(spec)
        until(lambda: client.campaign(begun.id).cells.simulated > 30, "some cells are simulated")
    family = server.family()
    server.process.kill()
    for process in family:
        process.kill()
    server.process.wait()
    with started(home) as resumed, Client(resumed.url) as client:
        ended = client.wait(begun.id)
        assert (ended.state, ended.best) == ("succeeded", expected.best)
        assert rows(client, begun.id) == results
