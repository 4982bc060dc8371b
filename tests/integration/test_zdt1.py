"""ZDT1 as a user's problem with two scores: dispatchers that die, and the whole way on real workers of a server that is killed."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support.computed import ComputedBackend
from tests.support.deaths import ends_in_spite_of_deaths
from tests.support.problems import store
from tests.support.runs import everything
from tests.support.serve import Server, serving, until
from tests.support.user_problems import rows

from drivecal.api import submission
from drivecal.api.dependencies import Limits
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.results.front import front_of
from drivecal.client import Client
from drivecal.configuration.settings import load_settings
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

MODEL = """
def evaluate(parameters, scenario):
    first, *others = (parameters[f"x{place}"] for place in range(5))
    slope = 1 + 9 * sum(others) / len(others)
    return {"f1": first, "f2": slope * (1 - (first / slope) ** 0.5)}
"""
ZDT1 = {
    "problem": "zdt1",
    "parameters": {f"x{place}": {"lower": 0, "upper": 1} for place in range(5)},
    "simulator": {"kind": "python", "file": "model.py", "function": "evaluate", "deterministic": True},
    "scenarios": {"plain": {}},
    "measures": {"f1": "1", "f2": "1"},
    "scores": {name: {"formula": name, "direction": "minimise", "range": [0, 10]} for name in ("f1", "f2")},
}
SPEC: dict[str, Any] = {
    "problem": "zdt1",
    "objectives": [{"score": name, "reference": 1.1} for name in ("f1", "f2")],
    "optimizer": {"kind": "nsga2", "population": 32, "iterations": 20, "seed": 4},
    "reduction": {"mode": "off"},
}
LARGEST = 0.1 + 2 / 3 + 0.11
"""Hypervolume of the front f2 = 1 - sqrt(f1)."""


def started(folder: Path) -> AbstractContextManager[Server]:
    return serving(folder, workers=2, DRIVECAL_BACKEND="processes", DRIVECAL_BUNDLE_CACHE=str(folder / "cache"))


def evaluated(scenario: str, cell: Cell) -> CellResult:
    namespace: dict[str, Any] = {}
    exec(MODEL, namespace)
    return CellResult(cell.id, None, None, namespace["evaluate"](dict(cell.parameters), scenario), None, 7.0)


def test_a_search_of_two_scores_ends_alike_in_spite_of_deaths(tmp_path: Path) -> None:
    search = SPEC["optimizer"] | {"population": 16, "iterations": 6}
    bound = [{"measure": "f2", "at_most": 4.0}]
    document = SPEC | {"optimizer": search, "constraints": bound, "reduction": {"mode": "exact"}}

    def begin(database: Database) -> StoredCampaign:
        store(database, ZDT1, {"model.py": MODEL})
        return submission.submit(database, Limits.of(load_settings()), CampaignSpecification.model_validate(document), None)

    def find(database: Database, campaign: StoredCampaign) -> Any:
        with database.read() as connection:
            ended = campaigns.get(connection, campaign.id)
        front = front_of(database, ended, resolved_spec(ended))
        return everything(database, campaign), front.points.tolist(), front.hypervolumes()

    ends = ends_in_spite_of_deaths(tmp_path, begin, lambda seed: ComputedBackend(seed=seed, answer=evaluated), find, stride=7)
    assert len(ends) > 5
    assert all(end == ends[0] for end in ends)
    _, front, growth = ends[0]
    assert len(front) > 2
    assert [volume for _, volume, _ in growth] == sorted(volume for _, volume, _ in growth)


@pytest.mark.slow
def test_a_killed_search_ends_with_the_front_of_an_uninterrupted_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))
    folder = tmp_path / "zdt1"
    folder.mkdir()
    (folder / "problem.yaml").write_text(yaml.safe_dump(ZDT1, sort_keys=False))
    (folder / "model.py").write_text(MODEL)
    with started(tmp_path) as server, Client(server.url) as client:
        client.push_problem(folder)
        whole = client.wait(client.submit(SPEC).id)
        assert (whole.state, whole.error) == ("succeeded", None)
        expected = client.front(whole.id), client.front_summary(whole.id), rows(client, whole.id)
        assert 0.7 * LARGEST < (expected[1].hypervolume or 0) <= LARGEST
        killed = client.submit(SPEC).id
        until(lambda: (client.campaign(killed).iteration or 0) >= 5, "five generations are over")
        family = server.family()
        server.process.kill()
        for process in family:
            process.kill()
        server.process.wait()
    with started(tmp_path) as server, Client(server.url) as client:
        assert client.wait(killed).state == "succeeded"
        assert (client.front(killed), client.front_summary(killed), rows(client, killed)) == expected
