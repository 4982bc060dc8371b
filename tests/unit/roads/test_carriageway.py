"""Roads of equal lanes, measured from networks."""

from itertools import pairwise

import numpy as np
import pytest
from tests.support.networks import entrance

from drivecal.domain.errors import InvalidInputError
from drivecal.highway.scenarios import HIGHWAY
from drivecal.roads.carriageway import SPACING, carriageway
from drivecal.roads.corridor import corridor
from drivecal.roads.network import read_network

S5 = HIGHWAY.scenarios["S5"]


def network(*widths: float, limit: str = "30") -> bytes:
    """Returns a straight edge of 200 m with parallel lanes."""
    borders = np.concatenate([[0.0], np.cumsum(widths)]) - 0.5 * widths[0]
    lanes = "".join(
        f'<lane id="e_{number}" index="{number}" speed="{limit if number else 30}" length="200" width="{width}" '
        f'shape="0,{borders[number] + 0.5 * width} 200,{borders[number] + 0.5 * width}"/>'
        for number, width in enumerate(widths)
    )
    junctions = "".join(f'<junction id="j{number}" type="priority" x="{200 * number}" y="0"/>' for number in (0, 1))
    return f'<net version="1.20"><edge id="e" from="j0" to="j1">{lanes}</edge>{junctions}</net>'.encode()


def test_lanes_widths_and_limits_are_those_of_the_network() -> None:
    road = carriageway(network(3.5, 3.5), ("e",), "two.net.xml")
    assert (road.lanes, road.lane_width, road.right_edge, road.left_edge) == (2, 3.5, -1.75, 5.25)
    assert road.length == pytest.approx(200.0)
    assert road.limits == ((0.0, 30.0),)
    assert road.line[:, 0].tolist() == (np.arange(401) * SPACING).tolist()
    assert np.abs(road.line[:, 2:]).max() < 1e-9


def test_a_road_is_measured_once() -> None:
    assert carriageway(S5.network, S5.route, "S5.net.xml") is S5.road


WAY = b'<connection from="e0" to="e1" fromLane="0" toLane="0" dir="s" state="M"/>'


@pytest.mark.parametrize(
    ("content", "route"),
    [
        (network(3.5, 3.0), ["e"]),
        (network(3.5, 3.5, limit="20"), ["e"]),
        (network(3.5, 3.5).replace(b"3.5 200,3.5", b"4.2 200,4.2"), ["e"]),
        (entrance(), ["before", "beside", "after"]),
        (S5.network.replace(WAY, WAY + WAY.replace(b'toLane="0"', b'toLane="1"')), ["e0", "e1"]),
        (S5.network, ["e1", "e0"]),
        (S5.network, ["e9"]),
        (S5.network.replace(b"</net>", b""), ["e0", "e1"]),
        (S5.network[: len(S5.network) // 2], ["e0", "e1"]),
        (b"", ["e0"]),
        (b"<net/>", ["e0"]),
    ],
    ids=["widths", "limits", "gap", "ramp", "two ways", "order", "unknown", "open", "half", "empty", "no network"],
)
def test_what_is_no_carriageway_is_refused(content: bytes, route: list[str]) -> None:
    with pytest.raises(InvalidInputError, match=r"road\.net\.xml"):
        carriageway(content, tuple(route), "road.net.xml")


NEAR = 0.1
"""Metres."""


@pytest.mark.parametrize("length", [100, 1_000, 9_000])
def test_lanes_of_two_points_follow_one_another_at_any_length(length: int) -> None:
    ends = (0, length, 2 * length)
    edges = "".join(
        f'<edge id="e{number}" from="j{number}" to="j{number + 1}"><lane id="e{number}_0" index="0" speed="30" length="{length}" '
        f'width="3.5" shape="{begin},0 {end},0"/></edge>'
        for number, (begin, end) in enumerate(pairwise(ends))
    )
    junctions = "".join(f'<junction id="j{number}" type="priority" x="{x}" y="0"/>' for number, x in enumerate(ends))
    connection = '<connection from="e0" to="e1" fromLane="0" toLane="0" dir="s" state="M"/>'
    network = read_network(f'<net version="1.20">{edges}{junctions}{connection}</net>'.encode(), "long.net.xml")
    road = corridor(network, ["e0", "e1"], "long.net.xml")
    assert road.length == pytest.approx(2 * length, abs=0.01)
    [track] = road.tracks
    assert (track.begin, track.end) == pytest.approx((0.0, road.length))
