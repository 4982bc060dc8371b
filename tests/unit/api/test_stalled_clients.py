"""Clients that do not read lose their connection and their place, and a page that floods the server waits."""

from __future__ import annotations

import asyncio
import itertools
import socket
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any

import pytest
import uvicorn
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocketDisconnect, WebSocketState
from uvicorn.server import ServerState

from drivecal.api.http import closing
from drivecal.api.http.limits import Concurrency
from drivecal.api.http.protocol import Protocol
from drivecal.api.routes import page_live

MEGABYTE = b"x" * 2**20
FLOOD = 5_000
SIZE = 32
"""Megabytes, more than the buffers of both sockets take in."""


async def whole(scope: Scope, receive: Receive, send: Send) -> None:
    del scope, receive
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": MEGABYTE * SIZE})


async def in_pieces(scope: Scope, receive: Receive, send: Send) -> None:
    del scope, receive
    await send({"type": "http.response.start", "status": 200, "headers": []})
    for number in range(SIZE):
        await send({"type": "http.response.body", "body": MEGABYTE, "more_body": number < SIZE - 1})


async def visited(app: Any, visit: Callable[[socket.socket, Concurrency, ServerState], Awaitable[None]]) -> None:
    """Serves an app, asks it once, and lets `visit` do the rest."""
    limited, state = Concurrency(app), ServerState()
    config = uvicorn.Config(limited, http=Protocol, ws="none", log_config=None, access_log=False)
    config.load()
    loop = asyncio.get_running_loop()
    server = await loop.create_server(lambda: Protocol(config, state, {}), "127.0.0.1", 0)
    with socket.create_connection(server.sockets[0].getsockname()) as client:
        client.setblocking(False)
        await loop.sock_sendall(client, b"GET /table HTTP/1.1\r\nHost: localhost\r\n\r\n")
        await visit(client, limited, state)
    server.close()


async def until(holds: Callable[[], bool]) -> None:
    async with asyncio.timeout(20):
        while not holds():  # noqa: ASYNC110  # the server sets no event
            await asyncio.sleep(0.01)


@pytest.mark.parametrize("app", [whole, in_pieces])
def test_a_client_that_does_not_read_loses_its_connection_and_its_place(app: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(closing, "STALLED_SECONDS", 0.1)

    async def never_read(client: socket.socket, limited: Concurrency, state: ServerState) -> None:
        del client
        await until(lambda: state.total_requests > 0 or limited.places_of_strangers.taken > 0)
        await until(lambda: not state.connections and not limited.places_of_strangers.taken)

    asyncio.run(visited(app, never_read))


@pytest.mark.slow("in_pieces")
@pytest.mark.parametrize("app", [whole, in_pieces])
def test_a_client_that_reads_slowly_gets_the_whole_answer(app: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(closing, "STALLED_SECONDS", 1.5)  # less than the answer takes, more than a busy machine halts

    async def read_slowly(client: socket.socket, limited: Concurrency, state: ServerState) -> None:
        del limited, state
        received = 0
        while received < SIZE * 2**20:
            taken = await asyncio.get_running_loop().sock_recv(client, 2**20)
            assert taken, "the connection was aborted"
            received += len(taken)
            await asyncio.sleep(0.08)

    asyncio.run(asyncio.wait_for(visited(app, read_slowly), 60))


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
