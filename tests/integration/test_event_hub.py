"""Event streams under random writers and readers, with so little read at once that readers fall behind all the time."""

import asyncio
import random
from contextlib import AbstractContextManager

import pytest
from sqlalchemy import Connection, text
from tests.support.storage import campaign

from drivecal.api.live import streams
from drivecal.api.live.streams import EventHub
from drivecal.contracts.campaign import PROGRESS, CampaignEvent
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import UnavailableError
from drivecal.domain.events import EventKind
from drivecal.storage import campaigns, events
from drivecal.storage.engine.database import Database


@pytest.fixture(autouse=True)
def _little_is_held(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "LOOK_SECONDS", 0.01)
    monkeypatch.setattr(streams, "PAGE", 2)


@pytest.mark.faults("1", "2")
@pytest.mark.parametrize("seed", range(3))
def test_every_reader_gets_every_event_once_and_in_order(database: Database, seed: int) -> None:
    draw = random.Random(seed)
    with database.transaction() as connection:
        sequence, identifier = (stored := campaign(connection)).sequence, stored.id
    done = asyncio.Event()

    def write(count: int) -> None:
        with database.transaction() as connection:
            for _ in range(count):
                events.add(connection, sequence, EventKind.NOTE)
            campaigns.set_resolution(connection, sequence, {})

    async def writer() -> None:
        for _ in range(30):
            await asyncio.to_thread(write, draw.randrange(1, 9))
            await asyncio.sleep(draw.random() * 0.02)
        with database.transaction() as connection:
            campaigns.end(connection, sequence, CampaignState.SUCCEEDED)
        done.set()

    async def reader(hub: EventHub) -> list[int]:
        await asyncio.sleep(draw.random() * 0.3)
        result: list[int] = []
        while True:
            patience = draw.randrange(1, 20)
            stream = hub.stream(sequence, identifier, result[-1] if result else 0)
            async for messages in stream:
                result += [message.id for message in messages if isinstance(message, CampaignEvent) and message.id]
                await asyncio.sleep(draw.choice([0, 0, 0.005, 0.03]))
                patience -= 1
                if not patience and not done.is_set():
                    break  # the connection is lost, and with it nothing
            else:
                return result
            await stream.aclose()

    async def all_of_them() -> list[list[int]]:
        hub = EventHub(database)
        async with asyncio.timeout(60):
            writing = asyncio.create_task(writer())
            read = await asyncio.gather(*(reader(hub) for _ in range(8)))
            await writing
            return read

    read = asyncio.run(all_of_them())
    with database.read() as connection:
        written = [event.id for event in events.since(connection, sequence, 0, 10**6)]
    assert len(written) > 60
    assert read == [written] * 8


def test_forgetting_old_events_skips_what_is_gone_and_loses_nothing_else(database: Database) -> None:
    with database.transaction() as connection:
        stored = campaign(connection)
        for _ in range(10):
            events.add(connection, stored.sequence, EventKind.NOTE)
        campaigns.end(connection, stored.sequence, CampaignState.SUCCEEDED)
        newest = events.newest_id(connection, stored.sequence)
        connection.execute(text("DELETE FROM events WHERE id < :newest"), {"newest": newest})

    async def read() -> list[int | None]:
        hub = EventHub(database)
        async with asyncio.timeout(20):
            sent = [message async for messages in hub.stream(stored.sequence, stored.id, 3) for message in messages]
            return [message.id for message in sent if isinstance(message, CampaignEvent)]

    assert asyncio.run(read()) == [newest]


def test_a_silent_database_and_its_return_are_reported(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    with database.transaction() as connection:
        stored = campaign(connection)
    reason = "the database does not answer"
    away = False
    really = Database.read

    def read(each: Database) -> AbstractContextManager[Connection]:
        if away:
            raise UnavailableError(reason)
        return really(each)

    monkeypatch.setattr(Database, "read", read)

    async def told() -> list[str]:
        nonlocal away
        result = list[str]()
        hub = EventHub(database)
        async with asyncio.timeout(20):
            async for messages in hub.stream(stored.sequence, stored.id, 0):
                told = [(getattr(message, "kind", PROGRESS), message.model_dump_json()) for message in messages]
                result += [f"{kind} {reason in text}" for kind, text in told]
                if result[-1:] == ["progress False"] and not away:
                    away = True
                elif result[-1:] == ["degraded True"]:
                    away = False
                    with database.transaction() as connection:
                        campaigns.request_action(connection, stored.id, "cancel")
        return result

    result = asyncio.run(told())
    assert result[-2:] == ["cancelled False", "progress False"]
    assert "degraded True" in result
