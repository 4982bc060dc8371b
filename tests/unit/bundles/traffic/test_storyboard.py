"""References of conditions to parts of a storyboard, and events that end others."""

from __future__ import annotations

import pytest
from tests.support.scenario_files import (
    BESIDE,
    CARS,
    EGO,
    OTHER,
    absolute,
    change_of_lane,
    change_of_speed,
    event,
    of_file,
    refused,
    scenario,
    when_time,
)

from drivecal.bundles.highway_actions import Action

BRAKE = f"<LongitudinalAction>{change_of_speed(absolute(15), 'linear', 'rate', 4)}</LongitudinalAction>"
IDLE = f"<LongitudinalAction>{change_of_speed(absolute(15), 'linear', 'rate', 0)}</LongitudinalAction>"
IN = change_of_lane(BESIDE)


def when_state(kind: str, reference: str, state: str = "completeState") -> str:
    """A condition on the state of a part of the storyboard."""
    return (
        '<Condition name="d" delay="0" conditionEdge="none"><ByValueCondition><StoryboardElementStateCondition '
        f'storyboardElementType="{kind}" storyboardElementRef="{reference}" state="{state}"/></ByValueCondition></Condition>'
    )


def maneuver(name: str, *events: str) -> str:
    return f'<Maneuver name="{name}">{"".join(events)}</Maneuver>'


def story(*maneuvers: str, actor: str = "Other", group: str = "group") -> str:
    """A <Story> of one act and one group of maneuvers."""
    return (
        f'<Story name="story"><Act name="act"><ManeuverGroup name="{group}" maximumExecutionCount="1"><Actors '
        f'selectTriggeringEntities="false"><EntityRef entityRef="{actor}"/></Actors>{"".join(maneuvers)}</ManeuverGroup>'
        "<StartTrigger/></Act></Story>"
    )


def file(*stories: str) -> bytes:
    return scenario(CARS, EGO + OTHER, "".join(stories))


def actions(content: bytes) -> list[Action]:
    return list(of_file(content).scenario.traffic[0].actions)


def two_of_a_name(reference: str, kind: str = "event", state: str = "completeState") -> bytes:
    """Two maneuvers with events of one name, the second of which waits."""
    second = event("go", IN, when_state(kind, reference, state))
    return file(story(maneuver("first", event("go", BRAKE, when_time(2))), maneuver("second", second)))


@pytest.mark.parametrize(
    ("kind", "reference"),
    [
        ("event", "first::go"),
        ("event", "group::first::go"),
        ("event", "act::first::go"),
        ("event", "story::act::group::first::go"),
        ("action", "first::goAction"),
        ("action", "first::go::goAction"),
        ("maneuver", "first"),
    ],
)
def test_a_reference_may_have_names_of_parts_around_before_its_own(kind: str, reference: str) -> None:
    brake, change = actions(two_of_a_name(reference, kind))
    assert change.when is not None
    assert [condition.done for condition in change.when] == [brake.id]


@pytest.mark.parametrize("reference", ["go", "act::go", "story::group::go"])
def test_a_reference_that_fits_two_parts_names_both(reference: str) -> None:
    message = refused(two_of_a_name(reference))
    assert "story::act::group::first::go" in message
    assert "story::act::group::second::go" in message


@pytest.mark.parametrize("reference", ["third::go", "first::group::go", "go::first", "", "::go", "first::"])
def test_a_reference_that_fits_nothing_is_refused(reference: str) -> None:
    assert "there is no event" in refused(two_of_a_name(reference))


def test_a_part_with_the_ego_vehicle_is_another_one_too() -> None:
    content = file(
        story(maneuver("first", event("go", BRAKE)), actor="Ego", group="own"),
        story(maneuver("first", event("go", BRAKE), event("then", IN, when_state("event", "go")))),
    )
    assert "story::act::own::first::go" in refused(content)
    brake, change = actions(content.replace(b'Ref="go"', b'Ref="group::first::go"'))
    assert change.when is not None
    assert [condition.done for condition in change.when] == [brake.id]
    assert "with actions of the traffic" in refused(content.replace(b'Ref="go"', b'Ref="own::first::go"'))


def test_what_waits_inside_of_a_part_for_its_begin_waits_for_nothing_else() -> None:
    _, inside = actions(two_of_a_name("second", "maneuver", "runningState"))
    assert inside.when == []
    brake, outside = actions(two_of_a_name("first", "maneuver", "runningState"))
    assert outside.when is not None
    assert [condition.begun for condition in outside.when] == [brake.id]


@pytest.mark.slow
def test_a_storyboard_with_too_many_parts_is_refused() -> None:
    events = "".join(f'<Event name="e{index}" priority="parallel"/>' for index in range(10_001))
    assert "10,000 parts" in refused(file(story(maneuver("first", events))))


def events_of(priority: str, *others: str) -> bytes:
    """A change of lanes, and an event of this priority during it."""
    late = event("late", BRAKE, when_time(4)).replace('"overwrite"', f'"{priority}"')
    return file(story(maneuver("first", event("in", IN, when_time(3)), late, *others)))


@pytest.mark.parametrize(("priority", "ends"), [("override", True), ("overwrite", True), ("parallel", False), ("skip", False)])
def test_an_event_ends_the_others_of_its_maneuver_by_its_priority(priority: str, ends: bool) -> None:
    change, brake = actions(events_of(priority))
    assert brake.ends == ([change.id] if ends else [])


def test_an_event_ends_neither_those_of_other_maneuvers_nor_actions_of_its_own() -> None:
    both = event("both", IN, when_time(1)).replace(
        "</Action>", f'</Action><Action name="also"><PrivateAction>{BRAKE}</PrivateAction></Action>'
    )
    content = file(story(maneuver("first", both), maneuver("second", event("late", BRAKE, when_time(4)))))
    assert [action.ends for action in actions(content)] == [[], [], []]


def test_an_event_without_effect_ends_none_and_is_noted() -> None:
    idle = events_of("overwrite", event("idle", IDLE, when_time(5)))
    assert [len(action.ends) for action in actions(idle)] == [1, 1]
    assert any("ends no other event" in note for note in of_file(idle).notes)


def test_a_priority_that_is_unknown_is_refused() -> None:
    assert "priority" in refused(events_of("urgent"))


def test_maneuvers_of_catalogs_are_refused() -> None:
    reference = '<CatalogReference catalogName="c" entryName="e"/>'
    assert "<CatalogReference>" in refused(file(story(reference)))
