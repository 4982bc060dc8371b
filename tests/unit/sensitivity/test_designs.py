"""Every design keeps grids, boxes, one parameter per step, no zero steps and its number of runs, in any space."""

import hashlib
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from tests.support.effort import examples

from drivecal.domain.parameters import Indices
from drivecal.sensitivity.designs import (
    COLUMNS,
    Design,
    SobolRows,
    auxiliary_points,
    lines_design,
    paper_design,
    radial_design,
    regions_design,
)
from drivecal.sensitivity.scenario import interval_edges


@dataclass(frozen=True)
class Case:
    n_values: Indices
    intervals: int
    samples: int
    seed: int

    @property
    def edges(self) -> list[Indices]:
        return [interval_edges(n, self.intervals) for n in self.n_values.tolist()]


@st.composite
def cases(draw: st.DrawFn) -> Case:
    intervals = draw(st.integers(1, 6))
    sizes = st.lists(st.integers(intervals + 1, 60), min_size=1, max_size=4)
    return Case(np.array(draw(sizes)), intervals, draw(st.integers(2, 9)), draw(st.integers(0, 2**63 - 1)))


def assert_steps(design: Design, n_values: Indices, column: int, analysis: tuple[int, ...], lower: int, upper: int) -> None:
    """One analysis of the parameter in `column`, whose two points must lie in [lower, upper]."""
    one, other = design.points[design.first[analysis]], design.points[design.second[analysis]]
    assert np.all((one != other).sum(axis=1) == 1)
    for ends in (design.first, design.second):
        assert design.samples[ends[analysis]].tolist() == list(range(len(one))), "both runs of an effect have its sample"
    difference = (other - one)[:, column]
    assert np.all(np.abs(difference) >= max(1, (upper - lower) / 4))
    for points in (one, other):
        assert points[:, column].min() >= lower
        assert points[:, column].max() <= upper
    assert design.steps[analysis] == pytest.approx(difference / (n_values[column] - 1))


def assert_on_grid(design: Design, n_values: Indices) -> None:
    assert design.points.min() >= 0
    assert np.all(design.points < n_values)


def intervals_of(case: Case) -> list[tuple[int, int, int, int]]:
    """Column, number of the interval, its ends."""
    return [
        (column, number, int(marks[number]), int(marks[number + 1]))
        for column, marks in enumerate(case.edges)
        for number in range(case.intervals)
    ]


@given(cases())
@settings(max_examples=examples(60))
def test_lines_step_inside_every_interval_and_need_the_announced_runs(case: Case) -> None:
    design = lines_design(case.n_values, case.edges, case.samples, case.seed, 0)
    n_p = len(case.n_values)
    assert len(design.points) == case.samples * (1 + n_p * (2 * case.intervals - 1))
    assert design.steps.shape == (n_p, case.intervals, case.samples)
    assert_on_grid(design, case.n_values)
    for column, number, lower, upper in intervals_of(case):
        assert_steps(design, case.n_values, column, (column, number), lower, upper)


@given(cases())
@settings(max_examples=examples(60))
def test_lines_share_their_base_points(case: Case) -> None:
    """Seen along one parameter, the others have the base points' values, the same in all intervals and at both ends of a step."""
    design = lines_design(case.n_values, case.edges, case.samples, case.seed, 0)
    base = design.points[: case.samples]
    for column, number, *_ in intervals_of(case):
        others = np.delete(design.points[design.first[column, number]], column, axis=1)
        assert np.array_equal(others, np.delete(base, column, axis=1))
    assert np.all((design.first < case.samples).sum(axis=1) == 1), "each serves once per parameter"


@given(cases())
@settings(max_examples=examples(40))
def test_the_papers_design_steps_inside_every_interval_and_needs_the_runs_of_equation_3(case: Case) -> None:
    design = paper_design(case.n_values, case.edges, case.samples, case.seed, 0)
    n_p = len(case.n_values)
    assert len(design.points) == n_p * case.intervals * case.samples * (n_p + 1)
    assert design.steps.shape == (n_p, case.intervals, case.samples)
    assert_on_grid(design, case.n_values)
    runs = design.points.reshape(n_p, case.intervals, case.samples * (n_p + 1), n_p)
    for column, number, lower, upper in intervals_of(case):
        assert_steps(design, case.n_values, column, (column, number), lower, upper)
        confined = runs[column, number, :, column]
        assert confined.min() >= lower, "whatever else is varied, the parameter stays in its interval"
        assert confined.max() <= upper


@given(cases(), st.data())
@settings(max_examples=examples(60))
def test_a_radial_design_stays_in_its_box(case: Case, data: st.DataObject) -> None:
    lower = np.array([data.draw(st.integers(0, n - 2)) for n in case.n_values.tolist()])
    ends = zip(lower.tolist(), case.n_values.tolist(), strict=True)
    upper = np.array([data.draw(st.integers(low + 1, n - 1)) for low, n in ends])
    n_p = len(lower)
    design = radial_design(case.n_values, SobolRows(COLUMNS * n_p, case.seed), lower, upper, case.samples)
    assert len(design.points) == case.samples * (n_p + 1)
    assert design.steps.shape == (n_p, case.samples)
    assert np.all((design.points >= lower) & (design.points <= upper))
    for column in range(n_p):
        assert_steps(design, case.n_values, column, (column,), int(lower[column]), int(upper[column]))


def test_points_fill_the_box_evenly_and_steps_follow_the_law() -> None:
    n_values = np.array([1001])
    design = radial_design(n_values, SobolRows(COLUMNS, 3), np.array([200]), np.array([600]), 4096)
    base = design.points[design.first[0], 0]
    assert stats.kstest((base - 200) / 400, "uniform").pvalue > 0.01
    lengths = np.abs(design.steps[0]) * 1000
    assert lengths.min() >= 100
    grid = np.arange(401)
    allowed = np.abs(grid[:, None] - grid[None, :]) >= 100
    shares = (allowed / allowed.sum(axis=1, keepdims=True)).ravel() / 401
    exact = float((shares * np.abs(grid[:, None] - grid[None, :]).ravel()).sum())
    assert lengths.mean() == pytest.approx(exact, rel=0.02)


@given(cases(), st.data())
@settings(max_examples=examples(60))
def test_regions_take_two_runs_per_effect_whatever_else_is_asked(case: Case, data: st.DataObject) -> None:
    regions = []
    for column, n in enumerate(case.n_values.tolist()):
        lower = data.draw(st.integers(0, n - 2))
        regions.append((column, lower, data.draw(st.integers(lower + 1, n - 1))))
    design = regions_design(case.n_values, regions, case.samples, case.seed, 2)
    assert len(design.points) == 2 * case.samples * len(regions)
    assert_on_grid(design, case.n_values)
    for number, (column, lower, upper) in enumerate(regions):
        assert_steps(design, case.n_values, column, (number,), lower, upper)
    alone = regions_design(case.n_values, regions[-1:], case.samples, case.seed, 2)
    assert np.array_equal(alone.points, design.points[-2 * case.samples :])


@given(cases())
@settings(max_examples=examples(20))
def test_seeds_decide_everything(case: Case) -> None:
    n_values = case.n_values + 1000
    edges = [interval_edges(n, case.intervals) for n in n_values.tolist()]
    for make in (lines_design, paper_design):
        one, again, other = (make(n_values, edges, case.samples, seed, 0) for seed in (case.seed, case.seed, case.seed ^ 1))
        assert np.array_equal(one.points, again.points)
        assert not np.array_equal(one.points, other.points)


@given(st.integers(1, 2000), st.integers(1, 40))
def test_intervals_share_edges_cover_the_grid_and_are_equally_wide(steps: int, intervals: int) -> None:
    edges = interval_edges(steps + 1, intervals)
    widths = np.diff(edges)
    assert (edges[0], edges[-1], len(edges)) == (0, steps, intervals + 1)
    assert widths.max() - widths.min() <= 1
    assert (widths.min() >= 1) == (intervals <= steps)


@given(st.integers(1, 8), st.integers(0, 20))
def test_on_a_small_grid_every_value_that_is_far_enough_is_drawn(width: int, start: int) -> None:
    lower, upper = np.array([start]), np.array([start + width])
    base = np.repeat(np.arange(start, start + width + 1), 64)[:, np.newaxis]
    result = auxiliary_points(SobolRows(2, start, width), 0, base, lower, upper)
    for value in range(start, start + width + 1):
        reached = set(result[base == value].tolist())
        assert reached == {item for item in range(start, start + width + 1) if abs(item - value) >= max(1, width / 4)}


def test_a_box_without_a_step_is_refused() -> None:
    with pytest.raises(ValueError, match="step"):
        auxiliary_points(SobolRows(4, 1), 0, np.array([[3, 3]]), np.array([3, 0]), np.array([3, 9]))


def test_the_rows_of_a_sequence_do_not_depend_on_when_they_are_drawn() -> None:
    early = SobolRows(5, 7, 1)
    early.upto(3)
    early.upto(11)
    assert np.array_equal(early.upto(100)[:100], SobolRows(5, 7, 1).upto(100)[:100])
    assert not np.array_equal(SobolRows(5, 7, 2).upto(8), SobolRows(5, 7, 1).upto(8))


def test_fixed_seeds_give_the_points_they_always_gave() -> None:
    """A change here gives a campaign that is resumed other points than it began with."""
    n_values = np.array([59, 201, 11])
    edges = [interval_edges(n, 5) for n in n_values.tolist()]
    designs = {
        "lines": lines_design(n_values, edges, 6, 1, 0),
        "paper": paper_design(n_values, edges, 6, 1, 0),
        "regions": regions_design(n_values, [(0, 0, 20), (2, 5, 10)], 6, 1, 2),
        "radial": radial_design(n_values, SobolRows(3 * COLUMNS, 1, 1, 1), np.zeros_like(n_values), n_values - 1, 6),
    }
    digests = {name: hashlib.sha256(design.points.astype("<i8").tobytes()).hexdigest()[:16] for name, design in designs.items()}
    assert digests == {
        "lines": "7f74dce35844812f",
        "paper": "36d17fd82263dce2",
        "regions": "64362e9669339d1d",
        "radial": "1c908cca323cc934",
    }
