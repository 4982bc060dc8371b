"""A page that does not read is no longer served, and one that floods the server waits."""

import asyncio
import itertools
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.websockets import WebSocketDisconnect, WebSocketState

from drivecal.api.routes import page_live

FLOOD = 5_000


def test_a_page_that_does_not_read_is_no_longer_served(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_live, "KEEPALIVE_SECONDS", 0.01)
    monkeypatch.setattr(page_live, "STALLED_SECONDS", 0.05)

    async def forever(*_: object) -> None:
        await asyncio.Event().wait()

    page: Any = SimpleNamespace(
        app=SimpleNamespace(state=SimpleNamespace(event_hub=None, database=None)),
        state=SimpleNamespace(is_admitted=lambda: True),
        application_state=WebSocketState.CONNECTED,
        receive_text=forever,
        send_text=forever,
    )
    line = page_live._Line(page)
    asyncio.run(asyncio.wait_for(line.serve(), 20))


def test_a_page_that_sends_without_end_waits_while_others_are_served() -> None:
    received = itertools.count()

    async def at_once() -> str:
        if next(received) == FLOOD:
            raise WebSocketDisconnect
        return '{"unfollow": "nothing"}'

    page: Any = SimpleNamespace(
        app=SimpleNamespace(state=SimpleNamespace(event_hub=None, database=None)),
        application_state=WebSocketState.CONNECTED,
        receive_text=at_once,
    )

    async def served() -> None:
        serving = asyncio.create_task(page_live._Line(page).serve())
        await asyncio.sleep(0.05)
        assert not serving.done()
        serving.cancel()

    asyncio.run(asyncio.wait_for(served(), 20))
    assert page_live.MOST_AT_ONCE <= next(received) < FLOOD / 2
