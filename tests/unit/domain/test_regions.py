"""Repair and samples of feasible regions: always feasible, pure, near, distinct."""

from __future__ import annotations

from decimal import Decimal
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import LinearConstraint, minimize
from tests.support.effort import examples

from drivecal.bundles.expressions import Constraint
from drivecal.domain.constraints import Constraints
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.parameters import Indices, Parameter, ParameterSpace
from drivecal.domain.regions import FeasibleRegion, Floats

CURVE = [f"k{number}" for number in range(8)]
MONOTONE = " >= ".join(CURVE)


def grids(names: list[str], step: str | None = "0.02") -> ParameterSpace:
    size = None if step is None else Decimal(step)
    return ParameterSpace(tuple(Parameter.from_step(name, Decimal(0), Decimal(2), size) for name in names))


def region_of(space: ParameterSpace, *texts: str) -> FeasibleRegion:
    known = {parameter.name: parameter.choices for parameter in space.searched}
    constraints = Constraints(space, {text: Constraint(text, known) for text in texts})
    return constraints.region(0 * space.n_values, space.n_values - 1)


def drawn(space: ParameterSpace, count: int, seed: int = 1) -> Indices:
    return np.random.default_rng(seed).integers(0, space.n_values, size=(count, len(space.n_values)))


def distinct(rows: Indices) -> int:
    return len(np.unique(rows, axis=0))


MIXED = ParameterSpace(
    (
        *grids(["a", "b"], step=None).parameters,
        *grids(["c", "d"], step="0.1").parameters,
        Parameter.integer("n", Decimal(-5), Decimal(5)),
        Parameter.choice("mode", ["eco", "sport", "winter"]),
    )
)
REGIONS = {
    text: region_of(MIXED, *text.split("; "))
    for text in (
        "a <= b",
        "a < b < c < d",
        "a >= b + 0.3 >= c",
        "a <= 0.001*n and c + d >= 1",
        "2*a + b - c/3 + 0.1*n <= 1; d <= a",
        "abs(a - b) <= 0.1; mode != 'winter' or n > 0",
        "a <= b; b*c >= 1; mode == 'eco' or n == 3",
        "a*a + b*b + c*c <= 0.5; a + b >= 0.2",
    )
}
every = pytest.mark.parametrize("region", REGIONS.values(), ids=REGIONS)
populations: st.SearchStrategy[Indices] = st.lists(
    st.tuples(*(st.integers(0, count - 1) for count in MIXED.n_values.tolist())), min_size=1, max_size=6
).map(np.array)


@every
@given(population=populations, data=st.data())
@settings(deadline=None, max_examples=examples(10))
def test_repair_is_feasible_idempotent_and_pure(region: FeasibleRegion, population: Indices, data: st.DataObject) -> None:
    repaired = region.repair(population)
    assert region.feasible(repaired).all()
    assert ((repaired >= 0) & (repaired < MIXED.n_values)).all()
    kept = region.feasible(population)
    assert repaired[kept].tolist() == population[kept].tolist()
    assert region.repair(repaired).tolist() == repaired.tolist()
    order = data.draw(st.permutations(range(len(population))))
    assert region.repair(population[order]).tolist() == repaired[order].tolist()
    assert region.repair(population[:1]).tolist() == repaired[:1].tolist()


@every
def test_samples_are_feasible_spread_and_repeatable(region: FeasibleRegion) -> None:
    rows = region.sample(200, np.random.default_rng(7))
    assert len(rows) == 200
    assert region.feasible(rows).all()
    assert distinct(rows) > 180
    assert rows.tolist() == region.sample(200, np.random.default_rng(7)).tolist()
    assert np.ptp(rows / (MIXED.n_values - 1), axis=0).min() > 0.001


@every
def test_proposals_stay_distinct(region: FeasibleRegion) -> None:
    assert distinct(region.repair(drawn(MIXED, 1000))) > 950


def test_what_no_constraint_reads_keeps_its_value() -> None:
    population = drawn(MIXED, 100)
    for text, columns in (("a*b*c <= 0.01", [3, 4, 5]), ("a + b <= 0.3", [2, 3, 4, 5]), ("d <= c", [0, 1, 4, 5])):
        assert region_of(MIXED, text).repair(population)[:, columns].tolist() == population[:, columns].tolist()


@pytest.mark.parametrize("step", ["0.02", None])
def test_proposals_over_a_monotone_curve_become_as_many_sets(step: str | None) -> None:
    space = grids([*CURVE, "headway"], step=step)
    region = region_of(space, MONOTONE)
    population = drawn(space, 1000)
    repaired = region.repair(population)
    assert distinct(repaired) >= 990
    assert repaired[:, -1].tolist() == population[:, -1].tolist()
    assert np.sort(repaired[:, :8], axis=1).tolist() == np.sort(population[:, :8], axis=1).tolist()
    rows = region.sample(1000, np.random.default_rng(3))
    assert distinct(rows) >= 990
    shares = rows[:, :8] / (space.n_values[:8] - 1)
    np.testing.assert_allclose(shares.mean(axis=0), np.arange(8, 0, -1) / 9, atol=0.02)  # order statistics of uniform draws
    assert np.isin(shares, (0, 1)).mean() < 0.03


def test_a_monotone_curve_in_several_constraints_is_one_chain() -> None:
    space = grids(CURVE)
    pairs = [f"{larger} >= {smaller}" for larger, smaller in pairwise(CURVE)]
    population = drawn(space, 50)
    assert region_of(space, *pairs[::-1]).repair(population).tolist() == region_of(space, MONOTONE).repair(population).tolist()


@pytest.mark.parametrize("link", [" >= ", " > ", " - 0.01 > "])
@pytest.mark.parametrize("step", ["0.005", None])
def test_a_hundred_chained_parameters_are_feasible(link: str, step: str | None) -> None:
    space = grids([f"p{number}" for number in range(100)], step=step)
    region = region_of(space, link.join(space.names))
    assert distinct(region.repair(drawn(space, 100))) == 100
    assert distinct(region.sample(100, np.random.default_rng(1))) == 100


def test_chains_of_unlike_grids_are_kept() -> None:
    steps = ["0.02", "0.05", "0.1", "0.04"]
    space = ParameterSpace(
        tuple(Parameter.from_step(f"p{i}", Decimal(0), Decimal(2), Decimal(steps[i % 4])) for i in range(40))
    )
    region = region_of(space, " <= ".join(space.names))
    assert distinct(region.repair(drawn(space, 200))) == 200


def test_the_only_set_that_is_left_is_found() -> None:
    space = ParameterSpace(tuple(Parameter.integer(f"n{number}", Decimal(1), Decimal(30)) for number in range(30)))
    region = region_of(space, " < ".join(space.names))
    assert region.repair(drawn(space, 3)).tolist() == [list(range(30))] * 3


def nearest(row: Floats, kept: list[tuple[tuple[int, ...], float]]) -> Floats:
    """Returns the point of a polytope next to `row` by sequential quadratic programming."""

    def square(point: Floats) -> float:
        return float(((point - row) ** 2).sum())

    result = minimize(
        square,
        row,
        method="SLSQP",
        bounds=[(0, 2)] * len(row),
        constraints=LinearConstraint([factors for factors, _ in kept], ub=[bound for _, bound in kept]),
        options={"ftol": 1e-14, "maxiter": 500},
    )
    return np.asarray(result.x)


factors = st.integers(-3, 3)
inequalities = st.tuples(st.tuples(*[factors] * 4).filter(any), st.integers(-2, 6).map(lambda bound: bound / 2))


@given(rows=st.lists(inequalities, min_size=1, max_size=3), seed=st.integers(0, 99))
@settings(deadline=None, max_examples=examples(40))
def test_a_projection_is_the_nearest_point_of_the_polytope(rows: list[tuple[tuple[int, ...], float]], seed: int) -> None:
    space = grids(list("abcd"), step=None)
    texts = [
        " + ".join(f"{factor}*{name}" for factor, name in zip(row, "abcd", strict=True)).replace("+ -", "- ") + f" <= {bound}"
        for row, bound in rows
        if np.count_nonzero(row) > 2  # chains are sorted instead
    ]
    if not texts:
        return
    try:
        region = region_of(space, *texts)
    except InvalidInputError:
        return
    population = drawn(space, 3, seed)
    kept = [(row, bound) for row, bound in rows if np.count_nonzero(row) > 2]
    for row, repaired in zip(population / 1e9, region.repair(population) / 1e9, strict=True):
        assert np.linalg.norm(repaired - row) <= np.linalg.norm(nearest(row, kept) - row) + 1e-6


@pytest.mark.parametrize(
    ("text", "given_values", "becomes"),
    [
        ("a <= 1.275", (2.0, 0.0), (1.275, 0.0)),
        ("a >= 1.275 and a <= 1.275", (0.1, 0.0), (1.275, 0.0)),
        ("2*a + b <= 3", (2.0, 1.0), (1.2, 0.6)),
        ("a + b == 1.3", (1.0, 1.0), (0.65, 0.65)),
        ("a <= b", (1.275, 0.3), (0.3, 1.275)),
        ("a <= 1.275 and b*b <= 0.25", (1.5, 2.0), (1.275, None)),
    ],
)
def test_a_repaired_continuous_value_is_the_exact_decimal(
    text: str, given_values: tuple[float, float], becomes: tuple[float, float | None]
) -> None:
    space = grids(["a", "b"], step=None)
    row = np.array([[round(value * 1e9) for value in given_values]])
    [repaired] = region_of(space, text).repair(row).tolist()
    for index, value in zip(repaired, becomes, strict=True):
        assert value is None or index == round(value * 1e9)


def test_a_set_on_the_way_to_an_anchor_is_the_anchor_or_far_from_it() -> None:
    """1.275 and 1.274999999 were two sets."""
    space = grids(["a", "b"], step=None)
    middle = 10**9
    constraints = Constraints(space, {"the middle": lambda values: (values["a"] == 1) & (values["b"] == 1)})
    region = constraints.region(0 * space.n_values, space.n_values - 1)
    assert region.repair(drawn(space, 50)).tolist() == [[middle, middle]] * 50


def test_few_corners_are_drawn_below_a_small_sum() -> None:
    space = grids([f"x{number}" for number in range(12)])
    rows = region_of(space, " + ".join(space.names) + " <= 2").sample(500, np.random.default_rng(5))
    assert distinct(rows) >= 450
    assert (rows == 0).mean() < 0.25  # the projection of uniform draws has more than half of its values there


def test_a_narrowed_box_is_kept() -> None:
    space = grids(CURVE)
    known: dict[str, tuple[str, ...]] = dict.fromkeys(CURVE, ())
    lower, upper = 0 * space.n_values + 20, space.n_values - 30
    region = Constraints(space, {MONOTONE: Constraint(MONOTONE, known)}).region(lower, upper)
    rows = np.concatenate([region.sample(50, np.random.default_rng(1)), region.repair(np.clip(drawn(space, 50), lower, upper))])
    assert ((rows >= lower) & (rows <= upper)).all()


def test_fixed_parameters_are_constants_of_inequalities() -> None:
    space = ParameterSpace(grids(["a", "b", "c"]).parameters, {"c": Decimal("0.5")})
    constraints = Constraints(space, {"a + b + c <= 0.6": Constraint("a + b + c <= 0.6", dict.fromkeys("abc", ()))})
    fixed = constraints.region(0 * space.n_values, space.n_values - 1)
    assert (fixed.sample(20, np.random.default_rng(1)).sum(axis=1) <= 5).all()
