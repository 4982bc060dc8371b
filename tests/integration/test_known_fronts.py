"""ZDT1 and DTLZ2 as users' problems: the bare optimizer's search, dispatchers that die, and real workers of a server that is killed."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.computed import ComputedBackend
from tests.support.problems import store
from tests.support.runs import run

from drivecal.analysis.front import hypervolume, non_dominated
from drivecal.api import submission
from drivecal.api.dependencies import Limits
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.results.front import front_of
from drivecal.configuration.settings import load_settings
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.optimizers.optuna_samplers import OPTUNA
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

MODEL = """
from math import cos, pi, sin


def zdt1(x):
    slope = 1 + 9 * sum(x[1:]) / len(x[1:])
    return {"f1": x[0], "f2": slope * (1 - (x[0] / slope) ** 0.5)}


def dtlz2(x):
    away = 1 + sum((share - 0.5) ** 2 for share in x[2:])
    first, second = x[0] * pi / 2, x[1] * pi / 2
    return {"f1": away * cos(first) * cos(second), "f2": away * cos(first) * sin(second), "f3": away * sin(first)}


def evaluate(parameters, scenario):
    return {"zdt1": zdt1, "dtlz2": dtlz2}[scenario["function"]]([parameters[f"x{place}"] for place in range(5)])
"""
VALUES = 1001
"""Number of values of each of the five parameters, from 0 to 1."""
SEARCH: dict[str, Any] = {"kind": "optuna", "sampler": "nsga2", "population": 32, "iterations": 20, "seed": 4}


@dataclass(frozen=True)
class Known:
    """A test function whose front is known: `largest` is its hypervolume against `reference` for each objective."""

    name: str
    objectives: int
    reference: float
    largest: float

    @property
    def problem(self) -> dict[str, Any]:
        """The `problem.yaml`."""
        names = [f"f{place + 1}" for place in range(self.objectives)]
        return {
            "problem": self.name,
            "parameters": {f"x{place}": {"lower": 0, "upper": 1, "step": 1 / (VALUES - 1)} for place in range(5)},
            "simulator": {"kind": "python", "file": "model.py", "function": "evaluate", "deterministic": True},
            "scenarios": {self.name: {"function": self.name}},
            "measures": dict.fromkeys(names, "1"),
            "scores": {name: {"formula": name, "direction": "minimise", "range": [0, 10]} for name in names},
        }

    def campaign(self, **further: Any) -> dict[str, Any]:
        """A specification."""
        objectives = [{"score": name, "reference": self.reference} for name in self.problem["scores"]]
        return {"problem": self.name, "objectives": objectives, "optimizer": SEARCH, "reduction": {"mode": "off"}} | further


ZDT1 = Known("zdt1", 2, 1.1, 0.1 + 2 / 3 + 0.11)
"""Its front is f2 = 1 - sqrt(f1)."""
DTLZ2 = Known("dtlz2", 3, 1.1, 1.1**3 - pi / 6)
"""Its front is an eighth of the unit sphere."""
KNOWN = pytest.mark.parametrize("known", [ZDT1, DTLZ2], ids=lambda known: known.name)


def measures(scenario: str, parameters: Mapping[str, Any]) -> dict[str, float]:
    namespace: dict[str, Any] = {}
    exec(MODEL, namespace)
    values: dict[str, float] = namespace["evaluate"](dict(parameters), {"function": scenario})
    return values


def evaluated(scenario: str, cell: Cell) -> CellResult:
    return CellResult(cell.id, None, None, measures(scenario, cell.parameters), None, 7.0)


def begin(database: Database, known: Known, document: dict[str, Any]) -> StoredCampaign:
    """A campaign of a problem that was just stored."""
    store(database, known.problem, {"model.py": MODEL})
    return submission.submit(database, Limits.of(load_settings()), CampaignSpecification.model_validate(document), None)


@pytest.mark.slow("zdt1")
@KNOWN
def test_a_campaign_searches_as_the_bare_optimizer_does(known: Known, tmp_path: Path) -> None:
    """So figures of the bare optimizer, such as the former benchmark `fronts`, hold for campaigns of problems."""
    database = Database.open(f"sqlite:///{tmp_path}/drivecal.db")
    database.upgrade()
    ended = run(database, begin(database, known, known.campaign()), ComputedBackend(answer=evaluated))
    grown = [volume for _, volume, _ in front_of(database, ended, resolved_spec(ended)).hypervolumes()]
    database.dispose()

    optimizer = OPTUNA.create(OPTUNA.settings.model_validate(SEARCH), np.full(5, VALUES))
    gains = np.empty((0, known.objectives))
    bare = []
    for _ in range(SEARCH["iterations"]):
        sets = [{f"x{place}": index / (VALUES - 1) for place, index in enumerate(row)} for row in optimizer.ask().population]
        told = -np.array([list(measures(known.name, parameters).values()) for parameters in sets])
        optimizer.tell(told, np.zeros(len(told)))
        gains = np.concatenate([gains, told])
        bare.append(hypervolume(gains[non_dominated(gains)], np.full(known.objectives, -known.reference)) or 0.0)
    assert grown == pytest.approx(bare, rel=1e-8)
