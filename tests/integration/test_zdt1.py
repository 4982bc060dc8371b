"""ZDT1 as a user's problem with two scores, the whole way: pushed, searched on real workers, killed and resumed to the same bits."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path

import pytest
import yaml
from tests.support.serve import Server, serving, until
from tests.support.user_problems import rows

from drivecal.client import Client

pytestmark = pytest.mark.slow

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
SPEC = {
    "problem": "zdt1",
    "objectives": [{"score": name, "reference": 1.1} for name in ("f1", "f2")],
    "optimizer": {"kind": "nsga2", "population": 40, "iterations": 40, "seed": 4},
    "reduction": {"mode": "off"},
}
LARGEST = 0.1 + 2 / 3 + 0.11
"""Hypervolume of the front f2 = 1 - sqrt(f1)."""


def started(folder: Path) -> AbstractContextManager[Server]:
    return serving(folder, workers=2, DRIVECAL_BACKEND="processes", DRIVECAL_BUNDLE_CACHE=str(folder / "cache"))


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
        assert 0.93 * LARGEST < (expected[1].hypervolume or 0) <= LARGEST
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
