"""Influence maps, and authors of the studies of a campaign."""

from typing import Any

from sqlalchemy import Connection

from drivecal.domain.campaigns import StageName
from drivecal.storage import campaigns, studies
from drivecal.storage.references import influence_maps
from drivecal.storage.references.influence_maps import StoredInfluenceMap


def test_the_studies_about_a_campaign_are_found_whoever_made_them(connection: Connection) -> None:
    stored = influence_maps.insert(
        connection, name="m", source="expert", driving_function="frenet", parameters=[], scenarios={}
    )

    def make(name: str, robustness: dict[str, Any] | None = None, *made: StageName, used: str | None = None) -> str:
        one = campaigns.insert(connection, name=name, spec={"robustness": robustness}, influence_map_id=used)
        for stage in made:
            studies.save(connection, one.sequence, stage, {"items": []})
        return one.id

    first = make("first", {"of": None}, StageName.VALIDATION, StageName.ROBUSTNESS, used=stored.id)
    make("of its sets", {"of": first, "eta": 1}, StageName.ROBUSTNESS)
    make("of its sets, not begun", {"of": first})
    make("of another's sets", {"of": "0" * 32}, StageName.ROBUSTNESS)
    make("of the sets again", {"of": first}, StageName.ROBUSTNESS)
    make("of the map", None, StageName.VALIDATION, used=stored.id)
    make("of no map", None, StageName.VALIDATION)
    one = campaigns.get(connection, first)
    result = studies.about(connection, one.id, one.sequence, one.influence_map_id)
    without_map = studies.about(connection, one.id, one.sequence, None)
    assert [(each.name, each.stage) for each in result] == [
        ("of the map", StageName.VALIDATION),
        ("of the sets again", StageName.ROBUSTNESS),
        ("of its sets", StageName.ROBUSTNESS),
        ("first", StageName.ROBUSTNESS),
        ("first", StageName.VALIDATION),
    ]
    assert result[2].spec == {"robustness": {"of": first, "eta": 1}}
    assert [each.name for each in without_map] == ["of the sets again", "of its sets", "first", "first"]


def test_maps_are_listed_newest_first(connection: Connection) -> None:
    for number in range(3):
        named: dict[str, Any] = {"name": str(number), "source": "expert", "driving_function": "frenet"}
        influence_maps.insert(connection, **named, parameters="highway", scenarios={"S1": {}})
    result: list[StoredInfluenceMap] = []
    cursor = None
    while True:
        page, cursor = influence_maps.page(connection, limit=2, cursor=cursor)
        result.extend(page)
        if cursor is None:
            break
    assert [item.name for item in result] == ["2", "1", "0"]
    assert not any(item.scenarios for item in result), "these may be large"
