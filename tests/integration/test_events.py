"""Event streams over real HTTP; what the dispatcher would store is stored by hand."""

import json
import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path

import httpx
import pytest
from sqlalchemy import text
from tests.support.serve import until
from tests.support.server import RunningApi, new_database, serving

from drivecal.api.live import dispatcher_health, streams
from drivecal.client.following import EventParser
from drivecal.contracts.campaign import CampaignProgress
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.events import EventKind
from drivecal.storage import campaigns, events, processes
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "LOOK_SECONDS", 0.05)
    monkeypatch.setattr(dispatcher_health, "GONE_AFTER_SECONDS", math.inf)  # `submit` lets its dispatcher live for centuries


@pytest.fixture
def api(tmp_path: Path) -> Iterator[RunningApi]:
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as running:
        yield running


def submit(database: Database, *, starts: bool = True) -> StoredCampaign:
    """A campaign under a dispatcher that lives; it has the events `queued` and, where it `starts`, `running`."""
    with database.transaction() as connection:
        processes.heartbeat(connection, processes.DISPATCHER, 1, now(), {})
        # no test is about its death unawares
        connection.execute(text("UPDATE processes SET heartbeat_at = '2999-01-01 00:00:00'"))
        stored = campaigns.insert(connection, name="mine", spec={"name": "mine"})
        if starts:
            campaigns.start(connection, stored.sequence)
    return stored


def note(database: Database, campaign: StoredCampaign, *texts: str) -> None:
    """Events, as the dispatcher writes them: together with a change of the row."""
    for item in texts:
        with database.transaction() as connection:
            campaigns.set_resolution(connection, campaign.sequence, {"note": item})
            events.add(connection, campaign.sequence, EventKind.NOTE, {"text": item})


def end(database: Database, campaign: StoredCampaign) -> None:
    with database.transaction() as connection:
        campaigns.end(connection, campaign.sequence, CampaignState.SUCCEEDED)


@contextmanager
def opened(
    api: RunningApi, campaign: StoredCampaign, last: str | None = None, query: str = ""
) -> Iterator[Iterator[dict[str, str]]]:
    """The events of a stream, as they come."""
    headers = {} if last is None else {"Last-Event-ID": last}
    path = f"/api/v1/campaigns/{campaign.id}/events{query}"
    with httpx.stream("GET", api.url + path, headers=headers, timeout=300) as response:
        assert response.status_code == 200
        assert response.headers["content-type"].startswith("text/event-stream")
        parser = EventParser()
        yield (event for chunk in response.iter_bytes() for event in parser.feed(chunk))


def stored_only(received: Iterator[dict[str, str]]) -> list[str]:
    """Returns the kind of each event with an id, or the text of a note, in order of arrival."""
    stored = [event for event in received if "id" in event]
    numbers = [int(event["id"]) for event in stored]
    assert numbers == sorted(set(numbers)), "out of order, or twice"
    return [json.loads(event["data"])["data"].get("text", event["event"]) for event in stored]


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_stream_sends_all_events_and_closes_at_the_end(request: pytest.FixtureRequest, tmp_path: Path, kind: str) -> None:
    with serving(new_database(request, kind, tmp_path)) as api:
        campaign = submit(api.database)
        note(api.database, campaign, "before")
        with opened(api, campaign) as stream:
            assert [next(stream)["event"] for _ in range(3)] == ["queued", "running", "note"]
            progress = next(stream)
            assert (progress["event"], progress.get("id")) == ("progress", None)
            assert CampaignProgress.model_validate_json(progress["data"]).state == "running"
            note(api.database, campaign, "meanwhile")
            end(api.database, campaign)
            rest = list(stream)
        assert stored_only(iter(rest)) == ["meanwhile", "succeeded"]
        assert (rest[-1]["event"], CampaignProgress.model_validate_json(rest[-1]["data"]).state) == ("progress", "succeeded")
        document = json.loads(next(item for item in rest if item["event"] == "succeeded")["data"])
        assert (document["campaign"], document["data"]) == (campaign.id, {"state": "succeeded"})


@pytest.mark.parametrize("by", ["header", "query"])
def test_who_comes_back_gets_what_was_missed_once_and_in_order(api: RunningApi, by: str) -> None:
    campaign, other = submit(api.database), submit(api.database)
    with opened(api, campaign) as stream:
        first = [next(stream) for _ in range(2)]
    last = first[-1].get("id")
    for number in range(5):
        note(api.database, campaign, f"missed {number}")
        note(api.database, other, "of another campaign")
    header, query = (last, "") if by == "header" else (None, f"?last_event_id={last}")
    with opened(api, campaign, header, query) as stream:
        assert stored_only(next(stream) for _ in range(5)) == [f"missed {number}" for number in range(5)]
        note(api.database, campaign, "live")
        end(api.database, campaign)
        assert stored_only(stream) == ["live", "succeeded"]


def test_what_makes_no_sense_is_refused(api: RunningApi) -> None:
    campaign = submit(api.database)
    senseless: list[tuple[str, dict[str, str], int, str]] = [
        (f"{'0' * 32}/events", {}, 404, "there is no campaign"),
        ("%00/events", {}, 404, "there is no campaign"),
        ("{id}/events", {"Last-Event-ID": "x"}, 422, "Last-Event-ID"),
        ("{id}/events", {"Last-Event-ID": "-1"}, 422, "Last-Event-ID"),
        ("{id}/events", {"Last-Event-ID": str(2**63)}, 422, "Last-Event-ID"),
        ("{id}/events?last_event_id=1.5", {}, 422, "last_event_id"),
        ("{id}/events?last=1", {}, 422, "last"),
    ]
    for path, headers, status, said in senseless:
        response = api.http.get(f"/api/v1/campaigns/{path.format(id=campaign.id)}", headers=headers)
        assert (response.status_code, response.headers["content-type"]) == (status, "application/problem+json")
        assert said in response.text


def test_no_more_streams_are_open_than_there_are_places(tmp_path: Path) -> None:
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}", event_streams=2) as api:
        campaign = submit(api.database)
        path = f"/api/v1/campaigns/{campaign.id}/events"
        with opened(api, campaign) as one:
            next(one)
            with opened(api, campaign) as other:
                next(other)
                refused = api.http.get(path)
                assert (refused.status_code, refused.headers["content-type"]) == (429, "application/problem+json")
                assert int(refused.headers["retry-after"]) > 0
                assert api.http.get(f"/api/v1/campaigns/{campaign.id}").status_code == 200
        end(api.database, campaign)
        until(lambda: httpx.get(api.url + path, timeout=300).status_code == 200, "places are free again")


def test_a_silent_dispatcher_is_told_by_answers_and_streams_and_so_is_its_return(api: RunningApi) -> None:
    campaign = submit(api.database)

    def spoke(seconds_ago: float) -> None:
        with api.database.transaction() as connection:
            moment = (now() - timedelta(seconds=seconds_ago)).replace(tzinfo=None)
            connection.execute(text("UPDATE processes SET heartbeat_at = :moment"), {"moment": str(moment)})

    def read() -> tuple[str | None, str]:
        response = api.http.get(f"/api/v1/campaigns/{campaign.id}")
        return response.json()["degraded"], response.headers["etag"]

    with opened(api, campaign) as stream:
        assert [next(stream)["event"] for _ in range(3)] == ["queued", "running", "progress"]
        said, well = read()
        assert said is None
        spoke(4.5)
        degraded, progress = next(stream), next(stream)
        assert (degraded["event"], degraded.get("id")) == ("degraded", None)
        reason = "the dispatcher has been silent for more than 4 s"
        assert json.loads(degraded["data"])["data"] == {"reason": reason}
        assert CampaignProgress.model_validate_json(progress["data"]).degraded == reason
        silent = read()
        assert silent[0] == reason
        assert silent[1] != well
        spoke(5.5)
        assert read() == silent, "the same for a while"
        with api.database.transaction() as connection:
            campaigns.degrade(connection, [campaign.sequence], "no workers")
        assert read()[0] == f"{reason}; it last said: no workers"
        assert api.http.get("/api/v1/campaigns").json()["items"][0]["degraded"] == read()[0]
        spoke(0)
        assert read()[0] == "no workers"
        with api.database.transaction() as connection:
            campaigns.degrade(connection, [campaign.sequence], None)
        assert read() == (None, read()[1])
        end(api.database, campaign)
        kinds = [item["event"] for item in stream if item["event"] != "progress"]
    assert kinds[0] == "degraded"
    assert kinds[-2:] == ["recovered", "succeeded"]


def test_a_stream_gives_signs_of_life_while_nothing_happens(api: RunningApi, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "KEEPALIVE_SECONDS", 0.05)
    campaign = submit(api.database)
    with httpx.stream("GET", f"{api.url}/api/v1/campaigns/{campaign.id}/events", timeout=300) as response:
        received = b""
        for chunk in response.iter_bytes():
            received += chunk
            if received.count(b": ping\n\n") == 3:
                break
    assert received.startswith(b"retry: 2000\n\n")


def test_streams_end_in_peace_when_the_server_stops(tmp_path: Path) -> None:
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as api:
        campaign = submit(api.database)
        reading = opened(api, campaign)
        stream = reading.__enter__()
        assert next(stream)["event"] == "queued"
        listener: list[list[dict[str, str]]] = []
        thread = threading.Thread(target=lambda: listener.append(list(stream)))
        thread.start()
    thread.join(20)
    assert [message["event"] for message in listener[0]] == ["running", "progress"], "an end, not an error"
    reading.__exit__(None, None, None)
