"""The common reduction: the smallest box that holds all influential bounds, on the places of the space's own grid."""

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.domain.influence import EVERYWHERE, Influence, InfluenceMap
from drivecal.domain.parameters import Indices, Parameter, ParameterSpace
from drivecal.reduction.keys import ReferenceKeys, billionths_matrix
from drivecal.reduction.narrowing import SearchArea, WholeSpace, begun_area, common_area, full_area

SCENARIOS = ("S1", "S2")
SPACE = ParameterSpace(
    (
        Parameter.from_step("P1", Decimal(0), Decimal(10), Decimal(1)),
        Parameter.from_step("P2", Decimal(0), Decimal(1), Decimal("0.1")),
        Parameter.from_bits("P3", Decimal(0), Decimal(1), 3),
        Parameter.from_step("P4", Decimal(-2), Decimal(2), Decimal(1)),
    ),
    {"P4": Decimal(1)},
)
NOTHING = Influence(influential=False)


def _between(lower: str | None, upper: str | None) -> Influence:
    return Influence(True, None if lower is None else Decimal(lower), None if upper is None else Decimal(upper))


def _given(*rows: tuple[int, ...]) -> Indices:
    return np.array(rows, dtype=np.int64).reshape(len(rows), 3)


def _area(first: dict[str, Influence], second: dict[str, Influence], *rows: tuple[int, ...]) -> SearchArea:
    return common_area(SPACE, InfluenceMap({"S1": first, "S2": second}), SCENARIOS, _given(*rows))


def test_the_area_is_the_union_of_the_influential_bounds_of_all_scenarios() -> None:
    area = _area(
        {"P1": _between("2", "5"), "P2": NOTHING, "P3": _between(None, "0.428571429")},
        {"P1": _between("4", "7"), "P2": _between("0.3", None), "P3": _between(None, "0.285714286")},
    )
    assert (area.first.tolist(), area.last.tolist()) == ([2, 3, 0], [7, 10, 3])
    assert area.n_values.tolist() == [6, 8, 4]
    assert [(item.parameter, item.lower, item.upper, item.removed_values) for item in area.narrowed()] == [
        ("P1", 2.0, 7.0, 5),
        ("P2", 0.3, 1.0, 3),
        ("P3", 0.0, 0.428571429, 4),
    ]
    assert area.note().startswith("the search space was narrowed to 0.198 of its sets: P1 from 2 to 7, P2 from 0.3 to 1, P3")


def test_what_a_map_does_not_list_is_searched_everywhere() -> None:
    area = _area({"P1": _between("2", "5")}, {})
    assert area.narrowed() == []
    assert area.whole is WholeSpace.ALL_INFLUENTIAL
    assert area.note().endswith(area.whole)


def test_given_sets_widen_the_area_so_that_they_lie_in_it() -> None:
    influences = {"P1": _between("2", "5"), "P2": NOTHING, "P3": EVERYWHERE}
    area = _area(influences, influences, (9, 4, 0), (3, 6, 0))
    assert (area.first.tolist(), area.last.tolist()) == ([2, 4, 0], [9, 6, 7])
    assert area.contract(_given((9, 4, 0), (3, 6, 0))).tolist() == [[7, 0, 0], [1, 2, 0]]


def test_parameters_that_a_constraint_names_keep_their_full_range() -> None:
    influences = {"P1": _between("2", "5"), "P2": NOTHING, "P3": _between(None, "0.5")}
    influence_map = InfluenceMap({"S1": influences, "S2": influences})
    area = common_area(SPACE, influence_map, SCENARIOS, _given(), {"P1", "P2"})
    assert (area.first.tolist(), area.last.tolist()) == ([0, 0, 0], [10, 10, 4])
    area = common_area(SPACE, influence_map, SCENARIOS, _given(), SPACE.names)
    assert (area.narrowed(), area.whole) == ([], WholeSpace.CONSTRAINED)


@pytest.mark.parametrize(
    ("influence", "expected"),
    [
        (_between("2.4", "2.6"), (2, 3)),  # between two values, which it may tell apart
        (_between("-5", "-1"), (5, 5)),  # below the range: all values lie above the bounds
        (_between("11", None), (5, 5)),
        (_between("2.5", None), (2, 10)),  # 2 answers for all below
        (_between("-3", "4.9"), (0, 5)),
    ],
)
def test_bounds_between_two_values_keep_the_next_value_outside(influence: Influence, expected: tuple[int, int]) -> None:
    area = _area({"P1": influence}, {"P1": NOTHING})
    assert (area.first[0], area.last[0]) == expected


@pytest.mark.parametrize(
    ("influence", "expected"),
    [
        (_between("5", "10"), (4, 10)),
        (_between("0", "5"), (0, 6)),
        (_between("3", "5"), (2, 6)),
        (_between("2.5", None), (2, 10)),
        (NOTHING, (5, 5)),
    ],
)
def test_bounds_that_are_influential_themselves_keep_a_value_of_each_cut_region(
    influence: Influence, expected: tuple[int, int]
) -> None:
    influences = {"P1": influence, "P2": EVERYWHERE}
    posted = InfluenceMap({"S1": influences, "S2": influences}, shares_bounds=False)
    area = common_area(SPACE, posted, SCENARIOS, _given())
    assert (area.first[0], area.last[0]) == expected
    keys = ReferenceKeys(posted, "S1", SPACE.names).keys(
        billionths_matrix(SPACE.parameter_sets(_given(*((i, 0, 0) for i in range(11)))))
    )
    assert set(keys) == set(keys[expected[0] : expected[1] + 1])


def test_a_begun_search_keeps_its_area() -> None:
    area = _area({"P1": _between("2", "5"), "P2": NOTHING}, {"P1": _between("4", "7"), "P2": _between("0.3", None)})
    for other in (full_area(SPACE), _area({"P1": NOTHING}, {"P1": NOTHING})):
        begun = begun_area(other, area.narrowed())
        assert (begun.first.tolist(), begun.last.tolist()) == (area.first.tolist(), area.last.tolist())


bounds = st.tuples(st.integers(0, 10), st.integers(0, 10)).map(sorted)
influences = st.one_of(st.just(NOTHING), st.just(EVERYWHERE), bounds.map(lambda pair: _between(str(pair[0]), str(pair[1]))))


@given(influences, influences, st.integers(0, 10))
def test_every_set_outside_has_its_value_in_a_region_that_influences_no_scenario(
    first: Influence, second: Influence, index: int
) -> None:
    """The value next to it, inside, has the same reference key but for the bound itself, which the cut region shares."""
    area = _area({"P1": first}, {"P1": second})
    low, high = int(area.first[0]), int(area.last[0])
    if low <= index <= high or low == high:
        return
    outermost = 0 if index < low else 10
    influence_map = InfluenceMap({"S1": {"P1": first}, "S2": {"P1": second}})
    sets = SPACE.parameter_sets(_given((index, 0, 0), (outermost, 0, 0)))
    for scenario in SCENARIOS:
        keys = ReferenceKeys(influence_map, scenario, SPACE.names).keys(billionths_matrix(sets))
        assert keys[0] == keys[1]


@given(influences, influences, st.lists(st.tuples(st.integers(0, 10), st.integers(0, 10), st.integers(0, 7)), max_size=3))
def test_contracting_and_expanding_given_sets_gives_them_back(
    first: Influence, second: Influence, rows: list[tuple[int, ...]]
) -> None:
    area = _area({"P1": first, "P2": NOTHING}, {"P1": second, "P2": NOTHING}, *rows)
    assert area.expand(area.contract(_given(*rows))).tolist() == [list(row) for row in rows]
