"""DTLZ2, whose front is an eighth of the unit sphere, as a user's problem: searched as by a bare optimizer of a plug-in."""

from collections.abc import Mapping
from math import cos, pi, sin
from typing import Any

import numpy as np
from tests.support.computed import ComputedBackend
from tests.support.problems import store, submit_checked
from tests.support.runs import run
from tests.support.several import SEVERAL, installed

from drivecal.analysis.front import non_dominated
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.results.front import front_of
from drivecal.contracts.work import CellResult
from drivecal.storage.engine.database import Database

VALUES = 1001
"""Number of values of each of the five parameters, from 0 to 1."""
SEARCH: dict[str, Any] = {"kind": "several", "population": 32, "iterations": 20, "seed": 4}
NAMES = ("f1", "f2", "f3")
PROBLEM: dict[str, Any] = {
    "problem": "dtlz2",
    "parameters": {f"x{place}": {"lower": 0, "upper": 1, "step": 1 / (VALUES - 1)} for place in range(5)},
    "simulator": {"kind": "process", "command": ["mysim"], "deterministic": True},
    "scenarios": {"sphere": {}},
    "measures": dict.fromkeys(NAMES, "1"),
    "scores": {name: {"formula": name, "direction": "minimise", "range": [0, 10]} for name in NAMES},
}


def dtlz2(parameters: Mapping[str, Any]) -> dict[str, float]:
    x = [float(parameters[f"x{place}"]) for place in range(5)]
    away = 1 + sum((share - 0.5) ** 2 for share in x[2:])
    first, second = x[0] * pi / 2, x[1] * pi / 2
    return {"f1": away * cos(first) * cos(second), "f2": away * cos(first) * sin(second), "f3": away * sin(first)}


def test_a_campaign_searches_as_the_bare_optimizer_does(database: Database) -> None:
    store(database, PROBLEM)
    objectives = [{"score": name} for name in NAMES]
    document = {"problem": "dtlz2", "objectives": objectives, "optimizer": SEARCH, "reduction": {"mode": "off"}}
    backend = ComputedBackend(answer=lambda _, cell: CellResult(cell.id, None, None, dtlz2(cell.parameters), None, 7.0))
    with installed():
        ended = run(database, submit_checked(database, document), backend)
    grown = [size for _, size, _ in front_of(database, ended, resolved_spec(ended)).growth()]

    optimizer = SEVERAL.create(SEVERAL.settings.model_validate(SEARCH), np.full(5, VALUES))
    gains = np.empty((0, len(NAMES)))
    bare = []
    for _ in range(SEARCH["iterations"]):
        sets = [{f"x{place}": index / (VALUES - 1) for place, index in enumerate(row)} for row in optimizer.ask().population]
        told = -np.array([list(dtlz2(parameters).values()) for parameters in sets])
        optimizer.tell(told, np.zeros(len(told)))
        gains = np.concatenate([gains, told])
        bare.append(len(np.unique(gains[non_dominated(gains)], axis=0)))
    assert grown == bare
