"""Problems of users for whole-way tests: copies of the examples, an FMU that is compiled, and what a campaign with one finds."""

import shutil
import subprocess
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


def rows(client: Client, campaign: str) -> list[tuple[object, ...]]:
    """The results of a campaign in their order, without what depends on workers."""
    page = client.evaluations(campaign).to_pandas()
    return [tuple(row) for row in page[list(RESULTS)].itertuples(index=False, name=None)]
