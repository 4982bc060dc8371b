"""Reading networks: what is refused, with file and line."""

import gzip
import re
from contextlib import suppress

import pytest
from tests.support.networks import REAL, bridges, built, edge, entrance, node, real_corridor, real_network
from tests.support.values import faults_of

from drivecal.domain.errors import InvalidInputError
from drivecal.roads import documents
from drivecal.roads.corridor import NEAR, corridor, other_levels
from drivecal.roads.network import read_network

NAME = "road.net.xml"


def refused(content: bytes) -> str:
    """The message of the refusal, which names the file and has a remedy."""
    (problem,) = faults_of(read_network, content, NAME)
    assert problem.field == NAME
    assert problem.remedy
    return problem.message


def changed(pattern: str, replacement: str) -> bytes:
    text, count = re.subn(pattern, replacement, entrance().decode(), count=1, flags=re.DOTALL)
    assert count
    return text.encode()


BILLION = '<!DOCTYPE net [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]>'


@pytest.mark.parametrize(
    ("pattern", "replacement"),
    [
        (r'<net version="[^"]*"', '<net version="0.13"'),
        (r'<net version="[^"]*"', '<net version="2.0"'),
        (r'<net version="[^"]*"', '<net version="new"'),
        (r' version="1[^"]*"', ""),
        (r"<net ", '<net lefthand="true" '),
        (r"<net ", f"{BILLION}<net "),
        (r"<net ", '<!DOCTYPE net SYSTEM "http://127.0.0.1:1/net.dtd"><net '),
        (r"<net (.*)</net>", r"<routes \1</routes>"),
        (r"</net>", '<include href="other.xml"/></net>'),
        (r"</net>", '<variableSpeedSign id="v" lanes="before_0" file="speeds.xml"/></net>'),
        (r"</net>", '<inductionLoop id="i" lane="before_0" pos="1" period="1" file="out.xml"/></net>'),
        (r'speed="33.33"', 'speed="nan"'),
        (r'speed="33.33"', 'speed="0"'),
        (r'speed="33.33"', 'speed="1e-9"'),
        (r'speed="33.33"', 'speed="3_3"'),
        (r' speed="33.33"', ""),
        (r'width="3.75"', 'width="0"'),
        (r'width="3.75"', 'width="1e6"'),
        (r'(id="before_0" index=)"0"', r'\1"1"'),
        (r'(id="before_0" index=)"0"', r'\1"40"'),
        (r'(id="before_0".*?shape=)"[^"]*"', r'\1"0,0"'),
        (r'(id="before_0".*?shape=)"[^"]*"', r'\1"0,0 1e300,1"'),
        (r'(id="before_0".*?shape=)"[^"]*"', r'\1"0,0 1,2,3,4"'),
        (r'(id="before_0".*?)length="[^"]*"', r"\1"),
        (r'<edge id="after"', '<edge id="before"'),
        (r'<junction id="c"', '<junction id="b"'),
        (r'fromLane="0"', 'fromLane="-1"'),
        (r'toLane="0"', 'toLane="9"'),
        (r'foes="[01]*"', 'foes="2"'),
        (r'<request index="0"', '<request index="7"'),
        (r"</net>", ""),
        (r"</net>", "</net><net/>"),
        (r"</net>", "&x;</net>"),
    ],
)
def test_what_is_wrong_is_refused_by_its_line(pattern: str, replacement: str) -> None:
    assert re.search(r"line \d+", refused(changed(pattern, replacement)))


@pytest.mark.parametrize(("origin", "kept"), [("7_-3", "7_-3"), ("7_-3 8_1", "7_-3 8_1"), ("7_x", None), ("way 12", None)])
def test_origins_of_lanes_are_roads_and_lanes_of_opendrive(origin: str, kept: str | None) -> None:
    lane = rf'\1><param key="origId" value="{origin}"/></lane>'
    network = read_network(changed(r'(<lane id="before_0"[^>]*)/>', lane), NAME)
    assert network.edges["before"].lanes[0].origin == kept


@pytest.mark.parametrize(
    "content",
    [b"", b" \n", b"no xml", b"<net version='1.20'/>", gzip.compress(b"<net/>", mtime=0), b"\xff\xfe<\x00n\x00", b"PK\x03\x04"],
)
def test_what_is_no_network_is_refused(content: bytes) -> None:
    assert refused(content)


def test_files_elements_and_levels_without_end_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "levels" in refused(b'<net version="1.20">' + b"<x>" * 1000)
    assert refused(b'<net version="1.20"><x a="' + b"y" * (documents.LONGEST_VALUE + 1) + b'"/></net>')
    monkeypatch.setattr(documents, "MOST_ELEMENTS", 1000)
    assert "elements" in refused(b'<net version="1.20">' + b"<x/>" * 1001 + b"</net>")
    monkeypatch.setattr(documents, "LARGEST", 1000)
    assert refused(b" " * 1001)


def test_connections_without_end_are_refused() -> None:
    way = '<connection from="before" to="beside" fromLane="0" toLane="0"/>'
    assert "connections" in refused(changed("</net>", way * 1001 + "</net>"))
    assert "lanes" in refused(changed('incLanes="[^"]+"', f'incLanes="{"before_0 " * 1001}"'))


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1", "ascii"])
def test_other_encodings_are_read(encoding: str) -> None:
    text = entrance().decode().replace('encoding="UTF-8"', f'encoding="{encoding}"')
    assert "before" in read_network(text.encode(encoding), NAME).edges


@pytest.mark.parametrize("encoding", ["base64", "utf-7", "no-such", "shift_jis"])
def test_strange_encodings_are_refused_or_read(encoding: str) -> None:
    text = entrance().decode().replace('encoding="UTF-8"', f'encoding="{encoding}"')
    with suppress(InvalidInputError):
        read_network(text.encode(), NAME)


def test_a_declaration_that_does_not_stand_first_is_to_be_moved() -> None:
    (problem,) = faults_of(read_network, b"<!-- by a program -->\n" + entrance(), NAME)
    assert problem.remedy == "move <?xml ...?> to the beginning"


def test_faults_of_handlers_are_no_faults_of_the_encoding() -> None:
    def start(attributes: documents.Attributes) -> None:
        raise KeyError(attributes.element)

    with pytest.raises(KeyError):
        documents.read_elements(b"<net/>", NAME, "net", start, lambda _: None)


def test_lanes_keep_what_the_file_says() -> None:
    network = read_network(entrance(), NAME)
    ramp = network.edges["ramp"].lanes[0]
    assert (ramp.width, ramp.limit, ramp.for_cars, ramp.index) == (3.5, 22.22, True, 0)
    assert network.lane("ramp_0") is ramp
    assert [network.lane(name) for name in ("ramp_1", "ramp", "x_0", "ramp_-1", "ramp_²", "ramp_9999")] == [None] * 6


def test_an_index_that_stands_twice_in_an_edge_is_named() -> None:
    content = entrance().decode()
    edge = content.index('<edge id="beside"')
    place = content.index('index="1"', edge)
    twice = f'{content[:place]}index="0"{content[place + 9 :]}'.encode()
    (problem,) = faults_of(read_network, twice, "road.net.xml")
    assert "index 0" in problem.message
    assert "1" in problem.remedy


ROUTE = ("before", "after")


def test_edges_that_cross_the_lanes_without_a_junction_are_on_another_level() -> None:
    network = read_network(bridges(), "road.net.xml")
    levels = other_levels(network, corridor(network, ROUTE, "road.net.xml"))
    assert set(levels) == {"bridge", "ramp"}
    begin, end = levels["bridge"]
    assert begin < 300 < end
    assert end - begin < 25
    begin, end = levels["ramp"]
    (lane,) = network.edges["ramp"].lanes
    assert NEAR < lane.length - 320 < begin < lane.length - 300 < end < lane.length - 280


def test_the_other_road_sees_the_route_on_another_level() -> None:
    network = read_network(bridges(), "road.net.xml")
    levels = other_levels(network, corridor(network, ("bridge",), "road.net.xml"))
    assert set(levels) == {"before", "back"}
    assert levels["before"] == pytest.approx((300, 300), abs=12)


def test_ramps_and_roads_beside_a_route_are_on_its_level() -> None:
    network = read_network(entrance(), "road.net.xml")
    assert other_levels(network, corridor(network, ("before", "beside", "after"), "road.net.xml")) == {}


def test_the_other_direction_of_a_narrow_road_is_on_its_level() -> None:
    nodes, there = [node("a", 0, 0), node("b", 1000, 0)], edge("there", "a", "b", 1, width="2.4")
    network = read_network(built(nodes, [there, edge("back", "b", "a", 1, width="2.4")], []), "road.net.xml")
    assert other_levels(network, corridor(network, ("there",), "road.net.xml")) == {}


@pytest.mark.parametrize("name", REAL)
def test_levels_of_real_networks_are_edges_beside_the_route(name: str) -> None:
    network, route = real_network(REAL[name][0]), real_corridor(name)
    levels = other_levels(network, route)
    assert not levels.keys() & {edge for edge, _ in route.places}
    for crossing, (begin, end) in levels.items():
        assert begin < end < max(lane.length for lane in network.edges[crossing].lanes) + 10
