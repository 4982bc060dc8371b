"""Choices in reference keys, comparisons, common areas and features: by their text, whatever the list."""

from decimal import Decimal

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivecal.domain.influence import Influence, InfluenceMap
from drivecal.domain.parameters import Parameter, ParameterSet, ParameterSpace
from drivecal.reduction.explanation import CellComparison
from drivecal.reduction.keys import ReferenceKeys, billionths_matrix
from drivecal.reduction.prediction import FeatureSpace
from drivecal.storage.references.parameter_sets import parse

MODES = ["eco", "sport", "winter", "tow"]
FREE = Influence(influential=False)
MATTERS = Influence(influential=True)
SPACE = ParameterSpace((Parameter.choice("mode", MODES), Parameter.from_step("P", Decimal(0), Decimal(1), None)))


def made(mode: str, number: str = "0.5") -> ParameterSet:
    return ParameterSet.of({"mode": mode, "P": Decimal(number)})


def keys_of(influence: Influence, analysed: set[str], sets: list[ParameterSet]) -> list[bytes]:
    influence_map = InfluenceMap({"S1": {"mode": influence}}, {}, {"mode": frozenset(analysed)})
    return ReferenceKeys(influence_map, "S1", ("mode", "P")).keys(billionths_matrix(sets))


def test_choices_answer_for_each_other_where_the_map_knows_that_they_do_not_matter() -> None:
    sets = [made(mode) for mode in MODES]
    assert len(set(keys_of(MATTERS, set(MODES), sets))) == 4
    assert len(set(keys_of(FREE, set(MODES), sets))) == 1
    eco, sport, winter, tow = keys_of(FREE, {"eco", "sport"}, sets)
    assert eco == sport
    assert len({eco, winter, tow}) == 3


@given(st.lists(st.tuples(st.sampled_from(MODES) | st.integers(-(10**15), 10**15), st.booleans()), min_size=1, max_size=6))
def test_stored_sets_read_in_bulk_have_the_codes_of_their_values_in_any_order(values: list[tuple[int | str, bool]]) -> None:
    orders = [(("mode", "P"), (value, 5)) if first else (("P", "mode"), (5, value)) for value, first in values]
    sets = [ParameterSet(*order) for order in orders]
    codes_of: dict[int, list[int]] = {}
    for names, positions, codes in parse([each.to_json() for each in sets]):
        assert {sets[position].names for position in positions} == {names}
        codes_of |= dict(zip(positions, codes.tolist(), strict=True))
    assert codes_of == dict(enumerate(list(each.codes) for each in sets))


def test_another_choice_blocks_unless_it_does_not_matter_and_is_a_whole_range_away() -> None:
    stored = billionths_matrix([made("sport"), made("eco", "0.75"), made("tow")])
    for influence, blocked in ((MATTERS, [True, False, True]), (FREE, [False, False, True])):
        influence_map = InfluenceMap({"S1": {"mode": influence}}, {}, {"mode": frozenset({"eco", "sport"})})
        beside = CellComparison(influence_map, "S1", ("mode", "P"), np.array(made("eco").codes), np.array([3 * 10**9, 10**9]))
        blocking = beside.blocking(stored)
        assert blocking[:, 0].tolist() == blocked
        assert beside.distances(stored, np.ones_like(blocking)).tolist() == [1.0, 0.25, 1.0]
        (difference,) = beside.differences(made("eco"), made("tow"))
        assert (difference.parameter, difference.reference_region) == ("mode", "outside")


def test_features_and_places_are_positions_in_the_campaigns_list() -> None:
    sets = [made("eco", "0.25"), made("tow", "1"), ParameterSet.of({"P": Decimal(0), "mode": "winter"})]
    expected = [[0.0, 0.25], [1.0, 1.0], [2 / 3, 0.0]]
    assert FeatureSpace(SPACE, ("mode", "P"))(sets).tolist() == expected
    assert FeatureSpace(SPACE)(sets).tolist() == expected
    held = ParameterSpace(SPACE.parameters, {"mode": "tow"})
    assert FeatureSpace(held, ("mode", "P"))([made("tow", "0.25")])[0, 1] == 0.25
