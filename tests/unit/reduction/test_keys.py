"""The reference key says the same as a scan of the whole table by Figure 6, which is kept here as the oracle."""

import random
from collections.abc import Sequence
from decimal import Decimal

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from tests.support.effort import tries

from drivecal.domain.influence import Influence, InfluenceMap
from drivecal.domain.parameters import ParameterSet
from drivecal.reduction.keys import ReferenceKeys, billionths_matrix


def is_valid_reference(stored: ParameterSet, new: ParameterSet, influence_map: InfluenceMap, scenario: str) -> bool:
    """Returns whether `stored` may answer `new`: every parameter is equal, without influence, or in the same non-influential region."""
    for name, value in new.values.items():
        influence = influence_map.influence(scenario, name)
        other = stored.values[name]
        if isinstance(value, str) or isinstance(other, str):
            analysed = {value, other} <= influence_map.choices.get(name, frozenset())
            if not (other == value or (analysed and not influence.influential)):
                return False
            continue
        below = influence.lower is not None and value < influence.lower and other < influence.lower
        above = influence.upper is not None and value > influence.upper and other > influence.upper
        lowest, highest = influence_map.ranges.get(name, (min(value, other), max(value, other)))
        covered = lowest <= min(value, other) and max(value, other) <= highest
        if not (other == value or (covered and (not influence.influential or below or above))):
            return False
    return True


def scan(table: Sequence[ParameterSet], new: ParameterSet, influence_map: InfluenceMap, scenario: str) -> int | None:
    """The position of the first valid reference in the table, or None."""
    for position, stored in enumerate(table):
        if is_valid_reference(stored, new, influence_map, scenario):
            return position
    return None


def _random_case(draw: random.Random) -> tuple[InfluenceMap, list[ParameterSet], ParameterSet]:
    names = [f"P{i}" for i in range(1, draw.randint(1, 11) + 1)]
    step = Decimal(draw.choice(["0.1", "1", "0.25"]))
    size = draw.randint(2, 6)
    influences = {}
    for name in names:
        low, high = sorted((draw.randrange(size), draw.randrange(size)))
        lower = draw.choice([None, low * step])
        upper = draw.choice([None, high * step])
        influences[name] = Influence(draw.random() < 0.7, lower, upper)

    def parameter_set() -> ParameterSet:
        return ParameterSet.of({name: draw.randrange(size) * step for name in names})

    table = [parameter_set() for _ in range(draw.randint(0, 30))]
    ranges = {name: (step, (size - 2) * step) for name in names if draw.random() < 0.3}
    return InfluenceMap({"S1": influences}, ranges), table, parameter_set()


TABLES = tries(800, 10_000)


def test_the_keyed_look_up_agrees_with_the_naive_scan_on_random_tables() -> None:
    draw = random.Random(6)
    hits = 0
    for _ in range(TABLES):
        influence_map, table, new = _random_case(draw)
        keys = ReferenceKeys(influence_map, "S1", new.names)
        stored: dict[bytes, int] = {}
        for position, key in enumerate(keys.keys(billionths_matrix(table)) if table else []):
            stored.setdefault(key, position)
        result = stored.get(keys.keys(billionths_matrix([new]))[0])
        assert result == scan(table, new, influence_map, "S1")
        hits += result is not None
    assert 0.1 * TABLES < hits < 0.9 * TABLES, "the cases must hold both hits and misses"


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
