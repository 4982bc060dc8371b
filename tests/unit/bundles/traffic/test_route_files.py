"""SUMO route files: what is on the list is passed on to SUMO, everything else is refused with file, line and element."""

from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from tests.support.networks import entrance
from tests.support.scenario_files import ROUTES, with_routes
from tests.support.values import faults_of, present

from drivecal.bundles.highway_checks import scenario_problems
from drivecal.bundles.traffic.elements import Element
from drivecal.bundles.traffic.route_files import RouteTraffic
from drivecal.domain.errors import InvalidInputError
from drivecal.highway import sumo

ROUTE = '<route id="r" edges="before beside after"/>'
VEHICLE = '<vehicle id="a" route="r" depart="0" departPos="150" departSpeed="28"{}/>'
TYPED = VEHICLE.format(' type="t"')
FLOW = '<flow id="f" route="r" {}/>'
STOP = VEHICLE.format("").replace("/>", "><stop {}/></vehicle>")
TRIP = '<trip id="a" depart="0" from="before" to="after" {}</trip>'
DRAWN = '<vType id="t"/><vTypeDistribution id="d" {}/>' + VEHICLE.format(' type="d"')


def file(content: str) -> bytes:
    """A route file with a route `r`."""
    return f"<routes>\n{ROUTE}\n{content}\n</routes>".encode()


def traffic(content: str | bytes, **data: Any) -> RouteTraffic:
    """The traffic of a file."""
    return present(with_routes(file(content) if isinstance(content, str) else content, **data).routes)


def elements(content: str | bytes, **data: Any) -> list[ET.Element]:
    """The elements that SUMO reads of a file."""
    return list(ET.fromstring(traffic(content, **data).content))


def departing(content: str, **data: Any) -> list[str | None]:
    """The ids of the vehicles and flows that SUMO reads."""
    return [element.get("id") for element in elements(content, **data) if element.tag in {"vehicle", "trip", "flow"}]


def day(*times: float) -> str:
    """Vehicles that depart at times of day."""
    return "".join(f'<vehicle id="v{time:g}" route="r" depart="{time:g}" departPos="50" departSpeed="20"/>' for time in times)


def refusal(content: str | bytes, **data: Any) -> str:
    """The place that the refusal of a file names."""
    (problem,) = faults_of(traffic, content, **data)
    assert problem.field == "routes"
    assert problem.remedy
    return problem.message


def is_driven(content: bytes, folder: Path) -> bool:
    """Returns whether SUMO drives a file for 25 s."""
    for name, text in (("road.net.xml", entrance()), ("a.rou.xml", content)):
        (folder / name).write_bytes(text)
    with suppress(*sumo.SUMO_ERRORS):
        sumo.load(sumo.options(str(folder / "road.net.xml"), str(folder / "a.rou.xml"), 1.0, 1))
        for _ in range(25):
            sumo.simulation.step()
        return True
    return False


def test_sumo_reads_a_file_as_it_is_without_what_has_no_effect() -> None:
    car, lorry, through, *vehicles = elements(ROUTES)
    assert car.attrib.items() >= {"carFollowModel": "IDM", "lcAssertive": "2", "speedFactor": "normc(1,0.1,0.2,2)"}.items()
    assert "color" not in car.attrib
    spaced = '<vType id="t" tau=" 1.5 " speedFactor="norm( 1, 0.1 )"/>'
    assert {"tau": "1.5", "speedFactor": "norm(1,0.1)"}.items() <= elements(spaced + TYPED)[1].attrib.items()
    assert (lorry.get("vClass"), through.get("edges")) == ("truck", "before beside after")
    assert [element.get("id") for element in vehicles] == ["a.1", "stream", "joins", "others", "late"]
    assert [inner.tag for inner in vehicles[-1]] == ["route"]
    routes = traffic(ROUTES)
    assert (routes.starting, set(routes.vehicles)) == (("a.1",), {"a.1", "joins", "late"})
    assert [note for note in routes.notes if "line 12, <person>" in note]
    assert [note for note in routes.notes if "line 11, <vehicle>" in note]
    planned = traffic(ROUTES.replace(b'depart="4.5"', b'depart="4.5" arrival="80" fromTaz="a"')).notes
    assert [("arrival" in note, "fromTaz" in note) for note in planned if "given way" in note] == [(True, False), (False, True)]


@pytest.mark.parametrize(
    "content",
    [
        '<vTypeDistribution id="d"><vType id="car" probability="3"/></vTypeDistribution>' + VEHICLE.format(' type="d"'),
        '<vType id="t"/><vTypeDistribution id="d" vTypes="t" probabilities="1"/>' + VEHICLE.format(' type="d"'),
        '<routeDistribution id="d"><route id="q" edges="before beside"/></routeDistribution><vehicle id="b" route="d" depart="0"/>',
        VEHICLE.format("").replace("/>", '><stop lane="before_0" endPos="180" duration="3"/></vehicle>'),
        VEHICLE.format(' arrivalPos="120" arrivalLane="current" arrivalSpeed="10"'),
        FLOW.format('begin="0" period="exp(0.25)" departLane="free"'),
        FLOW.format('begin="0" probability="0.25"'),
        VEHICLE.format("")
        .replace("/>", '><stop lane="before_0" duration="3"/><route edges="before"/></vehicle>')
        .replace('route="r" ', ""),
        FLOW.format('begin="0" end="20" number="5"'),
        '<vType id="t" apparentDecel="1e05"/><vType id="a"/>' + TYPED + '<trip id="b" depart="0" from="before" to="after"/>',
        '<vType id="DEFAULT_BIKETYPE" length="2"/>' + VEHICLE.format(' type="DEFAULT_TAXITYPE"'),
        *map(DRAWN.format, ('vTypes="t"', 'vTypes="t" probabilities="0.5 0.5"', 'vTypes="t DEFAULT_VEHTYPE" probabilities="0 1"')),
        *(VEHICLE.format(more).replace("150", place) for more, place in (
            (' arrivalPos="9999"', "9999"), (' arrivalPos="-9999"', "-9999"), (' departLane="+1"', "splitFront"))),
        *map(STOP.format, (
            'lane="before_0" endPos="-5" duration="norm(5,1)"', 'lane="before_0" startPos="180" endPos="180" duration="0:01:00"',
            'lane=":b_1_0" duration="3"', 'lane="after_0" duration="1"', 'edge="beside" lane="before_0" duration="1"')),
        *map(TRIP.format, ('><stop lane="before_0" endPos="2" duration="3"/>', 'via="beside"><stop lane="before_0" duration="1"/>')),
    ],
)  # fmt: skip
def test_what_sumo_drives_is_passed_on(content: str, tmp_path: Path) -> None:
    assert is_driven(file(content), tmp_path)
    read = elements(content)
    given = list(ET.fromstring(file(content)))
    assert [ET.tostring(element).strip() for element in read] == [ET.tostring(element).strip() for element in given]


@pytest.mark.parametrize(
    ("content", "part"),
    [
        ('<vType id="t" laneChangeModel="SL2015"/><vType id="u" laneChangeModel="LC2013"/>' + TYPED, "<routes>"),
        ('<vType id="t" taU="1"/>' + TYPED, "taU"),
        (VEHICLE.format(' reroute="true"'), "reroute"),
        (VEHICLE.format("").replace('depart="0"', 'depart="triggered"'), "depart"),
        (VEHICLE.format("").replace("/>", '><stop busStop="b"/></vehicle>'), "<stop>"),
        ('<vehicle id="a" depart="0"><route edges="before nowhere"/></vehicle>', "<route>"),
        ('<trip id="a" depart="0" from="before" to="nowhere"/>', "<trip id=a>"),
        ('<vTypeDistribution id="d"><include href="x"/></vTypeDistribution>', "<include>"),
        ('<include href="/etc/passwd"/>', "<include>"), (VEHICLE.format(' type="none"'), "<vehicle id=a>"),
        (VEHICLE.format("").replace('route="r"', 'route="q"'), "<vehicle id=a>"),
        ('<vTypeDistribution id="d" vTypes="none" probabilities="1"/>', "none"),
        (VEHICLE.format("") * 2, "<vehicle id=a>"),
        (VEHICLE.format("").replace('id="a"', 'id="ego"'), "<vehicle id=ego>"),
        ('<vehicle id="a" depart="0"><route edges="ramp after"/></vehicle>', "<route>: no lane"),
        ('<vehicle id="a" depart="0"><route edges=""/></vehicle>', "<route>"), ('<trip id="a" depart="0" to="after"/>', "<trip id=a>"),
        (VEHICLE.format("").replace("/>", '><stop lane="before_9" duration="3"/></vehicle>'), "before_9"),
        (VEHICLE.format("").replace("/>", '><stop duration="3"/></vehicle>'), "<stop>"),
        (VEHICLE.format("").replace("/>", '><stop lane="before_0" duration="-3"/></vehicle>'), "<stop>"),
        *((FLOW.format(rate), "<flow id=f>") for rate in (
            'begin="0"', 'period="2" vehsPerHour="3"', 'period="exp(-1)"', 'begin="0" end="9" number="0"', 'probability="1.5"',
            'period="1e10"', 'period="exp(1e8)"', 'vehsPerHour="1e8"', 'period="1e-9"', 'period="2" departLane="2"')),
        *((f'<vType id="t" {value}/>' + TYPED, "<vType id=t>") for value in (
            'carFollowModel="Wiedemann"', 'vClass="tram"', 'tau="0"', 'carFollowModel="IDM" stepping="1e-9"', 'length="1e"',
            'lcOvertakeDeltaSpeedFactor="2"', 'decel="9e9"')),
        ('<vType id="t" vClass="bus"/>' + TYPED, "<vehicle id=a>: departSpeed"),
        ('<vType id="t" maxSpeed="27"/>' + TYPED, "<vehicle id=a>: departSpeed"),
        (VEHICLE.format(' departLane="2"'), "<vehicle id=a>: before has no lane 2"),
        ('<trip id="a" depart="0" from="after" to="before"/>', "<trip id=a>: no way"),
        ('<vType id="t" apparentDecel="9e9"/>' + TYPED, "apparentDecel"),
        ('<vType id="t"/><vTypeDistribution id="t" vTypes="t" probabilities="1"/>' + TYPED, "<vTypeDistribution id=t>"),
        ('<vType id="ego"/>' + VEHICLE.format(' type="ego"'), "<vType id=ego>"),
        ('<route id="route-ego" edges="before"/>' + VEHICLE.format(""), "<route id=route-ego>"),
        ('<vehicle id="a" depart="0"/>', "route is missing"),
        (VEHICLE.format("") + '<vType id="t"/>' + VEHICLE.format(' type="a"'), "no type a"),
        ("".join(f'<route id="r{index}" edges="before"/>' for index in range(9_999)) + day(0), "<vehicle id=v0>"),
        (VEHICLE.format("").replace("/>", ">" + '<stop lane="before_0" duration="3"/>' * 10_000 + "</vehicle>"), "<stop>"),
        ('<vType id="t" tau="nan"/>' + TYPED, "tau"), ('<vType id="t" lcSpeedGain="-inf"/>' + TYPED, "lcSpeedGain"),
        ("".join(f'<vehicle id="v{index}" route="r" depart="{index / 200}"/>' for index in range(2001)), "<vehicle id=v2000>"),
    ],
)  # fmt: skip
def test_everything_else_is_refused_with_line_and_element(content: str, part: str) -> None:
    message = refusal(content)
    assert message.startswith("a.rou.xml: line ")
    assert part in message


@pytest.mark.parametrize(
    ("content", "place"),
    [
        *((STOP.format(f'lane="{text}" duration="1"'), "<stop>") for text in (
            "ramp_0", 'before_0" endPos="9999', 'before_0" endPos="149', 'before_0" endPos="-9999', 'before_0" startPos="180" endPos="170',
            'before_0" startPos="-9999', 'before_0" until="1:00', 'beside_0" duration="1"/><stop lane="before_0')),
        (STOP.format('edge=" before" duration="1"'), "<stop>"), (TRIP.format('><stop lane="ramp_0" duration="1"/>'), "<stop>"),
        (TRIP.format('departPos="9"><stop lane="before_0" endPos="8" duration="1"/>'), "<stop>"),
        (TRIP.format('arrivalPos="9"><stop lane="after_0" endPos="10" duration="1"/>'), "<trip id=a>"),
        ('<route id="q" edges="before"><stop lane="after_0" duration="1"/></route><vehicle id="b" route="q" depart="0"/>', "<stop>"),
        *((DRAWN.format(text), "<vTypeDistribution id=d>") for text in (
            "", 'vTypes=""', 'vTypes="t" probabilities="true"', 'vTypes="t" probabilities="1 x"', 'vTypes="t" probabilities="0"')),
        ('<vType id="u" probability="0"/><vTypeDistribution id="d" vTypes="u"/>' + VEHICLE.format(""), "<vTypeDistribution id=d>"),
        *((f'<routeDistribution id="d" {text}/>' + VEHICLE.format(""), "<routeDistribution id=d>") for text in (
            "", 'routes="r" probabilities="true"')),
        *((VEHICLE.format(f' departLane="{lane}"'), "<vehicle id=a>") for lane in ("+5", "5", "99999999999", "-1", "1.0")),
        *((VEHICLE.format("").replace(old, new), "<vehicle id=a>") for old, new in (
            ("28", "fast"), ("28", "-1"), ("28", "99"), ("150", "far"), ("150", "1e400"))),
    ],
)  # fmt: skip
def test_what_sumo_refuses_is_refused_at_its_element(content: str, place: str, tmp_path: Path) -> None:
    assert not is_driven(file(content), tmp_path)
    assert refusal(content).startswith(f"a.rou.xml: line 3, {place}: ")


MORE = f"""<vTypeDistribution id="mixed" vTypes="car lorry" probabilities="0.7 0.3"/>
<routeDistribution id="ways"><route id="w" edges="before beside"/><route id="v" edges="before beside after"/></routeDistribution>
<vehicle id="drawn" type="mixed" route="ways" depart="1" departLane="0" departPos="50"/>
{TRIP.format('departPos="20"><stop lane="before_1" endPos="90" duration="2"/><stop edge="beside" startPos="2" endPos="40" until="30"/>')}"""


@pytest.mark.parametrize("tries", [40, 300])
@pytest.mark.slow("300")
def test_mutated_files_that_pass_load_in_sumo(tries: int, tmp_path: Path) -> None:
    passed = 0
    for seed in range(tries):
        draw, root = Random(seed), ET.fromstring(ROUTES.replace(b"</routes>", f"{MORE}</routes>".encode()))
        parent = draw.choice([each for each in root.iter() if len(each)])
        element, value = draw.choice([*parent]), draw.choice(["-1", "0", "0.5", "7", "95", "1e4", "true", "", "+2"])
        key, kind = draw.choice([*element.attrib, "none"]), draw.randrange(3)
        parent.extend([element] * (kind == 2))
        element.attrib.update({key: value} if kind == 1 else {})
        if kind == 0:
            element.attrib.pop(key, None)
        with suppress(InvalidInputError):
            content = traffic(ET.tostring(root)).content
            passed += 1
            assert is_driven(content, tmp_path), ET.tostring(element)
    assert passed > tries / 5


@pytest.mark.parametrize(
    ("content", "part", "right"),
    [
        ('<vType id="t" length="-3"/>' + TYPED, "<vType id=t>: attribute 'length'", "0"),
        ('<vType id="t" sigma="2"/>' + TYPED, "sigma", "1"),
        ('<vType id="t" accel="abc"/>' + TYPED, "accel", "number"),
        ('<vType id="t" speedFactor="fast"/>' + TYPED, "speedFactor", "normc"),
        ('<vType id="t" laneChangeModel="LC"/>' + TYPED, "laneChangeModel", "LC2013"),
        ('<vType accel="2"/>' + VEHICLE.format(""), "<vType>", "id"),
        (VEHICLE.format(' departLane="lft"'), "<vehicle id=a>: attribute 'departLane'", "free"),
        (VEHICLE.format("").replace("150", "x"), "departPos", "random"),
        ('<trip id="a" depart="0" route="r"/>', "<trip id=a>: the attribute route", "make it a vehicle"),
        ('<vehicle id="a" depart="0" from="before" to="after"/>', "<vehicle id=a>: the attribute from", "make it a trip"),
        (VEHICLE.format("").replace("/>", '><stop lane="before_0" endPos="far"/></vehicle>'), "<stop>: attribute 'endPos'", "NUMBER"),
        (FLOW.format('begin="0" period="2" number="2.5"'), "<flow id=f>: attribute 'number'", "a whole number"),
    ],
)  # fmt: skip
def test_values_are_those_of_sumo_s_own_schema(content: str, part: str, right: str) -> None:
    """The line is the user's, also behind vehicles that are left out or in another order."""
    for before, line in (("", 3), (day(900, 5, 1) + "\n<person id='p' depart='0'/>\n", 5)):
        problem = faults_of(traffic, before + content)[0]
        assert problem.message.startswith(f"a.rou.xml: line {line}, ")
        assert part in problem.message
        assert right in problem.message + problem.remedy


def test_the_first_wrong_values_are_named_and_the_others_not_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    said, fault = list[int](), Element.fault

    def counted(self: Element, message: str, remedy: str) -> InvalidInputError:
        said.append(self.line)
        return fault(self, message, remedy)

    monkeypatch.setattr(Element, "fault", counted)
    mixed = "".join(  # SUMO takes its elements in any order, its schema does not
        f'<vehicle id="m{index}" depart="0"><stop lane="before_0" duration="3"/><route edges="before"/></vehicle>\n'
        for index in range(30)
    )
    assert (
        len(faults_of(traffic, mixed + "".join(f'<vType id="t{index}" length="-3"/>\n' for index in range(2_000))))
        == len(said)
        == 20
    )
    assert said == list(range(33, 53))


def test_ids_of_types_are_no_ids_of_vehicles() -> None:
    own = [{"id": "lead", "lane": 1, "s": 160.0, "speed": 25.0}]
    types = '<vType id="a"/><vType id="b"/>'
    for content in (types + day(0), day(0) + types):
        assert departing(content.replace("v0", "a"), traffic=own) == ["a"]
    assert refusal('<vType id="lead"/>' + day(0), traffic=own)
    assert refusal(day(0).replace("v0", "lead"), traffic=own)


def test_sumo_s_own_words_get_the_line_of_whom_they_name() -> None:
    routes = traffic(FLOW.format('begin="0" period="1"'))
    assert routes.located("Departure speed for vehicle 'f.3' is too high").startswith("line 3, <flow>: Departure")
    assert routes.located("Invalid parsing") == "Invalid parsing"


@pytest.mark.parametrize(
    ("content", "data", "parts"),
    [
        (day(25_200, 25_230), {}, ["from 25200 to 25230 s", "from 0 to 20 s"]),
        ('<flow id="f" route="r" begin="7:00:00" end="8:00:00" vehsPerHour="900"/>', {}, ["at 25200 s"]),
        (FLOW.format('begin="0" end="100" vehsPerHour="900"'), {"begin": 300, "warm_up": 60}, ["from 240 to 320 s"]),
        (day(10), {"begin": 25_200}, ["at 10 s"]),
        (FLOW.format('begin="0" end="0" vehsPerHour="900"'), {}, ["its flows end before a vehicle departs"]),
        ('<vType id="t"/>', {}, []),
    ],
)
def test_a_file_without_vehicles_is_refused_with_its_times(content: str, data: dict[str, Any], parts: list[str]) -> None:
    message = refusal(content, **data)
    assert "line 1, <routes>" in message
    assert all(part in message for part in parts)


def test_only_vehicles_of_the_run_and_its_warm_up_are_passed_on() -> None:
    content = day(25_200, 24_800, 24_900, 25_199, 25_220)
    assert departing(content, begin=25_200) == ["v25200"]
    assert departing(content, begin=25_200, warm_up=300) == ["v24900", "v25199", "v25200"]
    routes = traffic(content, begin=25_200, warm_up=300)
    assert routes.starting == ("v25200",)
    assert [note for note in routes.notes if "1 of 5" in note and "before 24900 s" in note]
    assert departing(day(10) + FLOW.format('begin="0" end="5" period="1"'), begin=10, warm_up=5) == ["v10"]


def test_what_is_left_out_is_not_checked() -> None:
    bus = '<vehicle id="bus" type="tram" route="q" depart="9:00:00" reroute="true"><stop busStop="b"/></vehicle>'
    assert departing(bus + day(0)) == ["v0"]


def test_actions_of_the_scenario_name_vehicles_of_the_file() -> None:
    actions = [{"do": "brake", "speed": 20, "when": [{"quantity": "gap", "to": "v0", "below": 9}]}]
    own = {"id": "lead", "lane": 1, "s": 160.0, "speed": 25.0, "actions": actions}
    described = with_routes(file(day(0)), traffic=[own])
    fields = {
        others: [problem.field for problem in scenario_problems("x", described.scenario, 0.1, is_whole=True, others=others)]
        for others in (present(described.routes).vehicles, frozenset({"v1"}))
    }
    assert fields == {frozenset({"v0"}): [], frozenset({"v1"}): ["x.traffic[0].actions[0].when[0].to"]}


def test_a_warm_up_before_the_file_s_time_0_is_refused() -> None:
    scenario = with_routes(file(day(0)), warm_up=5, begin=0).scenario
    assert [problem.field for problem in scenario_problems("x", scenario, 0.1, is_whole=True)] == ["x.begin"]


def test_a_file_that_is_missing_or_no_route_file_is_refused() -> None:
    assert "<net>" in refusal(b"<net/>")
    refusal(ROUTES, routes="b.rou.xml")
