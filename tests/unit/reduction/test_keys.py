"""Order, scenario and unknown parameters in reference keys. `test_explanation` holds the rest against a scan by Figure 6."""

from decimal import Decimal

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivecal.domain.influence import Influence, InfluenceMap
from drivecal.reduction.keys import ReferenceKeys


def test_a_parameter_of_which_the_map_says_nothing_is_influential_everywhere() -> None:
    one, other = ReferenceKeys(InfluenceMap({}), "S1", ["P1"]).keys(np.array([[1], [2]]))
    assert one != other


@given(st.permutations(["P1", "P2", "P10"]), st.lists(st.integers(-5, 5), min_size=3, max_size=3))
def test_the_key_does_not_depend_on_the_order_of_the_parameters(order: list[str], values: list[int]) -> None:
    by_name = dict(zip(["P1", "P2", "P10"], values, strict=True))
    influence_map = InfluenceMap({"S1": {"P2": Influence(influential=True, lower=Decimal(0))}})
    expected = ReferenceKeys(influence_map, "S1", ["P1", "P2", "P10"]).keys(np.array([values]))
    shuffled = ReferenceKeys(influence_map, "S1", order).keys(np.array([[by_name[name] for name in order]]))
    assert shuffled == expected


def test_scenarios_do_not_share_keys() -> None:
    values = np.array([[1]])
    assert ReferenceKeys(InfluenceMap({}), "S1", ["P1"]).keys(values) != ReferenceKeys(InfluenceMap({}), "S2", ["P1"]).keys(
        values
    )
