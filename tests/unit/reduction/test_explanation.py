"""The nearest stored set and what blocks it, held against a scan by hand and against the reference keys."""

from decimal import Decimal
from math import sqrt
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import present

from drivecal.contracts.evaluation import Explanation, Reason, Reference
from drivecal.domain.influence import EVERYWHERE, Influence, InfluenceMap
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.values import BILLION
from drivecal.reduction.explanation import CellComparison, Nearest, sentence
from drivecal.reduction.keys import ReferenceKeys

NAMES = ("P1", "P2", "P3")
RANGES = np.array([4 * BILLION, 8 * BILLION, 4 * BILLION])

bounds = st.one_of(st.none(), st.integers(0, 4).map(Decimal))
influences = st.one_of(
    st.just(EVERYWHERE),
    st.just(Influence(influential=False)),
    st.tuples(bounds, bounds)
    .filter(lambda pair: pair[0] is None or pair[1] is None or pair[0] <= pair[1])
    .map(lambda pair: Influence(influential=True, lower=pair[0], upper=pair[1])),
)
maps = st.tuples(influences, influences, influences).map(
    lambda listed: InfluenceMap({"S1": dict(zip(NAMES, listed, strict=True))}, {"P1": (Decimal(1), Decimal(3))})
)
values = st.tuples(*(st.integers(0, 4) for _ in NAMES))
tables = st.lists(values, max_size=30)


def _compare(influence_map: InfluenceMap, cell: tuple[int, ...]) -> CellComparison:
    return CellComparison(influence_map, "S1", NAMES, np.array(cell) * BILLION, RANGES)


def _stored(table: list[tuple[int, ...]]) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    return np.array(table, dtype=np.int64).reshape(len(table), len(NAMES)) * BILLION


def _set(*values: int) -> ParameterSet:
    return ParameterSet.of(dict(zip(NAMES, map(Decimal, values), strict=True)))


def _blocks(influence: Influence, one: int, other: int) -> bool:
    if not influence.influential or one == other:
        return False
    if influence.lower is not None and max(one, other) < influence.lower:
        return False
    return not (influence.upper is not None and min(one, other) > influence.upper)


def _scan(influence_map: InfluenceMap, cell: tuple[int, ...], table: list[tuple[int, ...]]) -> int:
    """The position of the nearest, by Figure 6 as it is written."""

    def order(position: int) -> tuple[int, float, int]:
        total, blocking = 0.0, 0
        for name, one, other, extent in zip(NAMES, cell, table[position], RANGES.tolist(), strict=True):
            covered = name != "P1" or 1 <= min(one, other) <= max(one, other) <= 3
            if _blocks(influence_map.influence("S1", name) if covered else EVERYWHERE, one, other):
                blocking += 1
                total += ((other - one) * BILLION / extent) ** 2
        return blocking, sqrt(total), position

    return min(range(len(table)), key=order)


@given(maps, values, tables)
def test_the_nearest_set_is_found(influence_map: InfluenceMap, cell: tuple[int, ...], table: list[tuple[int, ...]]) -> None:
    places = np.arange(len(table))[:, np.newaxis]
    result = _compare(influence_map, cell).nearest(_stored(table), places, np.arange(len(table)) + 100)
    if not table:
        assert result is None
    else:
        assert present(result).evaluation == 100 + _scan(influence_map, cell, table)


@given(maps, values, tables)
def test_equal_keys_block_nothing(influence_map: InfluenceMap, cell: tuple[int, ...], table: list[tuple[int, ...]]) -> None:
    keys = ReferenceKeys(influence_map, "S1", NAMES)
    own = keys.keys(_stored([cell]))[0]
    blocked = _compare(influence_map, cell).blocking(_stored(table)).any(axis=1).tolist()
    assert [key != own for key in keys.keys(_stored(table))] == blocked


@given(maps, values, st.lists(values, min_size=1, max_size=30), st.integers(1, 7))
def test_chunks_give_what_one_pass_gives(
    influence_map: InfluenceMap, cell: tuple[int, ...], table: list[tuple[int, ...]], size: int
) -> None:
    comparison, rows = _compare(influence_map, cell), _stored(table)
    places, ids = np.arange(len(table))[::-1, np.newaxis], np.arange(len(table))
    whole = comparison.nearest(rows, places, ids)
    parts: list[Nearest] = []
    for start in range(0, len(table), size):
        portion = slice(start, start + size)
        result = present(comparison.nearest(rows[portion], places[portion], ids[portion]))
        parts.append(result)
    assert min(parts) == whole


def test_a_difference_names_both_values_and_the_regions_in_which_they_lie() -> None:
    limited = Influence(influential=True, lower=Decimal("1.5"), upper=Decimal(3))
    influence_map = InfluenceMap({"S1": {"P1": limited, "P2": Influence(influential=False)}})
    comparison = _compare(influence_map, (0, 1, 2))
    first, second = comparison.differences(_set(0, 1, 2), _set(1, 4, 2))
    assert (first.parameter, first.region, first.reference_region, first.blocks) == ("P1", "below", "below", False)
    assert (second.parameter, second.region, second.blocks) == ("P2", "anywhere", False)
    assert (first.value, first.reference_value, first.lower, first.upper) == (0.0, 1.0, 1.5, 3.0)
    crossing, third = comparison.differences(_set(0, 1, 2), _set(4, 1, 0))
    assert (crossing.region, crossing.reference_region, crossing.blocks) == ("below", "above", True)
    assert (third.parameter, third.region, third.blocks) == ("P3", "influential", True)


def test_of_values_outside_its_space_the_map_says_nothing() -> None:
    influence_map = InfluenceMap({"S1": {"P1": Influence(influential=False)}}, {"P1": (Decimal(1), Decimal(3))})
    [difference] = _compare(influence_map, (2, 0, 0)).differences(_set(2, 0, 0), _set(4, 0, 0))
    assert (difference.region, difference.reference_region, difference.blocks) == ("anywhere", "outside", True)


@pytest.mark.parametrize("reason", get_args(Reason))
@pytest.mark.parametrize("deleted", [False, True])
def test_each_reason_is_a_sentence_that_names_the_stored_evaluation(reason: Reason, deleted: bool) -> None:
    donor = Reference(evaluation=17, campaign="c", stage="calibration", iteration=2, individual=5, score=4, failure=None)
    explanation = Explanation(
        evaluation=99, campaign="c", stage="calibration", iteration=3, individual=0, scenario="S1", outcome="simulated",
        score=4, failure=None, reason=reason, sentence="", reference=None if deleted else donor, stored=3,
    )  # fmt: skip
    text = sentence(explanation)
    assert text.endswith(".")
    assert ("evaluation 17" in text) == (not deleted and reason in {"repeated", "reused", "checked", "simulated"})
