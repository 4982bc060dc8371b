"""Analyses of continuous parameters, integers and choices, and within constraints."""

from decimal import Decimal
from itertools import pairwise
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.unit.sensitivity.synthetic import drive

from drivecal.bundles.expressions import Constraint
from drivecal.contracts.specification import SensitivitySpecification
from drivecal.domain.constraints import Constraints
from drivecal.domain.influence import Influence
from drivecal.domain.parameters import Indices, Parameter, ParameterSpace
from drivecal.sensitivity.analysis import SensitivityAnalysis
from drivecal.sensitivity.designs import COLUMNS, Floats, SobolRows, lines_design, radial_design

SPACE = ParameterSpace(
    (
        Parameter.from_step("speed", Decimal(0), Decimal(1000), None),
        Parameter.integer("gears", Decimal(1), Decimal(4)),
        Parameter.choice("mode", ["eco", "sport"]),
        Parameter.choice("tyre", ["a", "b", "c", "d", "e"]),
    )
)
SETTINGS = SensitivitySpecification(design="lines", intervals=8, samples=16, threshold="auto", seed=5)
LAST = SPACE.n_values - 1

designs = pytest.mark.parametrize("design", ["lines", "paper"])
sequentially = pytest.mark.parametrize("sequential", [True, False])


def score(points: Indices) -> Floats:
    """Depends on speed below 0.4 of its range, on gears and on mode, not on tyre."""
    speed = np.minimum(points[:, 0] / LAST[0], 0.4) / 0.4
    return np.asarray(1 + np.floor(4 * speed) % 3 + points[:, 1] % 2 + 2 * points[:, 2], dtype=np.float64)


def analysed(design: Literal["lines", "paper"], *, sequential: bool) -> SensitivityAnalysis:
    return SensitivityAnalysis(
        SPACE,
        ["S1"],
        SensitivitySpecification(design=design, intervals=8, samples=16, threshold="auto", seed=5, sequential=sequential),
    )


@designs
@sequentially
def test_bounds_of_numbers_are_cut_and_choices_are_whole(design: Literal["lines", "paper"], sequential: bool) -> None:
    analysis = analysed(design, sequential=sequential)
    drive(analysis, {"S1": score})
    result = analysis.result()["S1"].parameters
    speed = result["speed"].influence
    assert speed.influential
    assert speed.lower is None
    assert speed.upper is not None
    assert Decimal(375) <= speed.upper <= Decimal(500)
    assert result["gears"].influence == Influence(influential=True)
    assert result["mode"].influence == Influence(influential=True)
    assert result["tyre"].influence == Influence(influential=False)
    assert [len(parameter.intervals) for parameter in result.values()] == [8, 3, 1, 1]


@designs
def test_announced_runs_count_each_parameters_own_intervals(design: Literal["lines", "paper"]) -> None:
    analysis = analysed(design, sequential=False)
    announced = analysis.expected_runs()
    assert announced["intervals"] == {"lines": 16 * (1 + 15 + 5 + 1 + 1), "paper": 13 * 16 * 5}[design]
    told = drive(analysis, {"S1": score})
    for name, runs in announced.items():
        assert sum(made["S1"] for phase, made in told if phase == name) <= runs
    assert sum(made["S1"] for phase, made in told if phase == "intervals") == announced["intervals"]


@given(st.integers(0, 1000))
@settings(max_examples=examples(25), deadline=None)
def test_every_change_of_a_choice_is_a_step_of_the_whole_range(seed: int) -> None:
    unordered = np.array([False, False, True, True])
    rows = SobolRows(COLUMNS * 4, seed)
    radial = radial_design(SPACE.n_values, rows, np.zeros_like(LAST), LAST, 16, unordered=unordered)
    assert np.abs(radial.steps[2:]).tolist() == np.ones((2, 16)).tolist()
    assert np.abs(radial.steps[0]).min() >= 0.25
    edges = [np.array([0, LAST[0] // 2, LAST[0]]), np.array([0, 1, 3]), np.array([0, 1]), np.array([0, 4])]
    lines = lines_design(SPACE.n_values, edges, 16, seed, 0, unordered)
    assert np.isnan(lines.steps[2:, 1]).all()
    assert np.abs(lines.steps[2:, 0]).tolist() == np.ones((2, 16)).tolist()
    changes = lines.points[lines.second[3, 0], 3] - lines.points[lines.first[3, 0], 3]
    assert (changes != 0).all()


@designs
@sequentially
def test_points_that_break_constraints_are_never_asked(design: Literal["lines", "paper"], sequential: bool) -> None:
    constraints = Constraints(SPACE, {"slow or high": lambda values: (values["speed"] <= 800) | (values["gears"] > 2)})
    chosen = SensitivitySpecification(design=design, intervals=8, samples=24, threshold="auto", seed=5, sequential=sequential)
    analysis = SensitivityAnalysis(SPACE, ["S1", "S2"], chosen, constraints=constraints)

    def kept(points: Indices) -> Floats:
        assert constraints.feasible(points).all()
        return score(points)

    drive(analysis, {"S1": kept, "S2": kept})
    result = analysis.result()["S1"].parameters
    assert result["mode"].influence == Influence(influential=True)
    assert result["tyre"].influence == Influence(influential=False)
    assert result["speed"].influence.upper is not None


@designs
def test_without_a_feasible_step_of_one_parameter_everything_is_influential(design: Literal["lines", "paper"]) -> None:
    space = ParameterSpace(tuple(Parameter.from_step(name, Decimal(0), Decimal(1), Decimal("0.1")) for name in "ab"))
    constraints = Constraints(space, {"a + b == 1": Constraint("a + b == 1", {"a": (), "b": ()})})
    chosen = SensitivitySpecification(design=design, intervals=5, samples=8, seed=5)
    analysis = SensitivityAnalysis(space, ["S1"], chosen, constraints=constraints)
    drive(analysis, {"S1": lambda points: np.asarray(points[:, 0], dtype=np.float64)})
    assert {each.influence for each in analysis.result()["S1"].parameters.values()} == {Influence(influential=True)}


@pytest.mark.slow
def test_each_coefficient_of_a_curve_with_a_form_gets_steps_within_what_is_announced() -> None:
    names = [f"gain_{number}" for number in range(1, 9)]
    space = ParameterSpace(tuple(Parameter.from_step(name, Decimal(0), Decimal(4), None) for name in [*names, "mass"]))
    form = [f"{b} <= {a}" for a, b in pairwise(names)]
    form += [f"{a} - 2*{b} + {c} >= 0" for a, b, c in zip(names, names[1:], names[2:], strict=False)]
    constraints = Constraints(space, {text: Constraint(text, dict.fromkeys(names, ())) for text in form})
    chosen = SensitivitySpecification(design="lines", intervals=4, samples=8, threshold="auto", seed=5, sequential=False)
    analysis = SensitivityAnalysis(space, ["S1"], chosen, constraints=constraints)
    announced = analysis.expected_runs().items()
    told = drive(analysis, {"S1": lambda points: 1 + 6 * (points / (space.n_values - 1))[:, [1, 8]].mean(axis=1)})
    assert all(sum(made["S1"] for phase, made in told if phase == name) <= runs for name, runs in announced)
    result = analysis.result()["S1"].parameters
    assert all(any(each.measures.n_effects > 1 for each in parameter.intervals) for parameter in result.values())
    assert {name for name, parameter in result.items() if parameter.influence.influential} == {"gain_2", "mass"}
