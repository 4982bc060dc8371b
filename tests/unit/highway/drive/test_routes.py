"""SUMO's route file and options of scenarios."""

from typing import Any
from xml.etree.ElementTree import Element, fromstring

import pytest

from drivecal.bundles.highway import HighwayScenario
from drivecal.domain.errors import InvalidInputError
from drivecal.highway.drive.routes import drivers, is_exact, options, routes_file


def scenario(**changes: Any) -> HighwayScenario:
    given = {"network": "r.net.xml", "route": ["a", "b"], "duration": 20, "ego": {"s": 10, "speed": 20}}
    return HighwayScenario.model_validate(given | changes)


def written(given: HighwayScenario) -> Element:
    return fromstring(routes_file(given))


def test_each_vehicle_has_a_type_and_a_route() -> None:
    root = written(scenario(traffic=[{"s": 1, "speed": 20, "route": ["c", "b"]}, {"s": 9, "speed": 20, "edge": "b"}]))
    routes = {route.get("id"): route.get("edges") for route in root.iter("route")}
    assert routes == {"route-ego": "a b", "route-vehicle0": "c b", "route-vehicle1": "b"}
    assert {kind.get("id") for kind in root.iter("vType")} == {"ego", "vehicle0", "vehicle1"}


def test_drivers_with_a_route_of_their_own_begin_at_their_edge_on_it() -> None:
    own = {"route": ["c", "d", "b"]}
    root = written(scenario(traffic=[{"s": 1, "speed": 20, "edge": "d"} | own], flows=[{"per_hour": 60, "edge": "b"} | own]))
    routes = {route.get("id"): route.get("edges") for route in root.iter("route")}
    assert routes == {"route-ego": "a b", "route-vehicle0": "d b", "route-flow0": "b"}
    with pytest.raises(InvalidInputError) as refused:
        routes_file(scenario(flows=[{"per_hour": 60}, {"per_hour": 60, "edge": "a"} | own]))
    assert [problem.field for problem in refused.value.problems] == ["flows[1].edge"]


def test_ids_are_the_user_s_or_the_next_free_one() -> None:
    vehicles, flows = drivers(
        scenario(traffic=[{"s": 1, "speed": 20}, {"id": "vehicle0", "s": 9, "speed": 20}], flows=[{"id": "x", "per_hour": 60}])
    )
    assert list(vehicles) == ["vehicle0_", "vehicle0"]
    assert list(flows) == ["x"]


def test_a_type_has_the_driver_s_values_and_no_randomness_of_its_own() -> None:
    given = {"s": 1, "speed": 20, "model": "Krauss", "sigma": 0.4, "time_headway": 1.2, "parameters": {"lcAssertive": 2}}
    kind = next(kind for kind in written(scenario(traffic=[given])).iter("vType") if kind.get("id") == "vehicle0")
    expected = {
        "carFollowModel": "Krauss",
        "sigma": "0.4",
        "tau": "1.2",
        "lcAssertive": "2.0",
        "speedDev": "0.0",
        "speedFactor": "1.0",
    }
    assert expected.items() <= kind.attrib.items()
    assert "minGap" not in kind.attrib


def test_all_vehicles_move_in_strips_if_one_does() -> None:
    kinds = written(scenario(traffic=[{"s": 1, "speed": 20, "lane_change": "SL2015"}, {"s": 50, "speed": 20}])).iter("vType")
    assert {kind.get("laneChangeModel") for kind in kinds} == {"SL2015"}


def test_a_desired_speed_holds_whatever_the_limit_is() -> None:
    kind = list(written(scenario(traffic=[{"s": 1, "speed": 20, "desired_speed": 40}])).iter("vType"))[-1]
    assert (kind.get("maxSpeed"), float(kind.get("speedFactor", 0)) * 10 > 40) == ("40.0", True)


def test_flows_are_even_or_random_and_in_the_order_of_their_begins() -> None:
    flows = list(
        written(scenario(flows=[{"per_hour": 600, "begin": 5}, {"per_hour": 1800, "random": True, "end": 100}])).iter("flow")
    )
    assert [flow.get("id") for flow in flows] == ["flow1", "flow0"]
    assert flows[1].get("period") == "6.0"
    assert flows[0].get("period") == "exp(0.5)"
    assert flows[0].get("end") == "20.0"


@pytest.mark.parametrize(
    ("vehicle", "exact"),
    [
        ({}, True),
        ({"model": "Krauss"}, True),
        ({"model": "constant", "actions": [{"do": "cut_in", "time": 1, "lane": 0}]}, True),
        ({"model": "Krauss", "sigma": 0.5}, False),
        ({"model": "EIDM"}, False),
        ({"speed_deviation": 0.1}, False),
        ({"lane_change": "LC2013"}, False),
    ],
)
def test_vehicles_are_added_again_only_if_nothing_is_random(vehicle: dict[str, Any], exact: bool) -> None:
    assert is_exact(scenario(traffic=[{"s": 50, "speed": 20} | vehicle])) is exact
    assert not is_exact(scenario(traffic=[{"s": 50, "speed": 20} | vehicle], flows=[{"per_hour": 60}]))


def test_lane_changes_take_time_and_the_seed_is_the_scenario_s() -> None:
    def option(name: str, model: str) -> str | None:
        given = options(scenario(seed=9, traffic=[{"s": 50, "speed": 20, "lane_change": model}]), "n", "r", 0.1)
        return dict(zip(given[::2], given[1::2], strict=True)).get(name)

    assert option("--seed", "none") == "9"
    assert option("--lanechange.duration", "LC2013") == "3.0"
    assert option("--lateral-resolution", "SL2015") == "0.8"
    assert option("--lanechange.duration", "none") is None


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"per_hour": 900}, {"end": "20.0", "period": "4.0", "departPos": "base", "departSpeed": "max", "departLane": "0"}),
        ({"per_hour": 900, "number": 3}, {"number": "3", "period": "4.0"}),
        ({"per_hour": 900, "number": 30}, {"number": "5", "period": "4.0"}),
        ({"per_hour": 900, "number": 2, "random": True}, {"number": "2", "period": "exp(0.25)"}),
        ({"per_hour": 900, "s": 30, "length": 5, "lane": "free", "speed": "avg"}, {"departPos": "32.5", "departLane": "free"}),
    ],
)
def test_a_flow_says_how_many_enter_when_and_where(given: dict[str, Any], expected: dict[str, str]) -> None:
    flow = next(written(scenario(flows=[given])).iter("flow"))
    assert expected.items() <= flow.attrib.items()
    assert len({"end", "number"} & flow.attrib.keys()) == 1


def test_sumo_s_time_0_is_the_begin_of_the_warm_up() -> None:
    flows = [{"per_hour": 900}, {"per_hour": 900, "begin": -10, "end": 5}, {"per_hour": 900, "begin": 2, "number": 9}]
    first, second, third = written(scenario(warm_up=60, flows=flows)).iter("flow")
    assert [flow.get("begin") for flow in (first, second, third)] == ["0.0", "50.0", "62.0"]
    assert [(flow.get("end"), flow.get("number")) for flow in (first, second, third)] == [
        ("80.0", None),
        ("65.0", None),
        (None, "5"),
    ]
