"""A page that does not read is no longer served."""

import asyncio
from collections.abc import AsyncGenerator
from types import SimpleNamespace
from typing import Any

import pytest

from drivecal.api.http.limits import Places
from drivecal.api.live.streams import Message
from drivecal.api.routes import page_live


def test_a_page_that_does_not_read_is_no_longer_served(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_live, "STALLED_SECONDS", 0.05)
    monkeypatch.setattr(page_live, "newest_event", lambda *_: (SimpleNamespace(sequence=1, id="c"), 0))

    async def forever(*_: object) -> None:
        await asyncio.Event().wait()

    async def accept() -> None:
        pass

    async def stream(*_: object) -> AsyncGenerator[list[Message]]:
        yield []

    places = Places(1, "streams are open", retry_seconds=1)
    hub = SimpleNamespace(stream=stream, closed=False)
    page: Any = SimpleNamespace(
        app=SimpleNamespace(state=SimpleNamespace(limits=SimpleNamespace(event_streams=places), event_hub=hub, database=None)),
        state=SimpleNamespace(is_admitted=lambda: True),
        accept=accept,
        receive=forever,
        send_json=forever,
        close=forever,
    )
    asyncio.run(asyncio.wait_for(page_live.live(page, "c"), 20))
    assert places.taken == 0
