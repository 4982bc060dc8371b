"""Problems of users' own, the whole way: pushed, calibrated on real workers, killed, resumed, and rated anew under another score."""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import pytest
import yaml
from tests.support.runs import without_starts
from tests.support.serve import Server, serving, until
from tests.support.user_problems import SPEC, problem, rows

from drivecal.client import Client

OPTIMIZER: dict[str, Any] = {"kind": "genetic", "population": 8, "iterations": 6, "seed": 4}
"""Few cells and many iterations, so that a kill hits the middle."""
FORMULA = "2*{0} + 1"
EXAMPLES = ("acc-process", "command-shell", "python-function", "fmu", "acc-highway")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of a user, whose servers trust the commands of this process."""
    folder = tmp_path_factory.mktemp("user")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DRIVECAL_HOME", str(folder / "home"))
        yield folder


@dataclass(frozen=True)
class Example:
    """A problem that was calibrated twice: `whole` at a stretch, `resumed` on a server that was killed."""

    folder: Path
    digest: str
    whole: str
    resumed: str


@pytest.fixture(scope="module")
def calibrated(home: Path) -> Iterator[tuple[Client, dict[str, Example]]]:
    """The examples by name, calibrated side by side, and the server that knows them."""
    specs = {name: {**SPEC, "problem": name, "optimizer": OPTIMIZER, "reduction": {"mode": "off"}} for name in EXAMPLES}
    folders = {name: problem(name, home) for name in EXAMPLES}
    with started(home) as server, Client(server.url) as client:
        digests = {name: client.push_problem(folder).digest for name, folder in folders.items()}
        whole = {name: client.submit(spec).id for name, spec in specs.items()}
        for campaign in whole.values():
            client.wait(campaign)
        begun = {name: client.submit(spec).id for name, spec in specs.items()}
        until(
            lambda: all((client.campaign(campaign).iteration or 0) >= 1 for campaign in begun.values()),
            "two iterations of all",
            240,
        )
        family = server.family()
        server.process.kill()
        for process in family:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        server.process.wait()
    with started(home) as server, Client(server.url) as client:
        for campaign in begun.values():
            client.wait(campaign)
        yield client, {name: Example(folders[name], digests[name], whole[name], begun[name]) for name in EXAMPLES}


def started(home: Path) -> AbstractContextManager[Server]:
    return serving(home, workers=2, DRIVECAL_BACKEND="processes", DRIVECAL_BUNDLE_CACHE=str(home / "cache"))


def rewritten(folder: Path, **changes: Any) -> dict[str, Any]:
    """Changes the manifest of a problem; returns it."""
    manifest: dict[str, Any] = yaml.safe_load((folder / "problem.yaml").read_text()) | changes
    (folder / "problem.yaml").write_text(yaml.safe_dump(manifest, sort_keys=False))
    return manifest


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_killed_resumed_and_rated_anew(name: str, calibrated: tuple[Client, dict[str, Example]]) -> None:
    client, examples = calibrated
    example = examples[name]
    manifest = rewritten(example.folder)
    whole, resumed = client.campaign(example.whole), client.campaign(example.resumed)
    assert (whole.state, whole.error, whole.cells.failed) == ("succeeded", None, 0)
    assert whole.best is not None
    assert set(whole.best.parameters) == set(manifest["parameters"])
    assert (resumed.state, resumed.best) == ("succeeded", whole.best)
    assert without_starts(resumed.cells) == without_starts(whole.cells)
    assert rows(client, resumed.id) == rows(client, whole.id)

    measure = next(iter(manifest["measures"]))
    anew = {"formula": FORMULA.format(measure), "direction": "minimise", "range": [0, 50], "failed": 99}
    rewritten(example.folder, scores={"anew": anew})
    again = client.push_problem(example.folder)
    assert again.digest != example.digest
    changes = {"problem": name, "weights": {}, "optimizer": OPTIMIZER | {"iterations": 1}, "reduction": {"mode": "exact"}}
    rated = client.wait(client.rerun(whole.id, changes | {"evaluator": "anew"}).id)
    assert rated.spec["problem"] == again.digest
    assert (rated.cells.simulated, rated.cells.repeated) == (0, OPTIMIZER["population"] * len(manifest["scenarios"]))
    before = by_cell(client, whole.id, manifest["parameters"])  # the rerun begins with the best set of all iterations
    for cell, row in by_cell(client, rated.id, manifest["parameters"]).items():
        assert row[f"measure_{measure}"] == before[cell][f"measure_{measure}"]
        value = 2 * row[f"measure_{measure}"] + 1 if row["failure"] is None else 99
        assert row["score"] == min(value, 99), "nothing is worth less than a failed run"

    (example.folder / "extra.txt").write_text("one byte more")
    client.push_problem(example.folder)
    other = client.wait(client.rerun(whole.id, changes | {"evaluator": "anew"}).id)
    assert (other.cells.repeated, other.cells.simulated) == (0, rated.cells.repeated)


def by_cell(client: Client, campaign: str, names: Iterable[str]) -> dict[tuple[Any, ...], dict[str, Any]]:
    """The cells of a search with their measures, by set and scenario."""
    table = client.evaluations(campaign, measures="true").to_arrow().to_pylist()
    return {(*(row[name] for name in names), row["scenario"]): row for row in table}


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
        serving(tmp_path, workers=1, DRIVECAL_BACKEND="ray", DRIVECAL_BUNDLE_CACHE=cache) as server,
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
