"""Nodes return what was stored in them, and remain a trie when some are forgotten."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.highway.certification.kernels import NONE, contenders, digest
from drivecal.highway.certification.nodes import Nodes

GRID = 1 / 256
numbers = st.one_of(
    st.integers(0, 70_000).map(lambda multiple: multiple * GRID),
    st.floats(allow_nan=False).filter(lambda value: value != 0 or str(value) == "0.0"),
)


FEASIBLE: npt.NDArray[np.bool_] = np.zeros(40, dtype=np.bool_)


def describe(nodes: Nodes, node: int, features: npt.NDArray[np.float64]) -> None:
    nodes.describe(node, np.arange(len(features)), features, FEASIBLE)


def nodes_for(n_values: int) -> Nodes:
    return Nodes(n_values, 40, GRID)


@given(st.integers(1, 5).flatmap(lambda k: st.lists(st.lists(numbers, min_size=k, max_size=k), min_size=1, max_size=8)))
def test_features_come_back_bit_for_bit(rows: list[list[float]]) -> None:
    features = np.array(rows)
    nodes = nodes_for(features.shape[1])
    describe(nodes, 0, features)
    candidates, infeasible, stored = nodes.contenders(0)
    assert not infeasible.any()
    assert np.array_equal(stored.view(np.int64), features.view(np.int64))
    assert candidates.tolist() == list(range(len(rows)))


def test_values_that_are_not_finite_come_back_too() -> None:
    nodes = nodes_for(3)
    describe(nodes, 0, np.array([[np.nan, np.inf, -1.0]]))
    assert np.array_equal(nodes.contenders(0)[2], [[np.nan, np.inf, -1.0]], equal_nan=True)


def test_a_difference_of_nan_excludes_no_candidate() -> None:
    features = np.array([[0.0, 0.0], [9.0, 9.0], [np.nan, 9.0]])
    infeasible = np.zeros(3, dtype=np.bool_)
    assert contenders(features, np.ones(2), np.full(2, 2.0), infeasible, 0, 4, 1e-6).tolist() == [0, 2]


def test_multiples_of_the_grid_take_two_bytes_and_nothing_beside() -> None:
    nodes = nodes_for(4)
    describe(nodes, 0, np.array([[0.0, GRID, 65534 * GRID, 3.5]]))
    assert nodes.beside == 0
    end, _ = nodes.extend([1], np.zeros((1, 3)))
    describe(nodes, end, np.array([[65535 * GRID, GRID / 2, 1.0, -2.0]]))
    assert nodes.beside == 3


def test_more_candidates_than_can_be_numbered_are_refused() -> None:
    with pytest.raises(ValueError, match="32769"):
        Nodes(2, 32_769, GRID)


@pytest.fixture
def tree() -> Nodes:
    """0 -> 1 -> 2, 0 -> 3 -> 4, 3 -> 5; three runs."""
    nodes = Nodes(2, 8, GRID)
    for decisions, states in (([7, 0], [0, 1]), ([2, 1], [0, 3]), ([2, 5], [0, 3])):
        assert nodes.extend(decisions, state_of(states))[1] is None
    for node in range(nodes.count):
        nodes.leaf[node] = node
    return nodes


def state_of(nodes: list[int]) -> npt.NDArray[np.float64]:
    return np.array([[node, -0.5 * node, 1.0] for node in nodes])


@pytest.fixture
def described(tree: Nodes) -> Nodes:
    for node in range(tree.count):
        features = np.array([[node, 0.1 * node], [9.0, 0.3]])
        tree.describe(node, np.array([1, node + 2]), features, np.arange(8) == node + 2)
    return tree


def test_children_are_found_by_the_decision_that_led_to_them(tree: Nodes) -> None:
    assert [tree.child(0, 7), tree.child(0, 2), tree.child(3, 5), tree.child(3, 1)] == [1, 3, 5, 4]
    assert tree.child(0, 5) == NONE
    assert tree.child(2, 0) == NONE


@pytest.mark.parametrize("wanted", [[0], [0, 1, 2], [0, 3, 5], [0, 1, 3, 4], [0, 1, 2, 3, 4, 5]])
def test_what_is_kept_is_as_it_was_under_new_numbers(described: Nodes, wanted: list[int]) -> None:
    tree = described
    digests = tree.digest.copy()
    before = {node: tree.contenders(node)[2] for node in range(6)}
    kept: npt.NDArray[np.bool_] = np.isin(np.arange(6), wanted)
    tree.keep(kept)
    number = [wanted.index(node) if node in wanted else NONE for node in range(6)]
    assert tree.count == len(wanted)
    assert tree.rows == 2 * len(wanted)
    for old in wanted:
        new = number[old]
        candidates, infeasible, features = tree.contenders(new)
        assert np.array_equal(features, before[old])
        assert candidates.tolist() == [1, old + 2]
        assert tree.digest[new] == digests[old]
        assert infeasible.tolist() == [False, True]
        assert tree.infeasible(new).nonzero()[0].tolist() == [old + 2]
        assert tree.leaf[new] == old
    edges = [(parent, chosen, child) for parent, chosen, child in ((0, 7, 1), (1, 0, 2), (0, 2, 3), (3, 1, 4), (3, 5, 5))]
    for parent, chosen, child in edges:
        if parent in wanted:
            assert tree.child(number[parent], chosen) == number[child]
    more, _ = tree.extend([6], state_of([0]))
    assert tree.child(0, 6) == more
    describe(tree, more, np.array([[9.0, 0.9]]))
    assert np.array_equal(tree.contenders(number[wanted[-1]])[2], before[wanted[-1]])


def test_a_state_that_is_described_again_is_kept_as_it_is_then(described: Nodes) -> None:
    tree = described
    describe(tree, 3, np.array([[5.0, 0.7], [6.0, 0.8], [7.0, 0.9]]))
    tree.keep(np.ones(6, dtype=np.bool_))
    assert tree.contenders(3)[2].tolist() == [[5.0, 0.7], [6.0, 0.8], [7.0, 0.9]]
    assert tree.contenders(4)[2].tolist() == [[4.0, 0.4], [9.0, 0.3]]
    assert tree.rows == 5 * 2 + 3


def test_a_state_is_kept_until_it_is_described(tree: Nodes) -> None:
    assert tree.states[tree.state[[0, 1, 3]]].tolist() == state_of([0, 1, 3]).tolist()
    assert tree.state[[2, 4, 5]].tolist() == [NONE] * 3  # runs ended there
    used = tree.bytes
    describe(tree, 1, np.array([[9.0, 0.9]]))
    assert tree.state[1] == NONE
    tree.extend([7, 3, 3], np.vstack([state_of([0, 1]), [[5.0, 5.0, 5.0]]]))
    assert tree.states[tree.state[[0, 3, 6]]].tolist() == [*state_of([0, 3]).tolist(), [5.0] * 3]
    assert tree.state_rows == 3  # one of them was freed by the description
    assert tree.bytes > used


def test_states_that_are_kept_are_so_under_new_numbers(tree: Nodes) -> None:
    describe(tree, 0, np.array([[9.0, 0.9]]))
    tree.keep(np.isin(np.arange(6), [0, 3, 5]))
    assert tree.state.tolist() == [NONE, 0, NONE]
    assert tree.states.tolist() == state_of([3]).tolist()
    assert tree.extend([2, 6, 1], np.vstack([state_of([0, 3]), [[4.0, 4.0, 4.0]]])) == (4, None)
    assert tree.states[tree.state[3]].tolist() == [4.0] * 3


def test_the_same_decisions_in_another_state_are_reported_and_add_nothing(tree: Nodes) -> None:
    used = tree.bytes
    assert tree.extend([2, 1, 1], state_of([0, 2, 4])) == (3, 1)
    assert tree.extend([7], np.array([[-0.0, 0.0, 1.0]])) == (0, 0)
    assert tree.bytes == used
    assert tree.extend([2, 1], state_of([0, 3])) == (4, None)


def test_every_number_of_a_state_counts() -> None:
    states = np.zeros((24, 23))
    states[np.arange(23), np.arange(23)] = 1e-300
    digests = np.zeros(24, dtype=np.int64)
    digest(states, digests)
    assert len(set(digests.tolist())) == 24
    assert (digests > 0).all()
