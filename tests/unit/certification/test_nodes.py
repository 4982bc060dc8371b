"""What goes into a node comes out of it, and what is kept stays a trie."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.certification.nodes import BESIDE_PER_NODE, NONE, Nodes

GRID = 1 / 256
numbers = st.one_of(
    st.integers(0, 70_000).map(lambda multiple: multiple * GRID),
    st.floats(allow_nan=False).filter(lambda value: value != 0 or str(value) == "0.0"),
)


@given(st.lists(numbers, min_size=1, max_size=BESIDE_PER_NODE))
def test_features_come_back_bit_for_bit(values: list[float]) -> None:
    nodes = Nodes(len(values), 2, GRID, 4)
    features = np.array(values)
    assert nodes.describe(0, features)
    assert np.array_equal(nodes.features(0).view(np.int64), features.view(np.int64))


def test_what_is_no_number_comes_back_too() -> None:
    nodes = Nodes(3, 2, GRID, 2)
    assert nodes.describe(0, np.array([np.nan, np.inf, -1.0]))
    assert np.array_equal(nodes.features(0), [np.nan, np.inf, -1.0], equal_nan=True)


def test_multiples_of_the_grid_take_two_bytes_and_nothing_beside() -> None:
    nodes = Nodes(4, 2, GRID, 4)
    assert nodes.describe(0, np.array([0.0, GRID, 65534 * GRID, 3.5]))
    assert nodes.beside == 0
    assert nodes.describe(nodes.add(0, 1), np.array([65535 * GRID, GRID / 2, 1.0, -2.0]))
    assert nodes.beside == 3


def test_where_there_is_no_room_beside_a_node_stays_undescribed() -> None:
    nodes = Nodes(100, 2, GRID, 2)
    assert not nodes.describe(0, np.full(100, 0.1))
    assert not nodes.described[0]
    assert nodes.beside == 0


@pytest.fixture
def tree() -> Nodes:
    """0 -> 1 -> 2, 0 -> 3 -> 4, 3 -> 5."""
    nodes = Nodes(2, 8, GRID, 10)
    for parent, chosen in ((0, 7), (1, 0), (0, 2), (3, 1), (3, 5)):
        nodes.add(parent, chosen)
    for node in range(nodes.count):
        nodes.describe(node, np.array([node, 0.1 * node]))
        nodes.infeasible[node, node] = True
        nodes.leaf[node] = node
    return nodes


def test_children_are_found_by_the_decision_that_led_to_them(tree: Nodes) -> None:
    assert [tree.child(0, 7), tree.child(0, 2), tree.child(3, 5), tree.child(3, 1)] == [1, 3, 5, 4]
    assert tree.child(0, 5) == NONE
    assert tree.child(2, 0) == NONE


@pytest.mark.parametrize("wanted", [[0], [0, 1, 2], [0, 3, 5], [0, 1, 3, 4], [0, 1, 2, 3, 4, 5]])
def test_what_is_kept_is_as_it_was_under_new_numbers(tree: Nodes, wanted: list[int]) -> None:
    before = {node: tree.features(node).copy() for node in range(6)}
    kept: npt.NDArray[np.bool_] = np.isin(np.arange(6), wanted)
    number = tree.keep(kept)
    assert tree.count == len(wanted)
    assert number.tolist() == [wanted.index(node) if node in wanted else NONE for node in range(6)]
    for old in wanted:
        new = int(number[old])
        assert np.array_equal(tree.features(new), before[old])
        assert tree.infeasible[new].nonzero()[0].tolist() == [old]
        assert tree.leaf[new] == old
    edges = [(parent, chosen, child) for parent, chosen, child in ((0, 7, 1), (1, 0, 2), (0, 2, 3), (3, 1, 4), (3, 5, 5))]
    for parent, chosen, child in edges:
        if parent in wanted:
            assert tree.child(int(number[parent]), chosen) == int(number[child])
    more = tree.add(0, 6)
    assert tree.child(0, 6) == more
    assert tree.describe(more, np.array([9.0, 0.9]))
    assert np.array_equal(tree.features(int(number[wanted[-1]])), before[wanted[-1]])


def test_a_node_of_the_built_in_planner_stays_below_eight_kilobytes() -> None:
    assert Nodes(2184, 288, GRID, 100).bytes_per_node < 8192
