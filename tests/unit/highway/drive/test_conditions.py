"""Triggers of actions: quantities between vehicles, edges, delays and what has happened."""

from collections.abc import Sequence
from functools import partial
from math import nan
from typing import Any

import pytest

from drivecal.bundles.highway_actions import CutIn
from drivecal.highway.drive.actions import Events, Moment, Moving, Watch

STEP = 0.5


def action(**trigger: Any) -> CutIn:
    return CutIn.model_validate({"do": "cut_in", "lane": 0} | trigger)


def fired(trigger: CutIn, moments: Sequence[Moment]) -> list[int]:
    """Returns the steps with a due action of `other`."""
    watch, happened = Watch("other", trigger, STEP), Events()
    return [index for index, moment in enumerate(moments) if watch.is_due(moment, happened)]


def moments(*places: tuple[float, float], speeds: tuple[float, float] = (20.0, 30.0)) -> list[Moment]:
    """Moments with the ego vehicle and another one at these s; both are 4 m long."""
    return [
        Moment(
            *(index * STEP, {"ego": Moving(ego, 0.0, speeds[0], 2.0), "other": Moving(other, 0.0, speeds[1], 2.0)}),
            stretch=1.0,
            stretch_at=lambda *_: 1.0,
        )
        for index, (ego, other) in enumerate(places)
    ]


PASSING = moments((100, 80), (110, 95), (120, 120), (130, 145), (140, 170), (150, 195))


@pytest.mark.parametrize(
    ("condition", "steps"),
    [
        ({"quantity": "time", "above": 1.0}, [2, 3, 4, 5]),
        ({"quantity": "speed", "below": 30}, [0, 1, 2, 3, 4, 5]),
        ({"quantity": "speed", "below": 30 + 1e-10, "strict": True}, []),
        ({"quantity": "speed", "above": 30 - 1e-10, "strict": True}, []),
        ({"quantity": "s", "above": 170}, [4, 5]),
        ({"quantity": "gap", "below": 12}, [1, 2, 3]),
        ({"quantity": "gap", "below": 15, "centres": True}, [1, 2, 3]),
        ({"quantity": "gap", "above": 15, "centres": True, "rising": True}, [3]),
        ({"quantity": "headway", "vehicle": "ego", "above": 1.0}, [4, 5]),
        ({"quantity": "headway", "vehicle": "other", "to": "ego", "below": 5}, [0, 1, 2]),
        ({"quantity": "ttc", "below": 1.2}, [1, 2]),
        ({"quantity": "ttc", "vehicle": "ego", "below": 1.2}, [1]),
        ({"quantity": "gap", "below": 12, "delay": 1.0}, [3, 4, 5]),
        ({"quantity": "gap", "below": 12, "delay": 0.75}, [3, 4, 5]),  # not before its time
        ({"quantity": "gap", "to": "nobody", "below": 12}, []),
    ],
)
def test_a_condition_holds_when_its_quantity_is_beyond_the_limit(condition: dict[str, Any], steps: list[int]) -> None:
    assert fired(action(when=[condition]), PASSING) == steps


MEETING = moments((100, 160), (110, 145), (120, 130), (130, 115), (140, 100), speeds=(20.0, -30.0))
"""The other vehicle comes towards the ego vehicle."""


@pytest.mark.parametrize(
    ("condition", "steps"),
    [
        ({"quantity": "speed", "below": 29}, []),
        ({"quantity": "speed", "above": 30}, [0, 1, 2, 3, 4]),
        ({"quantity": "ttc", "below": 0.7}, [1, 2]),
        ({"quantity": "ttc", "vehicle": "ego", "below": 0.7}, [1, 2]),
        ({"quantity": "headway", "below": 1.1}, [1, 2]),
        ({"quantity": "headway", "vehicle": "ego", "to": "other", "below": 2}, [1, 2]),
    ],
)
def test_vehicles_that_meet_are_ahead_of_each_other(condition: dict[str, Any], steps: list[int]) -> None:
    assert fired(action(when=[condition]), MEETING) == steps


PLACE = {"quantity": "distance", "s": 110, "below": 2}


@pytest.mark.parametrize(
    ("change", "steps"),
    [
        ({}, [2]),  # from 95 to 120 m in a step
        ({"s": 122}, [2, 3]),
        ({"s": 80}, [0, 1]),
        ({"s": 85, "rising": True}, [1]),
        ({"s": 78.5}, [0, 1]),
        ({"s": 300}, []),
        ({"s": 77}, []),
        ({"d": 1.5}, [2]),
        ({"d": -3.5}, []),
        ({"d": -3.5, "below": 4}, [2]),
        ({"vehicle": "ego"}, [1, 2]),
        ({"vehicle": "nobody"}, []),
    ],
)
def test_a_place_is_reached_within_a_distance_also_between_two_steps(change: dict[str, Any], steps: list[int]) -> None:
    assert fired(action(when=[PLACE | change]), PASSING) == steps


def test_a_vehicle_against_the_route_reaches_a_place_when_it_is_there() -> None:
    assert fired(action(when=[PLACE | {"s": 122}]), MEETING) == [3]
    assert fired(action(when=[PLACE | {"s": 170}]), MEETING) == []


def test_a_vehicle_without_a_place_on_the_road_reaches_none() -> None:
    lost = [entry._replace(vehicles={**entry.vehicles, "other": Moving(nan, nan, 30.0, 2.0)}) for entry in PASSING]
    assert fired(action(when=[PLACE]), [PASSING[0], *lost[1:4], *PASSING[4:]]) == []


def test_all_conditions_must_hold_at_once() -> None:
    assert fired(action(when=[{"quantity": "s", "above": 120}, {"quantity": "gap", "below": 12}]), PASSING) == [2, 3]


def test_what_comes_after_waits_for_what_was_fulfilled_once() -> None:
    first = {"quantity": "gap", "below": 0}
    assert fired(action(after=[first], when=[{"quantity": "gap", "above": 10}]), PASSING) == [3, 4, 5]
    assert fired(action(after=[first], when=[]), PASSING) == [2, 3, 4, 5]


def test_simple_triggers_are_conditions() -> None:
    assert fired(action(time=1.0), PASSING) == [2, 3, 4, 5]
    assert fired(action(s=170), PASSING) == [4, 5]
    assert fired(action(gap=12), PASSING) == [1, 2, 3]


def test_the_way_since_the_start_counts_in_both_directions() -> None:
    ways: dict[str, list[bool]] = {}
    for name, passing in (("along", PASSING), ("against", PASSING[::-1])):
        happened, watch = Events(), Watch("other", action(when=[{"quantity": "travelled", "above": 60}]), STEP)
        ways[name] = []
        for moment in passing:
            happened.follow(moment.vehicles, STEP)
            ways[name].append(watch.is_due(moment, happened))
    assert ways == {"along": [False, False, False, False, True, True], "against": [False, False, False, False, True, True]}


def test_the_way_since_the_start_is_that_of_the_speed_also_without_a_place_on_the_road() -> None:
    """15 m a step, however far apart the places are along the reference line of a curve."""
    happened = Events()
    for s in (80.0, 90.0, nan, nan, 120.0):
        happened.follow({"other": Moving(s, 0.0, -30.0, 2.0)}, STEP)
    assert happened.travelled == {"other": 60.0}


def test_the_gap_of_others_is_that_along_their_own_way() -> None:
    gap = {"quantity": "gap", "vehicle": "other", "to": "third", "below": 30}
    places = {name: Moving(s, 10.0, 20.0, 2.0) for name, s in (("ego", 0.0), ("other", 100.0), ("third", 140.0))}
    for stretch, steps in ((1.0, []), (0.8, [0])):
        moment = Moment(0.0, places, 0.5, partial(lambda own, s, d: own if (s, d) == (100.0, 10.0) else 9.0, stretch))
        assert fired(action(when=[gap]), [moment]) == steps
        assert fired(action(when=[gap | {"to": "ego"}]), [moment]) == []
        assert fired(action(when=[gap | {"to": "ego", "below": 46}]), [moment]) == [0]


def test_an_action_waits_for_others_to_begin_or_to_be_done() -> None:
    events = Events()
    begins, ends = (Watch("other", action(when=[{name: "first"}]), STEP) for name in ("begun", "done"))
    assert not begins.is_due(PASSING[0], events)
    events.begun.add("first")
    assert begins.is_due(PASSING[0], events)
    assert not ends.is_due(PASSING[0], events)
    events.done.add("first")
    assert ends.is_due(PASSING[0], events)
