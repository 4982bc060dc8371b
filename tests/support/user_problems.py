"""Problems of users for whole-way tests: copies of the examples, an FMU that is compiled, and what a campaign with one finds."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from tests.support.fmus import build

from drivecal.client import Client

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples" / "problems"
SPEC: dict[str, Any] = {
    "sensitivity": None,
    "optimizer": {"kind": "genetic", "population": 24, "iterations": 3, "seed": 3},
    "reduction": {"mode": "exact"},
}
RESULTS = ("outcome", "score", "failure", "iteration", "individual", "scenario")


FMU = {
    "problem": "fmu",
    "parameters": {
        "rate": {"lower": -3, "upper": 3},
        "factor": {"lower": 1, "upper": 4, "integer": True},
        "mode": {"choices": ["eco", "sport"]},
    },
    "simulator": {
        "kind": "fmu",
        "file": "trial2.fmu",
        "duration": 2.0,
        "step": 0.1,
        "measures": {"end": "last(body.x[1])", "most": "max(body.x[1])"},
        "deterministic": True,
    },
    "scenarios": {"plain": {}, "flagged": {"flag": True}},
    "measures": {"end": "m", "most": "m"},
    "scores": {"miss": {"formula": "abs(end - 4)", "direction": "minimise", "range": [0, 40]}},
}
"""A whole system, compiled by the test."""

ZDT1_MODEL = """
def evaluate(parameters, scenario):
    first, *others = (parameters[f"x{place}"] for place in range(5))
    slope = 1 + 9 * sum(others) / len(others)
    return {"f1": first, "f2": slope * (1 - (first / slope) ** 0.5)}
"""
ZDT1: dict[str, Any] = {
    "problem": "zdt1",
    "parameters": {f"x{place}": {"lower": 0, "upper": 1} for place in range(5)},
    "simulator": {"kind": "python", "file": "model.py", "function": "evaluate", "deterministic": True},
    "scenarios": {"plain": {}},
    "measures": {"f1": "1", "f2": "1"},
    "scores": {name: {"formula": name, "direction": "minimise", "range": [0, 10]} for name in ("f1", "f2")},
}
"""Two scores that contradict each other."""
ZDT1_SPEC: dict[str, Any] = {
    "problem": "zdt1",
    "objectives": [{"score": name, "reference": 1.1} for name in ("f1", "f2")],
    "optimizer": {"kind": "nsga2", "population": 20, "iterations": 30, "seed": 4},
    "reduction": {"mode": "off"},
}
ZDT1_LARGEST = 0.1 + 2 / 3 + 0.11
"""Hypervolume of the front f2 = 1 - sqrt(f1)."""


def problem(name: str, folder: Path) -> Path:
    """A problem's folder, ready to be pushed: a copy of an example, or an FMU with its manifest."""
    copy = folder / name
    if name == "fmu":
        copy.mkdir()
        build(copy, 2)
        (copy / "problem.yaml").write_text(yaml.safe_dump(FMU, sort_keys=False))
        return copy
    shutil.copytree(EXAMPLES / name, copy)
    if (copy / "Makefile").is_file():
        subprocess.run(["make", "-s"], cwd=copy, check=True)
    return copy


def of_python(manifest: Mapping[str, Any], model: str, folder: Path) -> Path:
    """The folder of a problem that is a Python function."""
    copy = folder / str(manifest["problem"])
    copy.mkdir()
    (copy / "problem.yaml").write_text(yaml.safe_dump(dict(manifest), sort_keys=False))
    (copy / "model.py").write_text(model)
    return copy


def rows(client: Client, campaign: str) -> list[tuple[object, ...]]:
    """The results of a campaign in their order, without what depends on workers."""
    page = client.evaluations(campaign).to_pandas()
    return [tuple(row) for row in page[list(RESULTS)].itertuples(index=False, name=None)]
