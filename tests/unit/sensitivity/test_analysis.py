"""The analysis as a whole: phases, replay, what is given back, what stays unknown, and what is refused."""

from collections.abc import Mapping
from decimal import Decimal
from math import isnan
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.support.values import faults_of, present
from tests.unit.sensitivity.synthetic import Score, drive, influence_map, space_of, staircase

from drivecal.contracts.specification import SensitivitySpecification, SeparateThresholds
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.influence import EVERYWHERE, Influence
from drivecal.domain.parameters import Indices, Parameter, ParameterSpace
from drivecal.sensitivity.analysis import SensitivityAnalysis
from drivecal.sensitivity.designs import Floats

SPACE = space_of(41, 101, 61)
SETTINGS = SensitivitySpecification(design="lines", intervals=8, samples=12, threshold="auto", seed=5, sequential=False)
SCORES: dict[str, Score] = {"S1": staircase(SPACE, {0: (0.4, 0.9)}), "S2": staircase(SPACE, {1: (0, 0.5), 2: (0.25, 0.7)})}

both = pytest.mark.parametrize("design", ["lines", "paper"])


def constant(value: float) -> Score:
    return lambda points: np.full(len(points), value)


def finished(scores: Mapping[str, Score], chosen: SensitivitySpecification = SETTINGS, space: ParameterSpace = SPACE) -> Any:
    analysis = SensitivityAnalysis(space, list(scores), chosen)
    drive(analysis, scores)
    return analysis.result()


@both
def test_what_is_announced_is_exact_for_the_intervals_and_never_too_little(design: Literal["lines", "paper"]) -> None:
    analysis = SensitivityAnalysis(SPACE, list(SCORES), SETTINGS.model_copy(update={"design": design}))
    announced = analysis.expected_runs()
    assert announced["intervals"] == {"lines": 12 * (1 + 3 * 15), "paper": 3 * 8 * 12 * 4}[design]
    told = drive(analysis, SCORES)
    for scenario in SCORES:
        made = {name: sum(runs.get(scenario, 0) for phase, runs in told if phase == name) for name in announced}
        assert made["intervals"] == announced["intervals"]
        assert made["global"] == announced["global"] == 12 * 4
        assert 0 < made["confirmation"] <= announced["confirmation"]


@both
def test_a_replayed_analysis_goes_on_as_the_first_would(design: Literal["lines", "paper"]) -> None:
    chosen = SETTINGS.model_copy(update={"design": design})
    first = SensitivityAnalysis(SPACE, list(SCORES), chosen)
    told: list[dict[str, Floats]] = []
    while (phase := first.ask()) is not None:
        second = SensitivityAnalysis(SPACE, list(SCORES), chosen)
        for scores in told:
            second.ask()
            second.tell(scores)
        again = present(second.ask())
        assert (again.number, again.name) == (phase.number, phase.name) == (len(told), phase.name)
        assert list(again.points) == list(phase.points)
        assert all(np.array_equal(again.points[scenario], phase.points[scenario]) for scenario in phase.points)
        told.append({scenario: SCORES[scenario](points) for scenario, points in phase.points.items()})
        first.tell(told[-1])
    assert len(told) >= 3
    assert finished(SCORES, chosen).keys() == first.result().keys()
    assert {name: one.parameters for name, one in finished(SCORES, chosen).items()} == {
        name: one.parameters for name, one in first.result().items()
    }


def test_a_scenario_is_analysed_the_same_whatever_others_there_are() -> None:
    for scenario, score in SCORES.items():
        assert finished({scenario: score})[scenario] == finished(SCORES)[scenario]
    turned = dict(reversed(SCORES.items()))
    assert finished(turned) == finished(SCORES)


def test_bounds_are_exact_values_of_the_grid_and_open_ends_the_spaces_own() -> None:
    result = SensitivityAnalysis(SPACE, list(SCORES), SETTINGS)
    drive(result, SCORES)
    influences = influence_map(result)
    assert influences["S1"]["P1"] == Influence(True, Decimal("1.5"), Decimal("3.5"))
    assert influences["S1"]["P2"] == influences["S1"]["P3"] == Influence(influential=False)
    assert influences["S2"]["P2"] == Influence(True, None, Decimal(5))
    assert influences["S2"]["P3"] == Influence(True, Decimal("1.5"), Decimal("4.5"))


def test_fixed_parameters_take_no_part() -> None:
    space = ParameterSpace(SPACE.parameters, {"P2": Decimal(3)})
    analysis = SensitivityAnalysis(space, ["S1"], SETTINGS)
    phase = present(analysis.ask())
    assert phase.points["S1"].shape == (12 * (1 + 2 * 15), 2)
    drive(analysis, {"S1": constant(3)})
    assert list(analysis.result()["S1"].parameters) == ["P1", "P3"]


def test_a_score_that_never_changes_has_no_influential_parameter() -> None:
    result = finished({"S1": constant(7)})["S1"]
    assert not result.unknown
    assert result.smallest_interval_s_rel is None
    assert result.smallest_overall_s_rel is None
    assert {parameter.influence for parameter in result.parameters.values()} == {Influence(influential=False)}


def none_or_zero(points: Indices) -> Floats:
    return np.where(points[:, 0] % 2 == 0, np.nan, 0.0)


@pytest.mark.parametrize("score", [constant(0), constant(np.nan), none_or_zero], ids=["zero", "failed", "both"])
def test_a_scenario_without_any_score_is_unknown_which_counts_as_influential(score: Score) -> None:
    analysis = SensitivityAnalysis(SPACE, ["S1", "S2"], SETTINGS)
    told = drive(analysis, {"S1": score, "S2": SCORES["S2"]})
    assert all("S1" not in runs for _, runs in told[1:])
    assert analysis.result()["S1"].unknown
    assert set(influence_map(analysis)["S1"].values()) == {EVERYWHERE}
    assert all(parameter.overall is None for parameter in analysis.result()["S1"].parameters.values())
    assert analysis.result()["S2"] == finished(SCORES)["S2"]


def test_intervals_of_which_too_few_runs_worked_are_not_cut() -> None:
    def upper_half_fails(points: Indices) -> Floats:
        return np.where(points[:, 1] >= 50, np.nan, 3.0)

    result = finished({"S1": upper_half_fails})["S1"].parameters
    assert [isnan(s_rel_interval) for s_rel_interval in result["P2"].s_rel_intervals] == [False] * 4 + [True] * 4
    assert [interval.influential for interval in result["P2"].intervals] == [False] * 4 + [True] * 4


@pytest.mark.parametrize("threshold", [0.02, "auto", SeparateThresholds(mu=0.01, sigma=0.02)])
def test_every_kind_of_threshold_finds_the_same_clear_regions(threshold: Any) -> None:
    result = finished(SCORES, SETTINGS.model_copy(update={"threshold": threshold}))
    for scenario, one in finished(SCORES).items():
        for name, parameter in one.parameters.items():
            assert result[scenario].parameters[name].influence == parameter.influence


def test_asking_twice_gives_the_same_phase_and_its_points_cannot_be_changed() -> None:
    analysis = SensitivityAnalysis(SPACE, ["S1", "S2"], SETTINGS)
    one, other = analysis.ask(), analysis.ask()
    assert one is not None
    assert np.array_equal(one.points["S1"], present(other).points["S1"])
    assert one.points["S1"] is one.points["S2"], "the intervals are the same for all scenarios"
    assert sum(map(len, one.points.values())) == 2 * len(one.points["S1"])
    with pytest.raises(ValueError, match="read-only"):
        one.points["S1"][0, 0] = 1


def test_answers_that_were_not_asked_for_are_refused() -> None:
    analysis = SensitivityAnalysis(SPACE, ["S1"], SETTINGS)
    with pytest.raises(RuntimeError):
        analysis.tell({"S1": np.zeros(3)})
    with pytest.raises(RuntimeError):
        analysis.result()
    drive(analysis, {"S1": constant(2)})
    with pytest.raises(RuntimeError):
        analysis.tell({})
    assert analysis.ask() is None


def test_intervals_finer_than_the_grid_are_refused_with_the_most_that_fit() -> None:
    refused = faults_of(SensitivityAnalysis, space_of(101, 7, 5), ["S1"], SETTINGS.model_copy(update={"intervals": 8}))
    assert [problem.field for problem in refused] == ["sensitivity.intervals"] * 2
    assert [name in problem.message for name, problem in zip(("P2", "P3"), refused, strict=True)] == [True, True]
    assert all("4" in problem.remedy for problem in refused), "the most that fit"
    SensitivityAnalysis(space_of(101, 7, 5), ["S1"], SETTINGS.model_copy(update={"intervals": 4}))


def test_where_every_parameter_is_fixed_there_is_nothing_to_analyse() -> None:
    parameter = Parameter.from_step("P1", Decimal(0), Decimal(1), Decimal("0.1"))
    with pytest.raises(InvalidInputError):
        SensitivityAnalysis(ParameterSpace((parameter,), {"P1": Decimal(0)}), ["S1"], SETTINGS)


@given(
    st.lists(st.integers(4, 30), min_size=1, max_size=3),
    st.integers(1, 3),
    st.sampled_from(["lines", "paper"]),
    st.integers(0, 10_000),
)
@settings(max_examples=examples(60))
def test_an_analysis_ends_as_announced(sizes: list[int], intervals: int, design: Literal["lines", "paper"], seed: int) -> None:
    generator = np.random.default_rng(seed)

    def noise(points: Indices) -> Floats:
        quiet = generator.random() < 0.5
        scores = generator.integers(3, 4 if quiet else 8, len(points)).astype(np.float64)
        return np.where(generator.random(len(points)) < 0.1, np.nan, scores)

    space = space_of(*sizes)
    analysis = SensitivityAnalysis(
        space,
        ["S1", "S2"],
        SensitivitySpecification(design=design, intervals=intervals, samples=3, threshold="auto", seed=seed),
    )
    announced = analysis.expected_runs()
    told = drive(analysis, {"S1": noise, "S2": noise})
    for scenario in ("S1", "S2"):
        for name, runs in announced.items():
            assert sum(made.get(scenario, 0) for phase, made in told if phase == name) <= runs
    for listed in influence_map(analysis).values():
        for parameter in space.searched:
            one = listed[parameter.name]
            lower = 0 if one.lower is None else parameter.index(one.lower)
            assert lower < (parameter.n_values - 1 if one.upper is None else parameter.index(one.upper))
