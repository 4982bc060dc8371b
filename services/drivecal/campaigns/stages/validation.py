"""The validation stage: checks that answers are the same if the influence map says so (Section V of the paper)."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from drivecal.analysis.validation import Differences, ReducibleSpace, Region, ValidationDesign, design, mean_interval
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.stages.stage import Round
from drivecal.campaigns.stages.study import StudyStage
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import CellScore, RequestedCell
from drivecal.domain.influence import InfluenceMap
from drivecal.domain.parameters import Indices, Parameter, ParameterSpace, billionths
from drivecal.domain.scales import Scale
from drivecal.plugins.ports import Floats
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database


def reducible_space(influence_map: InfluenceMap, scenario: str, space: ParameterSpace) -> ReducibleSpace:
    """The values that the map treats as the same in a scenario, as in the reference keys."""
    return ReducibleSpace(space.n_values, [_regions(influence_map, scenario, parameter) for parameter in space.searched])


def _regions(influence_map: InfluenceMap, scenario: str, parameter: Parameter) -> list[Region]:
    """Returns grid indices whose values have one reference key, as far as the map covers them."""
    influence, name = influence_map.influence(scenario, parameter.name), parameter.name
    if parameter.choices:
        analysed = influence_map.choices.get(name, frozenset(parameter.choices))
        members = tuple(index for index, text in enumerate(parameter.choices) if text in analysed)
        return [] if influence.influential else [members]
    start, stop = 0, parameter.n_values
    if name in influence_map.ranges:
        lowest, highest = influence_map.ranges[name]
        start, stop = parameter.first_from(billionths(lowest)), parameter.last_upto(billionths(highest)) + 1
    if not influence.influential:
        return [range(start, stop)]
    regions: list[Region] = []
    if influence.lower is not None:
        regions.append(range(start, min(stop, parameter.first_from(billionths(influence.lower)))))
    if influence.upper is not None:
        regions.append(range(max(start, parameter.last_upto(billionths(influence.upper)) + 1), stop))
    return regions


def compared(differences: Floats, scale: Scale) -> dict[str, Any]:
    """Returns the fields of a row that follow from differences of scores, shape (n,)."""
    total, away = len(differences), np.abs(differences)
    wrong = int((away > scale.largest_agreeing).sum())
    bins, counts = np.unique(_bars(differences, scale), return_counts=True)
    return {
        "compared": total,
        "wrong": wrong,
        "different": int((away > scale.rounding).sum()),
        "error_rate": wrong / total if total else None,
        "histogram": {str(number): count for number, count in zip(bins.tolist(), counts.tolist(), strict=True)},
        "histogram_step": scale.bin,
    }


def _bars(differences: Floats, scale: Scale) -> Indices:
    """Returns numbers of bars, 0 in the middle: a bar is wrong exactly if its differences are; the outermost hold all beyond the span."""
    last = scale.last_bar + 1
    numbers = np.clip(np.rint(differences / scale.bin), -last, last)
    agreeing = next((number - 1 for number in range(1, last) if scale.is_wrong(number * scale.bin)), last - 1)
    sizes = np.abs(numbers)
    wrong = np.abs(differences) > scale.largest_agreeing
    sizes = np.where(wrong, np.maximum(sizes, agreeing + 1), np.minimum(sizes, agreeing))
    bars: Indices = (np.copysign(1, differences) * sizes).astype(np.int64)
    return bars


class ValidationStage(StudyStage):
    """One round: all bases and their variants, scenario by scenario. `individual` numbers them: base x (n_ref + 1), the base first."""

    name = StageName.VALIDATION
    uses_map = True

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        """`view` with the influence map that is to be validated."""
        super().__init__(database, campaign, problem, view)
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
                problem.constraints.feasible if problem.constraints else None,
            )
            for scenario in problem.scenarios
        }
        self._differences: dict[str, Differences] | None = None

    @staticmethod
    def is_wanted(campaign: StoredCampaign, problem: CalibrationProblem) -> bool:
        del campaign
        wanted = problem.specification.validation
        return wanted is not None and wanted.of is None

    @property
    def _at_most(self) -> int:
        return sum(len(pairs.bases) * (1 + self._references) for pairs in self._designs.values() if pairs is not None)

    def _ask(self) -> Round | None:
        if self._differences is not None:
            return None
        space, cells = self._problem.space, []
        for scenario, pairs in self._designs.items():
            if pairs is None:
                continue
            together = np.concatenate([pairs.bases[:, None], pairs.variants], axis=1).reshape(-1, pairs.bases.shape[1])
            allowed = self._problem.constraints.feasible(together)
            cells += [
                RequestedCell(number, scenario, each)
                for number, each in enumerate(space.parameter_sets(together))
                if allowed[number]
            ]
        return Round(0, [(self._problem.bench, cells)], self._exact) if cells else None

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
            f"nothing to validate in {row['scenario']}: no parameter has a region in which it does not matter"
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
            "lower_95": lower,
            "upper_95": upper,
        }
