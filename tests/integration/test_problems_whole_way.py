"""Problems of users' own, the whole way: pushed, calibrated on real workers, killed, resumed, and rated anew under another score."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support.serve import Server, serving, until
from tests.support.user_problems import SPEC, ZDT1, ZDT1_LARGEST, ZDT1_MODEL, ZDT1_SPEC, of_python, problem, rows

from drivecal.client import Client

pytestmark = pytest.mark.slow
FEW = SPEC | {"optimizer": SPEC["optimizer"] | {"population": 12}}
"""Enough where a campaign need not be in its middle when something happens to it."""


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of a user, whose servers trust the commands of this process."""
    folder = tmp_path_factory.mktemp("user")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DRIVECAL_HOME", str(folder / "home"))
        yield folder


@pytest.fixture(scope="module")  # the last test kills it
def server(home: Path) -> Iterator[Server]:
    with started(home, "ray") as running:
        yield running


def started(folder: Path, backend: str) -> AbstractContextManager[Server]:
    return serving(folder, workers=2, DRIVECAL_BUNDLE_CACHE=str(folder / "cache"), DRIVECAL_BACKEND=backend)


@pytest.mark.parametrize("name", ["acc-process", "command-shell", "python-function", "fmu", "acc-highway"])
def test_an_example_is_calibrated_and_rated_anew_without_a_simulation(name: str, server: Server, tmp_path: Path) -> None:
    folder = problem(name, tmp_path)
    with Client(server.url) as client:
        pushed = client.push_problem(folder)
        first = client.wait(client.submit({**FEW, "problem": name}).id)
        assert (first.state, first.error, first.cells.failed) == ("succeeded", None, 0)
        assert first.spec["problem"] == pushed.digest
        assert first.cells.simulated > 25
        assert first.best is not None
        manifest = yaml.safe_load((folder / "problem.yaml").read_text())
        assert set(first.best.parameters) == set(manifest["parameters"])

        manifest["scores"] = {
            "anew": {"formula": f"2*{next(iter(manifest['measures']))}", "direction": "minimise", "range": [0, 50]}
        }
        (folder / "problem.yaml").write_text(yaml.safe_dump(manifest, sort_keys=False))
        again = client.push_problem(folder)
        assert again.digest != pushed.digest
        sets = [row.parameters for row in client.solutions(first.id, limit=10).items]
        rated = client.wait(
            client.submit({**FEW, "problem": name, "optimizer": {**FEW["optimizer"], "iterations": 1, "start_sets": sets}}).id
        )
        assert rated.spec["problem"] == again.digest
        assert rated.cells.repeated >= len(sets) * len(manifest["scenarios"])

        (folder / "extra.txt").write_text("one byte more")
        client.push_problem(folder)
        other = client.wait(client.submit({**FEW, "problem": name, "optimizer": {**FEW["optimizer"], "iterations": 1}}).id)
        assert other.cells.repeated == 0


def test_an_upgrade_of_a_tool_outside_of_the_files_reuses_nothing(server: Server, tmp_path: Path) -> None:
    folder, version = problem("python-function", tmp_path), tmp_path / "version"
    manifest = yaml.safe_load((folder / "problem.yaml").read_text())
    manifest["problem"], manifest["simulator"]["probe"] = "probed", ["cat", str(version)]
    (folder / "problem.yaml").write_text(yaml.safe_dump(manifest, sort_keys=False))
    spec = {**FEW, "problem": "probed", "optimizer": {**FEW["optimizer"], "iterations": 1}}
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


SECONDS = 0.4
SLEEPING_MODEL = (
    f"import time\n\ndef evaluate(parameters, scenario):\n    time.sleep({SECONDS})\n    return {{'y': parameters['x']}}\n"
)
SLEEPING: dict[str, Any] = {
    "problem": "sleeping",
    "parameters": {"x": {"lower": 0, "upper": 1, "step": 0.1}},
    "simulator": {"kind": "python", "file": "model.py", "function": "evaluate", "timeout": 60, "deterministic": True},
    "scenarios": {"city": {}},
    "measures": {"y": "1"},
    "scores": {"cost": {"formula": "y", "direction": "minimise", "range": [0, 1]}},
}
"""A simulator that mostly waits, as one of 90 s does, scaled down: real children, real clocks."""


def test_cpu_time_wall_time_and_savings_of_a_simulator_that_sleeps(server: Server, tmp_path: Path) -> None:
    spec = SPEC | {"problem": "sleeping", "optimizer": {"kind": "random", "population": 8, "iterations": 1, "seed": 1}}
    with Client(server.url) as client:
        client.push_problem(of_python(SLEEPING, SLEEPING_MODEL, tmp_path))
        first, again = (client.wait(client.submit(spec).id) for _ in range(2))
        accounts = [client.accounting(campaign.id) for campaign in (first, again)]
    assert (first.state, first.cells.failed, first.cells.repeated) == ("succeeded", 0, 0)
    assert (again.cells.simulated, again.cells.repeated) == (0, first.cells.simulated)
    waited = SECONDS * first.cells.simulated
    assert first.seconds.simulating < 0.25 * waited, "CPU time"
    assert first.seconds.wall >= waited / 2, "two workers"
    assert [account.clock for account in accounts] == ["wall", "wall"]
    assert accounts[0].simulated_seconds == pytest.approx(waited, rel=0.5)
    assert accounts[1].repeated_saved_seconds == pytest.approx(waited, rel=0.5)


def simulates(client: Client, campaign: str) -> bool:
    """Whether a campaign is in the middle of its search."""
    return client.campaign(campaign).cells.simulated > 30


def test_a_killed_server_resumes_searches_to_the_same_results(server: Server, home: Path, tmp_path: Path) -> None:
    """Of one score, and of two with the front of an uninterrupted search. The next server has workers without Ray."""
    specs = {
        "acc-highway": {**SPEC, "optimizer": {**SPEC["optimizer"], "seed": 4}, "reduction": {"mode": "off"}},
        "zdt1": ZDT1_SPEC,
        "python-function": {**SPEC, "optimizer": {**SPEC["optimizer"], "seed": 4}, "reduction": {"mode": "off"}},
    }
    expected, begun = {}, {}
    with Client(server.url) as client:
        for name, spec in specs.items():
            client.push_problem(of_python(ZDT1, ZDT1_MODEL, tmp_path) if name == "zdt1" else problem(name, tmp_path))
            ended = client.wait(client.submit({**spec, "problem": name}).id)
            assert (ended.state, ended.error) == ("succeeded", None)
            expected[name] = ended.best, rows(client, ended.id)
            if name == "zdt1":
                front = client.front(ended.id), client.front_summary(ended.id)
                assert 0.93 * ZDT1_LARGEST < (front[1].hypervolume or 0) <= ZDT1_LARGEST
        for name, spec in specs.items():  # the slowest first, so that they are in their middle together
            begun[name] = client.submit({**spec, "problem": name}).id
            until(partial(simulates, client, begun[name]), "some cells are simulated")
    family = server.family()
    server.process.kill()
    for process in family:
        process.kill()
    server.process.wait()
    with started(home, "processes") as resumed, Client(resumed.url) as client:
        for name, campaign in begun.items():
            ended = client.wait(campaign)
            assert ended.state == "succeeded"
            assert (ended.best, rows(client, campaign)) == expected[name]
        assert (client.front(begun["zdt1"]), client.front_summary(begun["zdt1"])) == front
