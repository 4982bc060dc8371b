"""On which nodes workers are started."""

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from drivecal.cluster.members import Node
from drivecal.execution.ray.placement import complaint, missing

OURS = "1.0"


def node(identifier: str, cpus: int, version: str | None = OURS) -> Node:
    return Node(f"node-{identifier}", identifier, cpus, version, is_head=False)


clusters = st.lists(
    st.builds(node, st.uuids().map(str), st.integers(0, 5), st.sampled_from([OURS, None, "0.9"])),
    max_size=6,
    unique_by=lambda one: one.id,
)


@given(clusters, st.none() | st.integers(0, 20))
def test_workers_fill_the_nodes_of_this_version_and_no_more(nodes: list[Node], most: int | None) -> None:
    result = missing(nodes, [], most, OURS)
    room = {item.id: item.cpus for item in nodes if item.version in {OURS, None}}
    count = Counter(entry.id for entry in result)
    assert all(number <= room.get(identifier, 0) for identifier, number in count.items())
    assert len(result) == min(sum(room.values()), sum(room.values()) if most is None else most)
    assert missing(nodes, [element.id for element in result], most, OURS) == []


def test_few_workers_are_spread_over_many_nodes() -> None:
    nodes = [node("a", 4), node("b", 4), node("c", 1)]
    assert [item.id for item in missing(nodes, [], 4, OURS)] == ["a", "b", "c", "a"]
    assert [entry.id for entry in missing(nodes, ["a", "a"], 4, OURS)] == ["b", "c"]


def test_workers_of_nodes_that_are_gone_count_no_more() -> None:
    assert [item.id for item in missing([node("a", 1)], ["gone", "gone"], 2, OURS)] == ["a"]


def test_what_is_wrong_with_the_nodes_is_said() -> None:
    head = node("head", 0)
    assert complaint([head, node("a", 1)], OURS, "the cluster") is None
    assert (
        complaint([head], OURS, "the cluster") == "the cluster has no node with workers; start some, and they get work at once"
    )
    assert complaint([head, node("a", 1), node("b", 1, "0.9")], OURS, "the cluster") == (
        "1 of 2 nodes get no work, for they are of another version than the coordinator (1.0): node-b has drivecal 0.9;"
        " install the same release on both"
    )
