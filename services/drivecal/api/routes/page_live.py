"""The page's live connection: a WebSocket that reports on one campaign.

The event stream of `/campaigns/{id}/events` would do, but browsers open at most six connections to a server over HTTP/1.1: the seventh
tab with a stream would load nothing any more. WebSockets are not counted among them.
"""

import asyncio
import json
from collections.abc import AsyncGenerator
from contextlib import aclosing, suppress
from typing import Annotated, Any

from fastapi import APIRouter, Query, WebSocket, WebSocketDisconnect
from fastapi.concurrency import run_in_threadpool

from drivecal.api.dependencies import Limits
from drivecal.api.live.streams import KEEPALIVE_SECONDS, EventHub
from drivecal.api.routes.events import EventId, newest_event
from drivecal.contracts.events import PROGRESS
from drivecal.domain.errors import DrivecalError, NotFoundError, OverloadError

router = APIRouter()

STALLED_SECONDS = 60.0
"""Time after which a page that reads nothing is disconnected; it comes back."""
NOT_UNDERSTOOD, AGAIN_LATER = 1008, 1013
"""Codes with which a connection is closed."""

PROTOCOL = (
    "What the page in the browser needs besides what every client uses.\n\n"
    "`GET /api/v1/live?campaign=ID&after=N` is a WebSocket, which OpenAPI cannot describe. Other clients follow a campaign by its event "
    "stream, `GET /api/v1/campaigns/{campaign_id}/events`, which reports the same. A page sends nothing, and receives JSON:\n\n"
    '- `{"event": {...}}` with each event after number N, as in the event stream,\n'
    '- `{"progress": {...}}` at most twice a second,\n'
    '- `{"ended": true}` after the last event of a campaign that has ended,\n'
    '- `{"alive": true}` if there was nothing else for a while.\n\n'
    "Only pages of the server's own origin may open it. A server without a place refuses it. It is closed with "
    f"{NOT_UNDERSTOOD} if there is no such campaign, the token is no longer valid, or the page "
    f"sends anything, and with {AGAIN_LATER} if the page should try again."
)
"""Protocol of the live connection, in Markdown."""


@router.websocket("/live")
async def live(socket: WebSocket, campaign: Annotated[str, Query(max_length=64)], after: EventId = 0) -> None:
    """Reports on a campaign until the page is gone or the server stops."""
    limits: Limits = socket.app.state.limits
    try:
        place = limits.event_streams.take()
    except OverloadError:
        await socket.close(AGAIN_LATER)
        return
    with place:
        await socket.accept()
        reporting = asyncio.create_task(_report(socket, campaign, after))
        leaving = asyncio.create_task(socket.receive())
        try:
            await asyncio.wait({reporting, leaving}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            reporting.cancel()
            leaving.cancel()
            code, _ = await asyncio.gather(reporting, leaving, return_exceptions=True)
        if not isinstance(code, TimeoutError):  # a page that reads nothing would not read the farewell either
            with suppress(WebSocketDisconnect, RuntimeError):
                await socket.close(code if isinstance(code, int) else NOT_UNDERSTOOD)


async def _report(socket: WebSocket, campaign: str, after: int) -> int:
    """Sends what happens to a campaign. Returns the code to close the connection with."""
    hub: EventHub = socket.app.state.event_hub
    try:
        seen, newest = await run_in_threadpool(newest_event, socket.app.state.database, campaign)
    except NotFoundError:
        return NOT_UNDERSTOOD
    except DrivecalError:
        return AGAIN_LATER
    position = after if after <= newest else 0  # an id that never was here: of a database that was replaced by an older one
    async with aclosing(_contents(hub, seen.sequence, seen.id, position)) as contents:
        async for content in contents:
            if not socket.state.is_admitted():
                return NOT_UNDERSTOOD
            async with asyncio.timeout(STALLED_SECONDS):
                await socket.send_json(content)
    return AGAIN_LATER


async def _contents(hub: EventHub, sequence: int, campaign: str, position: int) -> AsyncGenerator[dict[str, Any]]:
    """Yields what is sent of a campaign until the server stops: by its connection a page notices that it is there."""
    async with aclosing(hub.stream(sequence, campaign, position)) as stream:
        async for messages in stream:
            for message in messages:
                yield {"progress" if message.kind == PROGRESS else "event": json.loads(message.content)}
            if not messages:
                yield {"alive": True}
    if not hub.closed:
        yield {"ended": True}
    while not hub.closed:
        await asyncio.sleep(KEEPALIVE_SECONDS)
        yield {"alive": True}
