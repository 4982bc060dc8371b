"""Validations use the regions of the reference keys; histograms are limited and agree with R_err."""

from dataclasses import replace
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import COST

from drivecal.analysis.validation import compared, design
from drivecal.campaigns.stages.validation import reducible_space
from drivecal.domain.constraints import Constraints
from drivecal.domain.influence import Influence, InfluenceMap
from drivecal.domain.parameters import Parameter, ParameterSpace
from drivecal.domain.scales import COMFORT, Scale
from drivecal.reduction.keys import ReferenceKeys, billionths_matrix

BOUNDS = [None, *(Decimal(value) for value in ("-1", "0", "0.25", "0.5", "0.75", "0.9", "2"))]
influences = st.builds(Influence, st.booleans(), st.sampled_from(BOUNDS), st.sampled_from(BOUNDS)).filter(
    lambda given: given.lower is None or given.upper is None or given.lower <= given.upper
)
ranges = st.none() | st.tuples(st.sampled_from(BOUNDS[1:5]), st.sampled_from(BOUNDS[4:]))
MODES = ["eco", "sport", "winter", "tow"]


@given(
    influences, ranges, influences.map(lambda given: Influence(given.influential)), st.sets(st.sampled_from(MODES)), st.data()
)
def test_values_of_a_region_are_those_of_one_key(
    influence: Influence, limits: tuple[Decimal, Decimal] | None, mode: Influence, analysed: set[str], data: st.DataObject
) -> None:
    space = ParameterSpace((Parameter.from_step("a", Decimal(0), Decimal(1), Decimal("0.05")), Parameter.choice("mode", MODES)))
    influence_map = InfluenceMap(
        {"S1": {"a": influence, "mode": mode}},
        {} if limits is None else {"a": limits},
        {"mode": frozenset(analysed)} if data.draw(st.booleans()) else {},
    )
    keys = ReferenceKeys(influence_map, "S1", space.names)
    reducible = reducible_space(influence_map, "S1", space)
    for column, n in enumerate(space.n_values.tolist()):
        points = np.zeros((n, 2), dtype=np.int64)
        points[:, column] = np.arange(n)
        classes = keys.keys(billionths_matrix(space.parameter_sets(points)))
        several = [classes.count(key) > 1 for key in classes]
        assert reducible.variable(points)[:, column].tolist() == several
        for index in np.flatnonzero(several).tolist():
            variant = reducible.variant(points[index], np.array([column]), np.random.default_rng(index))
            assert variant[column] != index
            assert classes[variant[column]] == classes[index]


def test_a_continuous_parameter_is_validated_without_a_table_and_within_constraints() -> None:
    space = ParameterSpace(tuple(Parameter.from_step(name, Decimal(-1000000), Decimal(1000000), None) for name in "ab"))
    lower = Influence(influential=True, lower=Decimal(500_000))
    influence_map = InfluenceMap({"S1": {"a": lower, "b": Influence(influential=False)}})
    constraints = Constraints(space, {"a <= b": lambda values: values["a"] <= values["b"]})
    made = design(reducible_space(influence_map, "S1", space), 20, 3, 1, 400, constraints)
    assert made is not None
    assert (made.bases[:, 0] <= made.bases[:, 1]).all()
    moved = made.variants[..., 0] != made.bases[:, None, 0]
    assert moved.any()
    assert (made.variants[..., 0][moved] < space.searched[0].first_from(500_000 * 10**9)).all()


SCALES = [COMFORT, COST, *(replace(COST, tolerance=tolerance) for tolerance in (0.0, 1e-9, 0.3, 0.5, 3.0, 70.0))]


@pytest.mark.parametrize("scale", SCALES)
def test_a_bar_is_wrong_exactly_if_its_differences_are(scale: Scale) -> None:
    drawn = np.random.default_rng(3).uniform(-2, 2, 2_000) * scale.span
    near = np.array([-1, 1])[:, None] * (scale.tolerance + np.array([-1e-3, -1e-12, 0, 1e-12, 1e-5, 1e-3]) * scale.span)
    differences = np.concatenate([drawn, near.ravel(), [0.0]])
    if scale.step is not None:
        differences = np.rint(differences)
    row = compared(differences, scale)
    bars = {int(number): count for number, count in row["histogram"].items()}
    assert sum(bars.values()) == row["compared"]
    assert sum(count for number, count in bars.items() if scale.is_wrong(number * row["histogram_step"])) == row["wrong"]


@pytest.mark.parametrize("scale", SCALES)
def test_differences_beyond_the_span_share_a_bar(scale: Scale) -> None:
    row = compared(np.array([-1e300, -1e15, 0.0, 3 * scale.span + 9 * scale.tolerance, 1e18, np.inf]), scale)
    last = scale.last_bar + 1
    assert row["histogram"] == {str(-last): 2, "0": 1, str(last): 3}
    assert last <= 101
