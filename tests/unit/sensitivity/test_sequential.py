"""Intervals from both ends inwards: the same bounds as all runs of the design give, from fewer of them."""

from math import isnan
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.unit.sensitivity.synthetic import Box, Score, drive, influence_map, space_of, staircase

from drivecal.contracts.specification import SensitivitySpecification, SeparateThresholds
from drivecal.domain.influence import EVERYWHERE
from drivecal.domain.parameters import Indices
from drivecal.sensitivity.analysis import SensitivityAnalysis
from drivecal.sensitivity.designs import Floats
from drivecal.sensitivity.thresholds import Threshold, is_surely_influential, measures, verdict

SPACE = space_of(41, 101, 61)
BOXES: dict[str, Box] = {"S1": {0: (0.4, 0.9)}, "S2": {1: (0, 0.5), 2: (0.25, 0.7)}}
SCORES: dict[str, Score] = {scenario: staircase(SPACE, box) for scenario, box in BOXES.items()}
SETTINGS = SensitivitySpecification(design="lines", intervals=8, samples=12, threshold="auto", seed=5)
ALL_RUNS = SETTINGS.model_copy(update={"sequential": False})
THRESHOLDS: tuple[Threshold, ...] = (
    "auto",
    0.02,
    0.4,
    2.0,
    SeparateThresholds(mu=0.1, sigma=0.5),
    SeparateThresholds(mu=0.5, sigma=0.1),
)


class Recorded:
    """A score that remembers for which points it was asked."""

    def __init__(self, score: Score) -> None:
        self._score = score
        self.asked: list[tuple[int, ...]] = []

    def __call__(self, points: Indices) -> Floats:
        self.asked += [tuple(row) for row in points.tolist()]
        return self._score(points)


def rough(space: Any, box: Box, seed: int, changed: float, failing: float) -> Score:
    """A staircase with a share of changed points and a share of failing points; whole parts of the range fail as well."""
    stairs = staircase(space, box)

    def score(points: Indices) -> Floats:
        hashed = np.array([np.random.default_rng([seed, *row]).random(3) for row in points.tolist()])
        scores = np.where(hashed[:, 0] < changed, np.floor(8 * hashed[:, 1]), stairs(points))
        dead = points[:, 0] < failing * space.n_values[0]
        return np.where(dead | (hashed[:, 2] < failing / 3), np.nan, scores)

    return score


@pytest.mark.slow
@given(
    st.lists(st.integers(7, 40), min_size=1, max_size=4),
    st.integers(1, 6),
    st.integers(2, 14),
    st.sampled_from(THRESHOLDS),
    st.integers(0, 10_000),
    st.sampled_from([0.0, 0.02, 0.1, 0.6]),
    st.sampled_from([0.0, 0.1, 0.5]),
)
@settings(max_examples=examples(40), deadline=None)
def test_the_bounds_are_those_of_the_whole_design(
    sizes: list[int], intervals: int, samples: int, threshold: Threshold, seed: int, changed: float, failing: float
) -> None:
    space, generator = space_of(*sizes), np.random.default_rng(seed)
    boxes: list[Box] = [
        {column: (low, low + generator.random() + 0.01) for column, low in enumerate(starts) if generator.random() < 0.6}
        for starts in generator.random((2, len(sizes))).tolist()
    ]
    scores = {f"S{number}": Recorded(rough(space, box, seed, changed, failing)) for number, box in enumerate(boxes)}
    every = SensitivityAnalysis(
        space,
        list(scores),
        SensitivitySpecification(
            design="lines", intervals=intervals, samples=samples, threshold=threshold, seed=seed, sequential=False
        ),
    )
    drive(every, scores)
    of_all = {scenario: set(score.asked) for scenario, score in scores.items()}
    for score in scores.values():
        score.asked.clear()
    some = SensitivityAnalysis(
        space,
        list(scores),
        SensitivitySpecification(design="lines", intervals=intervals, samples=samples, threshold=threshold, seed=seed),
    )
    drive(some, scores)
    assert influence_map(some) == influence_map(every)
    for scenario, score in scores.items():
        assert set(score.asked) <= of_all[scenario]
        full, short = every.result()[scenario], some.result()[scenario]
        assert short.unknown == full.unknown
        for name, parameter in short.parameters.items():
            assert parameter.confirmations == full.parameters[name].confirmations
            assert repr(parameter.overall) == repr(full.parameters[name].overall)  # NaN differs from itself


def finished(spec: SensitivitySpecification, scores: dict[str, Score] = SCORES) -> tuple[Any, list[tuple[str, dict[str, int]]]]:
    analysis = SensitivityAnalysis(SPACE, list(scores), spec)
    told = drive(analysis, scores)
    return analysis.result(), told


@pytest.mark.parametrize("threshold", THRESHOLDS[:3])
def test_it_takes_fewer_runs_than_announced_and_none_twice(threshold: Threshold) -> None:
    scores = {scenario: Recorded(score) for scenario, score in SCORES.items()}
    analysis = SensitivityAnalysis(SPACE, list(scores), SETTINGS.model_copy(update={"threshold": threshold}))
    while (phase := analysis.ask()) is not None and phase.name == "intervals":
        analysis.tell({scenario: scores[scenario](points) for scenario, points in phase.points.items()})
    announced = 2 * analysis.expected_runs()["intervals"]
    made = [(scenario, *point) for scenario, score in scores.items() for point in score.asked]
    assert len(made) < 0.85 * announced
    whole = SensitivityAnalysis(SPACE, list(scores), ALL_RUNS.model_copy(update={"threshold": threshold})).ask()
    assert whole is not None
    for scenario, score in scores.items():
        rows, counts = np.unique(whole.points[scenario], axis=0, return_counts=True)
        most = {tuple(row): count for row, count in zip(rows.tolist(), counts.tolist(), strict=True)}
        assert all(score.asked.count(point) <= most[point] for point in score.asked)


def test_only_intervals_between_influential_ones_are_left_out_and_have_no_figures() -> None:
    short, full = finished(SETTINGS)[0], finished(ALL_RUNS)[0]
    left_out = 0
    for scenario in SCORES:
        for name, parameter in short[scenario].parameters.items():
            marks = [interval.influential for interval in full[scenario].parameters[name].intervals]
            for place, s_rel in enumerate(parameter.s_rel_intervals):
                if isnan(s_rel):
                    left_out += 1
                    assert any(marks[:place])
                    assert any(marks[place + 1 :])
                elif not marks[place]:
                    assert s_rel == full[scenario].parameters[name].s_rel_intervals[place]
                else:
                    assert parameter.intervals[place].influential
    assert left_out > 0


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_a_scenario_of_which_nothing_is_known_takes_all_runs_before_it_counts_as_unknown(value: float) -> None:
    scores: dict[str, Score] = {"S1": lambda points: np.full(len(points), value)}
    result, told = finished(SETTINGS, scores)
    assert result["S1"].unknown
    assert {parameter.influence for parameter in result["S1"].parameters.values()} == {EVERYWHERE}
    taken = sum(sum(runs.values()) for phase, runs in told if phase == "intervals")
    assert taken == SensitivityAnalysis(SPACE, ["S1"], SETTINGS).expected_runs()["intervals"]


effects_of = st.floats(-1, 1).map(lambda change: round(7 * change))


@given(
    st.lists(st.tuples(effects_of, st.floats(0.02, 1), st.booleans()), min_size=2, max_size=40),
    st.integers(0, 40),
    st.sampled_from(THRESHOLDS),
    st.integers(0, 10_000),
)
@settings(max_examples=examples(150))
def test_what_is_influential_stays_so(pairs: list[tuple[int, float, bool]], made: int, threshold: Threshold, seed: int) -> None:
    generator = np.random.default_rng(seed)
    made = min(made, len(pairs))
    steps = np.array([step * generator.choice([-1, 1]) for _, step, _ in pairs])
    effects = np.array([np.nan if fails and generator.random() < 0.3 else change / 7 for change, _, fails in pairs]) / steps
    if not is_surely_influential(effects[:made], steps[:made], steps[made:], threshold):
        return
    completions = [effects]
    for share in (0.0, 0.5, 1.0):
        later = np.where(generator.random(len(pairs)) < share, np.nan, generator.integers(-7, 8, len(pairs)) / 7 / steps)
        completions += [
            np.where(np.arange(len(pairs)) < made, effects, later),
            np.where(np.arange(len(pairs)) < made, effects, 0.0),
            np.where(np.arange(len(pairs)) < made, effects, np.nanmean(effects[:made])),
        ]
    for completed in completions:
        assert verdict(measures(completed), steps[~np.isnan(completed)], threshold).influential


def test_auto_settles_with_as_many_changes_as_the_whole_analysis_needs() -> None:
    steps, changed = np.full(20, 0.5), np.zeros(20)
    changed[:2] = [1, -1]
    effects = changed / 7 / steps
    assert is_surely_influential(effects[:5], steps[:5], steps[5:], "auto")
    assert not is_surely_influential(effects[:1], steps[:1], steps[1:], "auto")
    assert not is_surely_influential(np.roll(effects, 1)[:2], steps[:2], steps[2:], "auto"), "one change is tolerated"
