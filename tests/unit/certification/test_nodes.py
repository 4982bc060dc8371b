"""What goes into a node comes out of it, and what is kept stays a trie."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.certification.nodes import NONE, Nodes

GRID = 1 / 256
numbers = st.one_of(
    st.integers(0, 70_000).map(lambda multiple: multiple * GRID),
    st.floats(allow_nan=False).filter(lambda value: value != 0 or str(value) == "0.0"),
)


def describe(nodes: Nodes, node: int, features: npt.NDArray[np.float64]) -> bool:
    return nodes.describe(node, np.arange(len(features)), features, digest=7)


def room_for(n_values: int) -> Nodes:
    return Nodes(n_values, 40, GRID, 4)


@given(st.integers(1, 5).flatmap(lambda k: st.lists(st.lists(numbers, min_size=k, max_size=k), min_size=1, max_size=8)))
def test_features_come_back_bit_for_bit(rows: list[list[float]]) -> None:
    features = np.array(rows)
    nodes = room_for(features.shape[1])
    assert describe(nodes, 0, features)
    candidates, found = nodes.contenders(0)
    assert np.array_equal(found.view(np.int64), features.view(np.int64))
    assert candidates.tolist() == list(range(len(rows)))


def test_what_is_no_number_comes_back_too() -> None:
    nodes = room_for(3)
    assert describe(nodes, 0, np.array([[np.nan, np.inf, -1.0]]))
    assert np.array_equal(nodes.contenders(0)[1], [[np.nan, np.inf, -1.0]], equal_nan=True)


def test_multiples_of_the_grid_take_two_bytes_and_nothing_beside() -> None:
    nodes = room_for(4)
    assert describe(nodes, 0, np.array([[0.0, GRID, 65534 * GRID, 3.5]]))
    assert nodes.beside == 0
    assert describe(nodes, nodes.add(0, 1), np.array([[65535 * GRID, GRID / 2, 1.0, -2.0]]))
    assert nodes.beside == 3


def test_where_there_is_no_room_a_node_stays_undescribed() -> None:
    nodes = Nodes(100, 2, GRID, 1)
    assert not describe(nodes, 0, np.full((1, 100), 0.1))
    assert not describe(nodes, 0, np.ones((100, 100)))
    assert nodes.row_count[0] == 0
    assert (nodes.beside, nodes.rows) == (0, 0)


@pytest.fixture
def tree() -> Nodes:
    """0 -> 1 -> 2, 0 -> 3 -> 4, 3 -> 5."""
    nodes = Nodes(2, 8, GRID, 10)
    for parent, chosen in ((0, 7), (1, 0), (0, 2), (3, 1), (3, 5)):
        nodes.add(parent, chosen)
    for node in range(nodes.count):
        nodes.describe(node, np.array([1, node + 2]), np.array([[node, 0.1 * node], [9.0, 0.3]]), digest=100 + node)
        nodes.infeasible[node, node] = True
        nodes.leaf[node] = node
    return nodes


def test_children_are_found_by_the_decision_that_led_to_them(tree: Nodes) -> None:
    assert [tree.child(0, 7), tree.child(0, 2), tree.child(3, 5), tree.child(3, 1)] == [1, 3, 5, 4]
    assert tree.child(0, 5) == NONE
    assert tree.child(2, 0) == NONE


@pytest.mark.parametrize("wanted", [[0], [0, 1, 2], [0, 3, 5], [0, 1, 3, 4], [0, 1, 2, 3, 4, 5]])
def test_what_is_kept_is_as_it_was_under_new_numbers(tree: Nodes, wanted: list[int]) -> None:
    before = {node: tree.contenders(node)[1] for node in range(6)}
    kept: npt.NDArray[np.bool_] = np.isin(np.arange(6), wanted)
    number = tree.keep(kept)
    assert tree.count == len(wanted)
    assert number.tolist() == [wanted.index(node) if node in wanted else NONE for node in range(6)]
    for old in wanted:
        new = int(number[old])
        candidates, features = tree.contenders(new)
        assert np.array_equal(features, before[old])
        assert candidates.tolist() == [1, old + 2]
        assert tree.digest[new] == 100 + old
        assert tree.infeasible[new].nonzero()[0].tolist() == [old]
        assert tree.leaf[new] == old
    edges = [(parent, chosen, child) for parent, chosen, child in ((0, 7, 1), (1, 0, 2), (0, 2, 3), (3, 1, 4), (3, 5, 5))]
    for parent, chosen, child in edges:
        if parent in wanted:
            assert tree.child(int(number[parent]), chosen) == int(number[child])
    more = tree.add(0, 6)
    assert tree.child(0, 6) == more
    assert describe(tree, more, np.array([[9.0, 0.9]]))
    assert np.array_equal(tree.contenders(int(number[wanted[-1]]))[1], before[wanted[-1]])


def test_a_state_that_is_described_again_is_kept_as_it_is_then(tree: Nodes) -> None:
    assert describe(tree, 3, np.array([[5.0, 0.7], [6.0, 0.8], [7.0, 0.9]]))
    tree.keep(np.ones(6, dtype=np.bool_))
    assert tree.contenders(3)[1].tolist() == [[5.0, 0.7], [6.0, 0.8], [7.0, 0.9]]
    assert tree.contenders(4)[1].tolist() == [[4.0, 0.4], [9.0, 0.3]]
    assert tree.rows == 5 * 2 + 3
