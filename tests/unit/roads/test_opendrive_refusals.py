"""OpenDRIVE files that netconvert alone would not convert, or would convert into another road without a word."""

import resource
import subprocess
from functools import partial
from itertools import product
from math import cos
from pathlib import Path

import pytest
from tests.support.effort import sample
from tests.support.mutations import outcome
from tests.support.values import faults_of

from drivecal.domain.errors import Problem
from drivecal.roads import conversion
from drivecal.roads.conversion import Conversion, converted
from drivecal.roads.network import read_network

NAME = "road.xodr"
LINE = '<geometry s="0" x="0" y="0" hdg="0" length="100"><line/></geometry>'

POLYNOMIALS = 'pRange="normalized" aU="0" bU="80" cU="0" dU="0" aV="0" bV="0" cV="0" dV="0"'


def lane(index: int, width: float = 3.5, kind: str = "driving", more: str = "") -> str:
    return f'<lane id="{index}" type="{kind}" {more}><width sOffset="0" a="{width}" b="0" c="0" d="0"/></lane>'


def road(
    name: str = "1", geometry: str = LINE, lanes: str = lane(-1), *, link: str = "", junction: str = "-1", signals: str = ""
) -> str:
    return (
        f'<road id="{name}" length="100" junction="{junction}"><link>{link}</link>\n<planView>{geometry}</planView>'
        f'<lanes><laneSection s="0"><center><lane id="0" type="none"/></center>\n<right>{lanes}</right></laneSection></lanes>'
        f"<signals>{signals}</signals></road>\n"
    )


def document(*parts: str, attributes: str = "", minor: str = 'revMinor="6"') -> bytes:
    return f'<OpenDRIVE {attributes}>\n<header revMajor="1" {minor}/>\n{"".join(parts)}</OpenDRIVE>'.encode()


def refused(content: bytes) -> Problem:
    (problem,) = faults_of(converted, content, NAME)
    assert problem.field == NAME
    assert problem.remedy
    return problem


def noted(result: Conversion, place: str) -> str:
    (note,) = [note for note in result.notes if place in note]
    return note


def spiral(first: str, last: str) -> str:
    return f'<geometry s="0" x="0" y="0" hdg="0" length="100"><spiral curvStart="{first}" curvEnd="{last}"/></geometry>'


@pytest.mark.parametrize("last", ["0.004", "0.0040000000000000009", "0.00400001"])
def test_a_spiral_that_is_an_arc_is_driven_as_one(last: str) -> None:
    network = read_network(converted(document(road(geometry=spiral("0.004", last))), NAME).network, NAME)
    shape = network.edges["-1"].lanes[0].shape
    assert shape[-1, 1] == pytest.approx(250.0 - 251.75 * cos(0.4), abs=0.02)  # to the right of an arc of 250 m


@pytest.mark.parametrize("shape", ['<arc curvature="0"/>', '<arc curvature="1e-17"/>', '<spiral curvStart="0" curvEnd="0"/>'])
def test_a_curve_without_curvature_is_driven_as_a_line(shape: str) -> None:
    network = read_network(converted(document(road(geometry=LINE.replace("<line/>", shape))), NAME).network, NAME)
    assert network.edges["-1"].lanes[0].length == pytest.approx(100.0, abs=0.01)


def test_netconvert_has_limits_of_memory_and_processor_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "netconvert"
    program.write_text("#!/bin/sh\nulimit -v; ulimit -t\n")
    program.chmod(0o755)
    monkeypatch.setattr(conversion, "netconvert", lambda: str(program))
    process = conversion.run_netconvert([], tmp_path)
    assert process.stdout.split() == [str(2048 * 1024), "60"]
    assert resource.getrlimit(resource.RLIMIT_CPU)[0] != 60  # the caller's own stay


def test_a_section_of_one_side_is_refused_unless_the_road_has_only_that() -> None:
    content = document(road()).replace(b"<laneSection", b'<laneSection singleSide="true"')
    assert converted(content, NAME).network
    other = f'</laneSection><laneSection s="50"><left>{lane(1)}</left></laneSection>'
    assert "<laneSection>" in refused(content.replace(b"</laneSection>", other.encode())).message


@pytest.mark.parametrize(("code", "said"), [(-24, ""), (1, "Error: std::bad_alloc\nQuitting (on error)."), (-9, "")])
def test_a_file_beyond_the_limits_is_refused_with_them(code: int, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = subprocess.CompletedProcess(["netconvert"], code, "", said)
    monkeypatch.setattr(conversion, "run_netconvert", lambda *_: answer)
    message = refused(document(road())).message
    assert "60 s" in message
    assert "2048 MB" in message


@pytest.mark.parametrize(
    "attributes",
    ['id="a" s="9"', 'id="a" s="9" type=""', 'id="a" s="9" type="274"', 's="9" type="1000001"', 'id="a" type="1000001"'],
)
def test_signals_that_are_no_traffic_lights_do_not_stop_a_file(attributes: str) -> None:
    result = converted(document(road(signals=f"<signal {attributes}/><signal {attributes}/>")), NAME)
    assert noted(result, "signal").startswith("2 x")


def test_a_link_of_the_centre_lane_changes_nothing() -> None:
    link = b'<link><predecessor id="0"/><successor id="0"/></link>'
    content = with_a_junction().replace(b'<lane id="0" type="none"/>', b'<lane id="0" type="none">' + link + b"</lane>")
    network, plain = (converted(each, NAME).network.partition(b"<net ")[2] for each in (content, with_a_junction()))
    assert network == plain != b""


def test_a_default_namespace_and_a_missing_minor_version_change_nothing() -> None:
    plain = read_network(converted(document(road()), NAME).network, NAME)
    other = document(road(), attributes='xmlns="http://code.asam.net/simulation/standard/opendrive_schema"', minor="")
    network = read_network(converted(other, NAME).network, NAME)
    assert network.edges.keys() == plain.edges.keys()


def test_an_id_that_sumo_cannot_have_is_refused_at_its_line() -> None:
    problem = refused(document(road("1"), road("main road")))
    assert {"line", "6,"} <= set(problem.message.split())
    assert "main road" in problem.message


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ('<connection id="0"', "<connection", "the attribute id is missing"),
        ('incomingRoad="1" ', "", "less than two roads"),
        ('connectingRoad="11"', "", "less than two roads"),
        ('contactPoint="start">', 'contactPoint="middle">', "contactPoint"),
        ('from="-1"', 'from="left"', "from is"),
        ('to="-1"/>', "/>", "the attribute to is missing"),
        ('<junction id="A"', "<junction", "the attribute id is missing"),
        ('predecessor elementType="road" elementId="1"', 'predecessor elementType="road" elementId="7"', "no such road"),
    ],
)
def test_faults_of_junctions_are_named_by_line(old: str, new: str, part: str) -> None:
    content = with_a_junction()
    assert converted(content, NAME).network
    changed = content.replace(old.encode(), new.encode())
    assert changed != content
    message = refused(changed).message
    assert message.startswith("line ")
    assert part in message


LINK = '<{} elementType="road" elementId="{}" contactPoint="{}"/>'
INSIDE = lane(-1).replace("<width", '<link><predecessor id="-1"/><successor id="-1"/></link><width')


def with_a_junction() -> bytes:
    """A road that leads into another one through a junction."""
    inside = LINK.format("predecessor", "1", "end") + LINK.format("successor", "2", "start")
    return document(
        road("1", link='<successor elementType="junction" elementId="A"/>'),
        road("2", LINE.replace('x="0"', 'x="200"'), link='<predecessor elementType="junction" elementId="A"/>'),
        road("11", LINE.replace('x="0"', 'x="100"'), INSIDE, junction="A", link=inside),
        '<junction id="A" name=""><connection id="0" incomingRoad="1" connectingRoad="11" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection></junction>',
    )


def test_a_junction_that_leads_to_a_junction_is_refused_with_both() -> None:
    parts = [
        road("1", link='<successor elementType="junction" elementId="A"/>'),
        road("2", LINE.replace('x="0"', 'x="300"'), link='<predecessor elementType="junction" elementId="B"/>'),
    ]
    ways = (("A", "1", "11", "21", "100"), ("B", "11", "21", "2", "200"))
    for junction, before, inside, after, x in ways:
        links = LINK.format("predecessor", before, "end") + LINK.format("successor", after, "start")
        parts.append(road(inside, LINE.replace('x="0"', f'x="{x}"'), INSIDE, junction=junction, link=links))
    for junction, before, inside, *_ in ways:
        way = f'<connection id="0" incomingRoad="{before}" connectingRoad="{inside}" contactPoint="start">'
        parts.append(f'<junction id="{junction}" name="">{way}<laneLink from="-1" to="-1"/></connection></junction>')
    problem = refused(document(*parts))
    assert all(f" {name} " in f"{problem.message.replace(',', ' ')} " for name in ("11", "21", "A", "B"))
    assert "line 9" in problem.message
    parts[2] = parts[2].replace(LINK.format("successor", "21", "start"), '<successor elementType="junction" elementId="B"/>')
    assert "line 9, the road 11 of junction A leads to the junction B" in refused(document(*parts)).message


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ('type="driving"', 'type="shoulder"', "lanes of type shoulder"),
        ('junction="-1"', 'junction="A"', "in the junctions A"),
        ('length="100"', 'length="0"', "up to 0 m long"),
        ('a="3.5"', 'a="-3.5"', "line 5, road 1, lane -1: the lane is -3.5 m wide"),
    ],
)
def test_roads_that_cannot_be_driven_are_refused_with_the_cause(old: str, new: str, part: str) -> None:
    assert part in refused(document(road().replace(old, new))).message


def test_a_geometry_that_ends_before_its_road_is_noted() -> None:
    result = converted(document(road(geometry=LINE.replace("100", "60"))), NAME)
    assert "60 m to 100 m" in noted(result, "geometries")
    assert not [note for note in converted(document(road()), NAME).notes if "geometries" in note]


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        (' junction="-1"', "", "road 1: no junction is given: taken as -1"),
        ('laneSection s="0"', 'laneSection s="40"', "road 1, s = 0 m to 40 m: no lane section"),
        ("<line/>", f"<paramPoly3 {POLYNOMIALS}/>", "road 1, s = 0 m, length 100 m: its paramPoly3 is 80 m long"),
    ],
)
def test_what_a_road_leaves_open_or_says_otherwise_is_noted(old: str, new: str, note: str) -> None:
    assert noted(converted(document(road().replace(old, new)), NAME), note)


def test_a_lane_that_is_driven_against_its_side_is_closed_and_noted() -> None:
    lanes = lane(-1) + lane(-2, more='direction="reversed"') + lane(-3, more='direction="both"')
    result = converted(document(road(lanes=lanes)), NAME)
    assert [lane.for_cars for lane in read_network(result.network, NAME).edges["-1"].lanes] == [True, False, True]
    assert "reversed" in noted(result, "road 1, lane -2")
    assert "both" in noted(result, "road 1, lane -3")


def test_lanes_that_nothing_drives_on_are_noted_by_type() -> None:
    result = converted(document(road(lanes=lane(-1) + lane(-2, kind="HOV") + lane(-3, kind="bus"))), NAME)
    assert "HOV" in noted(result, "road 1, lane -2")
    assert "bus" in noted(result, "road 1, lane -3")


def test_a_lane_may_be_as_wide_as_a_proving_ground_and_a_wider_one_is_named() -> None:
    network = read_network(converted(document(road(lanes=lane(-1, 28.0))), NAME).network, NAME)
    assert network.edges["-1"].lanes[0].width == 28.0
    problem = refused(document(road(lanes=lane(-1) + lane(-2, 280.0))))
    assert "line 5, road 1, lane -2" in problem.message
    assert "100 m" in problem.remedy


def test_netconverts_own_words_come_with_the_line_of_the_road_that_they_name(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = subprocess.CompletedProcess(["netconvert"], 1, "", "Error: Attribute 'x' is missing in definition of road '2'.")
    monkeypatch.setattr(conversion, "run_netconvert", lambda *_: answer)
    assert refused(document(road(), road("2"))).message.startswith("line 6, road 2")
    assert refused(document(road("7"))).message.startswith("line 3, road 7"), "the only road of a file is meant"


@pytest.mark.slow
def test_spirals_of_any_curvature_are_converted_or_refused_soon() -> None:
    values = ["0", "1e-300", "1e-17", "1e-9", "-1e-9", "0.01", "0.0100000001", "-0.01", "9.9"]
    for first, last in sample(list(product(values, ("0", "0.01", "-0.0100000000001"))), 10):
        outcome(partial(converted, document(road(geometry=spiral(first, last))), NAME))
