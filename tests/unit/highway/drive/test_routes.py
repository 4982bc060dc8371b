"""SUMO's route file and options of scenarios."""

from typing import Any
from xml.etree.ElementTree import Element, fromstring

import pytest

from drivecal.bundles.highway import HighwayScenario
from drivecal.highway.drive.routes import entries, is_exact, options, routes_file


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
    own = {"route": ["c", "d", "b"], "s": 1, "speed": 20}
    root = written(scenario(traffic=[{"edge": "d"} | own, {"edge": "b"} | own]))
    routes = {route.get("id"): route.get("edges") for route in root.iter("route")}
    assert routes == {"route-ego": "a b", "route-vehicle0": "d b", "route-vehicle1": "b"}


def test_ids_are_the_user_s_or_the_next_free_one() -> None:
    vehicles = entries(scenario(traffic=[{"s": 1, "speed": 20}, {"id": "vehicle0", "s": 9, "speed": 20}]))
    assert list(vehicles) == ["vehicle0_", "vehicle0"]


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
    assert not is_exact(scenario(traffic=[{"s": 50, "speed": 20} | vehicle], routes="r.rou.xml"))


def test_lane_changes_take_time_and_the_seed_is_the_scenario_s() -> None:
    def option(name: str, model: str) -> str | None:
        given = options(scenario(seed=9, traffic=[{"s": 50, "speed": 20, "lane_change": model}]), "n", "r", 0.1)
        return dict(zip(given[::2], given[1::2], strict=True)).get(name)

    assert option("--seed", "none") == "9"
    assert option("--lanechange.duration", "LC2013") == "3.0"
    assert option("--lateral-resolution", "SL2015") == "0.8"
    assert option("--lanechange.duration", "none") is None
