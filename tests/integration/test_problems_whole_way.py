"""Problems of users' own, the whole way: pushed, calibrated on real workers, killed, resumed, and rated anew under another score."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support.serve import Server, serving, until
from tests.support.user_problems import SPEC, problem, rows

from drivecal.client import Client

OPTIMIZER: dict[str, Any] = {"kind": "genetic", "population": 8, "iterations": 12, "seed": 4}
"""Few cells and many iterations, so that a kill hits the middle."""
FORMULA = "2*{0} + 1"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of a user, whose servers trust the commands of this process."""
    folder = tmp_path_factory.mktemp("user")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DRIVECAL_HOME", str(folder / "home"))
        yield folder


class Machine:
    """A user's machine, on which the server runs with its workers until it is killed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.server = self._started()

    def _started(self) -> Server:
        cache = str(self._folder / "cache")
        return Server(self._folder, workers=2, DRIVECAL_BACKEND="processes", DRIVECAL_BUNDLE_CACHE=cache)

    def client(self) -> Client:
        return Client(self.server.url)

    def kill(self) -> None:
        """Ends the server and everything it started by SIGKILL."""
        family = self.server.family()
        self.server.process.kill()
        for process in family:
            process.kill()
        self.server.process.wait()

    def restart(self) -> None:
        self.server = self._started()

    def stored_state(self, campaign: str) -> str:
        """State of a campaign in the database, whether the server runs or not."""
        with sqlite3.connect(self._folder / "home" / "drivecal.db") as connection:
            [state] = connection.execute("SELECT state FROM campaigns WHERE id = ?", (campaign,)).fetchone()
        return str(state)


@pytest.fixture(scope="module")
def machine(home: Path) -> Iterator[Machine]:
    machine = Machine(home)
    yield machine
    machine.kill()


def rewritten(folder: Path, **changes: Any) -> dict[str, Any]:
    """Changes the manifest of a problem; returns it."""
    manifest: dict[str, Any] = yaml.safe_load((folder / "problem.yaml").read_text()) | changes
    (folder / "problem.yaml").write_text(yaml.safe_dump(manifest, sort_keys=False))
    return manifest


@pytest.mark.parametrize("name", ["acc-process", "command-shell", "python-function", "fmu", "acc-highway"])
def test_an_example_is_killed_resumed_and_rated_anew(name: str, machine: Machine, tmp_path: Path) -> None:
    folder = problem(name, tmp_path)
    manifest = rewritten(folder)
    spec = {**SPEC, "problem": name, "optimizer": OPTIMIZER, "reduction": {"mode": "off"}}
    with machine.client() as client:
        pushed = client.push_problem(folder)
        whole = client.wait(client.submit(spec).id)
        assert (whole.state, whole.error, whole.cells.failed) == ("succeeded", None, 0)
        assert whole.best is not None
        assert set(whole.best.parameters) == set(manifest["parameters"])
        begun = client.submit(spec).id
        until(lambda: (client.campaign(begun).iteration or 0) >= 2, "a third iteration")
    machine.kill()
    assert machine.stored_state(begun) == "running"
    machine.restart()

    measure = next(iter(manifest["measures"]))
    with machine.client() as client:
        resumed = client.wait(begun)
        assert (resumed.state, resumed.best, resumed.cells) == ("succeeded", whole.best, whole.cells)
        assert rows(client, begun) == rows(client, whole.id)

        anew = {"formula": FORMULA.format(measure), "direction": "minimise", "range": [0, 50], "failed": 99}
        rewritten(folder, scores={"anew": anew})
        again = client.push_problem(folder)
        assert again.digest != pushed.digest
        changes = {"problem": name, "weights": {}, "optimizer": OPTIMIZER | {"iterations": 1}, "reduction": {"mode": "exact"}}
        rated = client.wait(client.rerun(whole.id, changes | {"evaluator": "anew"}).id)
        assert rated.spec["problem"] == again.digest
        assert (rated.cells.simulated, rated.cells.repeated) == (0, OPTIMIZER["population"] * len(manifest["scenarios"]))
        before = by_cell(client, whole.id)
        for cell, row in by_cell(client, rated.id).items():
            assert row[f"measure_{measure}"] == before[cell][f"measure_{measure}"]
            assert row["score"] == (2 * row[f"measure_{measure}"] + 1 if row["failure"] is None else 99)

        (folder / "extra.txt").write_text("one byte more")
        client.push_problem(folder)
        other = client.wait(client.rerun(whole.id, changes | {"evaluator": "anew"}).id)
        assert (other.cells.repeated, other.cells.simulated) == (0, rated.cells.repeated)


def by_cell(client: Client, campaign: str) -> dict[tuple[int, str], dict[str, Any]]:
    """The first generation of a campaign with its measures, by individual and scenario."""
    table = client.evaluations(campaign, measures="true", where=["iteration=0"]).to_arrow().to_pylist()
    return {(row["individual"], row["scenario"]): row for row in table}


def test_an_upgrade_of_a_tool_outside_of_the_files_reuses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On workers of Ray."""
    monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))
    folder, version = problem("python-function", tmp_path), tmp_path / "version"
    manifest = yaml.safe_load((folder / "problem.yaml").read_text())
    manifest["problem"], manifest["simulator"]["probe"] = "probed", ["cat", str(version)]
    (folder / "problem.yaml").write_text(yaml.safe_dump(manifest, sort_keys=False))
    spec = {**SPEC, "problem": "probed", "optimizer": {**SPEC["optimizer"], "iterations": 1}}
    simulated = []
    cache = str(tmp_path / "cache")
    with (
        serving(tmp_path, workers=2, DRIVECAL_BACKEND="ray", DRIVECAL_BUNDLE_CACHE=cache) as server,
        Client(server.url) as client,
    ):
        client.push_problem(folder)
        for number in ("1.0", "1.0", "2.0", "1.0"):
            version.write_text(f"mysim {number}\n")
            ended = client.wait(client.submit(spec).id)
            assert (ended.state, ended.error) == ("succeeded", None)
            assert any(f"mysim {number}" in note for note in ended.notes)
            simulated.append(ended.cells.simulated)
    assert simulated[0] == simulated[2] > 0
    assert simulated[1] == simulated[3] == 0
