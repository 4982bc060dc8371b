"""Abbreviated ids of campaigns and influence maps."""

import json

import pytest
from tests.support.scripted import Answer, campaign, server

from drivecal.domain.errors import NotFoundError

FULL = "5050a77ddf5e42199c25aff35a3b4568"
OTHER = "5050b77ddf5e42199c25aff35a3b4568"


def listed(*identifiers: str, following: str | None = None, **fields: str) -> Answer:
    items = [{"id": identifier, "name": "mine", "state": "succeeded"} | fields for identifier in identifiers]
    return 200, {"Content-Type": "application/json"}, json.dumps({"items": items, "next_cursor": following}).encode()


def test_the_first_characters_of_an_id_are_enough_and_looked_up_once() -> None:
    with server(listed(FULL, OTHER), campaign("running"), listed(), listed()) as (client, script):
        client.campaign("5050a")
        client.solutions("5050a", weights={"S1": 2, "S2": 0.5})
        list(client.rows("5050a", "evaluations"))
    paths = [path for _, path, _, _ in script.requests]
    assert paths[0].startswith("/api/v1/campaigns?")
    assert paths[1:] == [
        f"/api/v1/campaigns/{FULL}",
        f"/api/v1/campaigns/{FULL}/solutions?weights=S1%3D2%2CS2%3D0.5",
        f"/api/v1/campaigns/{FULL}/evaluations?limit=1000",
    ]


def test_an_ambiguous_beginning_of_an_id_is_refused() -> None:
    with server(listed(FULL, OTHER)) as (client, _), pytest.raises(NotFoundError):
        client.campaign("5050")


@pytest.mark.parametrize("identifier", ["5", "50", "505"])
def test_a_beginning_that_is_too_short_to_be_meant_is_refused(identifier: str) -> None:
    with server(listed(FULL)) as (client, script), pytest.raises(NotFoundError):
        client.full_id(identifier)
    assert script.requests == []


def test_an_id_is_looked_up_among_all_campaigns() -> None:
    """An abbreviation of an old campaign must not hit a newer one."""
    with server(listed(OTHER, following="more"), listed(FULL)) as (client, _), pytest.raises(NotFoundError):
        client.act("5050", "cancel")
    with server(listed(OTHER, following="more"), listed(FULL), campaign("running")) as (client, script):
        client.campaign("5050a")
    assert script.requests[-1][1] == f"/api/v1/campaigns/{FULL}"


def test_ids_in_a_submitted_campaign_may_be_abbreviated() -> None:
    with server(listed(OTHER, source="expert", driving_function="frenet"), listed(FULL), campaign("queued")) as (
        client,
        script,
    ):
        goals = [{"changes": "5050a#2", "at_most": 2}, {"distance": "baseline", "at_most": 1}, {"score": "cost"}]
        given = {"robustness": {"of": "5050a"}, "sensitivity": {"map": "5050b"}, "optimizer": None}
        client.submit(given | {"constraints": goals, "objectives": [{"distance": "5050a"}]})
    sent = json.loads(script.requests[-1][3])
    full = {"constraints": [{"changes": f"{FULL}#2", "at_most": 2}, *goals[1:]], "objectives": [{"distance": FULL}]}
    assert sent == {"robustness": {"of": FULL}, "sensitivity": {"map": OTHER}, "optimizer": None} | full
