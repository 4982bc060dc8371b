"""Validation of an influence map (Section V of the paper): answers must be the same if the map says so."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from drivecal.analysis.validation import Differences, ReducibleSpace, Region, ValidationDesign, compared, design, mean_interval
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.replication import SeededBenches
from drivecal.campaigns.stages.stage import Round, StudyStage, exact_policy
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import CellScore, RequestedCell
from drivecal.domain.influence import InfluenceMap
from drivecal.domain.parameters import Parameter, ParameterSpace
from drivecal.domain.values import code
from drivecal.reduction.keys import SHARED, MapColumns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database


def reducible_space(influence_map: InfluenceMap, scenario: str, space: ParameterSpace) -> ReducibleSpace:
    """The values that the map treats as the same in a scenario, as in the reference keys."""
    return ReducibleSpace(space.n_values, [_regions(influence_map, scenario, parameter) for parameter in space.searched])


def _regions(influence_map: InfluenceMap, scenario: str, parameter: Parameter) -> list[Region]:
    """Returns grid indices whose values have one code. Parameters have too many values for a table: codes change at the map's limits."""
    columns, count = MapColumns(influence_map, scenario, [parameter.name]), parameter.n_values
    changes = range(count) if parameter.choices else {0, *map(parameter.first_from, columns.changes)} - {count}
    starts = np.array(sorted(changes), dtype=np.int64)
    codes = columns.codes(np.array([[code(value)] for value in parameter.entries(starts)], dtype=np.int64))[:, 0]
    stops = np.append(starts[1:], count)
    regions = [(starts[codes == shared], stops[codes == shared]) for shared in SHARED]
    return [tuple(first.tolist()) if parameter.choices else range(first[0], last[-1]) for first, last in regions if len(first)]


class ValidationStage(StudyStage):
    """One round: all bases and their variants, scenario by scenario. `individual` numbers them: base x (n_ref + 1), the base first.
    A base of a random simulator has a seed, which its variants share."""

    name = StageName.VALIDATION
    uses_map = True

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        """`view` with the influence map that is to be validated."""
        super().__init__(database, campaign, problem, replace(view, influence_map=None))
        wanted, influence_map = problem.specification.validation, view.influence_map
        if wanted is None or influence_map is None:
            raise ValueError("the campaign has no map to validate")
        self._references = wanted.references
        self._designs: dict[str, ValidationDesign | None] = {
            scenario: design(
                reducible_space(influence_map, scenario, problem.space),
                wanted.samples,
                wanted.references,
                wanted.seed,
                wanted.largest,
                problem.constraints,
            )
            for scenario in problem.scenarios
        }
        self._differences: dict[str, Differences] | None = None

    @property
    def _at_most(self) -> int:
        return sum(len(pairs.bases) * (1 + self._references) for pairs in self._designs.values() if pairs is not None)

    def _ask(self) -> Round | None:
        if self._differences is not None:
            return None
        bench, space, cells = self._problem.bench, self._problem.space, []
        for scenario, pairs in self._designs.items():
            if pairs is None:
                continue
            together = np.concatenate([pairs.bases[:, None], pairs.variants], axis=1).reshape(-1, pairs.bases.shape[1])
            allowed = self._problem.constraints.feasible(together)
            cells += [
                RequestedCell(number, scenario, each, seed=bench.seed_of(number // (1 + self._references)))
                for number, each in enumerate(space.parameter_sets(together))
                if allowed[number]
            ]
        return Round(0, SeededBenches(bench).with_cells(cells), exact_policy(self._problem)) if cells else None

    def _take(self, number: int, answers: Sequence[CellScore]) -> None:
        del number
        width = 1 + self._references
        scores = {
            scenario: np.full((len(pairs.bases), width), np.nan)
            for scenario, pairs in self._designs.items()
            if pairs is not None
        }
        for answer in answers:
            if answer.score is not None:
                scores[answer.scenario][divmod(answer.individual, width)] = answer.score
        self._differences = {scenario: Differences(values[:, 1:] - values[:, :1]) for scenario, values in scores.items()}

    def _outcome(self) -> dict[str, Any]:
        rows = [self._row(scenario, pairs) for scenario, pairs in self._designs.items()]
        notes = [
            f"nothing to validate in {row['scenario']}: no parameter has a region where it does not matter"
            for row in rows
            if not row["bases"]
        ]
        return {"items": rows, "notes": notes}

    def _row(self, scenario: str, pairs: ValidationDesign | None) -> dict[str, Any]:
        differences = None if self._differences is None else self._differences.get(scenario)
        known, scale = np.empty(0) if differences is None else differences.known, self._problem.bench.scale
        shares = None if differences is None or not len(known) else differences.wrong_shares(scale.largest_agreeing)
        lower, upper = (None, None) if shares is None else mean_interval(shares)
        return {
            "scenario": scenario,
            "reducible": 0 if pairs is None else pairs.coverage.reducible,
            "effects": 0 if pairs is None else pairs.coverage.effects,
            "covered": 0 if pairs is None else pairs.coverage.covered,
            "drawn": 0 if pairs is None else pairs.drawn,
            "bases": 0 if pairs is None else len(pairs.bases),
            "references": self._references,
            **compared(known, scale),
            "error_rate": None if shares is None else float(shares.mean()),  # as the interval: bases count alike
            "lower_95": lower,
            "upper_95": upper,
        }
