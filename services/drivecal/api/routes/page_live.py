"""The page's live connection: one WebSocket for all campaigns that a page shows.

The event streams of `/campaigns/{id}/events` would do, but browsers open at most six connections to a server over HTTP/1.1: the seventh
tab with a stream would load nothing any more. WebSockets are not counted among them.

What is said over it is in `PROTOCOL`, which the OpenAPI document quotes: it can describe no WebSocket.
"""

import asyncio
import json
from collections.abc import Iterator
from contextlib import aclosing
from typing import Annotated, Any

from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from fastapi.concurrency import run_in_threadpool
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.websockets import WebSocketState

from drivecal.api.dependencies import Limits
from drivecal.api.live.streams import KEEPALIVE_SECONDS, EventHub
from drivecal.api.routes.events import newest_event
from drivecal.contracts.events import PROGRESS
from drivecal.domain.errors import DrivecalError, OverloadError
from drivecal.storage.engine.database import Database

router = APIRouter()

MOST_FOLLOWED = 20
"""Campaigns that one page follows at a time."""
LARGEST_MESSAGE = 1_000
"""Largest message of a client, characters."""
MOST_AT_ONCE = 40
"""Messages of a page that are obeyed at once: it leaves all campaigns and follows as many others."""
SECONDS_FOR_A_MESSAGE = 0.25
"""Shortest mean time between the messages after them. Further ones wait with the page: closing instead would let it send as many anew,
and reading them is what costs most."""
STALLED_SECONDS = 60.0
"""Time after which a page that reads nothing is disconnected; it comes back."""
AGAIN_LATER, NOT_UNDERSTOOD = 1013, 1008

PROTOCOL = (
    "What the page in the browser needs besides what every client uses.\n\n"
    "`GET /api/v1/live` is a WebSocket, which OpenAPI cannot describe. It follows campaigns; other clients follow one by its event "
    "stream, `GET /api/v1/campaigns/{campaign_id}/events`, which tells the same. Messages are JSON. A page sends "
    '`{"follow": ID, "after": N}` and `{"unfollow": ID}`, and is sent\n\n'
    '- `{"campaign": ID, "event": {...}}` with each event after number N, as in the event stream,\n'
    '- `{"campaign": ID, "progress": {...}}` at most twice a second,\n'
    '- `{"campaign": ID, "ended": true}` after the last event of a campaign that has ended,\n'
    '- `{"campaign": ID, "error": "..."}` if it cannot be followed,\n'
    '- `{"alive": true}` if there was nothing else for a while.\n\n'
    f"A page follows {MOST_FOLLOWED} campaigns at most. Browsers are let in from pages of this very origin only; the connection is closed "
    f"with {NOT_UNDERSTOOD} if a message cannot be understood or the token is no longer valid, and refused if the server has no place for "
    f"it. Messages beyond {MOST_AT_ONCE} at once and {1 / SECONDS_FOR_A_MESSAGE:g} a second wait."
)
"""Protocol of the live connection, in Markdown."""

CampaignId = Annotated[str, Field(min_length=1, max_length=64)]


class _Asked(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    follow: CampaignId | None = None
    unfollow: CampaignId | None = None
    after: Annotated[int, Field(ge=0, le=2**63 - 1)] = 0


@router.websocket("/live")
async def live(socket: WebSocket) -> None:
    """Follows campaigns until the page is gone or the server stops."""
    limits: Limits = socket.app.state.limits
    try:
        place = limits.event_streams.take()
    except OverloadError:
        await socket.close(AGAIN_LATER)
        return
    with place:
        await socket.accept()
        await _Line(socket).serve()


class _Line:
    """An open connection."""

    def __init__(self, socket: WebSocket) -> None:
        self._socket = socket
        self._hub: EventHub = socket.app.state.event_hub
        self._database: Database = socket.app.state.database
        self._followed: dict[str, asyncio.Task[None]] = {}
        self._one_at_a_time = asyncio.Lock()
        self._next_due = 0.0

    async def serve(self) -> None:
        """Obeys the page until it is gone, reads nothing any more, or a task fails."""
        try:
            async with asyncio.TaskGroup() as self._tasks:
                alive = self._tasks.create_task(self._stay_alive())
                while self._is_open and await self._obey(await self._socket.receive_text()):
                    await self._keep_pace()
                for task in (alive, *self._followed.values()):
                    task.cancel()
        except* (WebSocketDisconnect, TimeoutError):
            pass

    @property
    def _is_open(self) -> bool:
        return self._socket.application_state is WebSocketState.CONNECTED

    async def _obey(self, message: str) -> bool:
        """Carries out a message. Returns False after closing the connection because of a faulty one."""
        try:
            if len(message) > LARGEST_MESSAGE:
                raise ValueError
            asked = _Asked.model_validate_json(message)
        except (ValidationError, ValueError):
            await self._socket.close(NOT_UNDERSTOOD)
            return False
        if asked.unfollow is not None and asked.unfollow in self._followed:
            self._followed.pop(asked.unfollow).cancel()
        if asked.follow is not None:
            await self._follow(asked.follow, asked.after)
        return True

    async def _keep_pace(self) -> None:
        """Waits until the page may send more. Messages that have arrived are received without a pause: a page that floods the server would
        keep it from all other answers."""
        now = asyncio.get_running_loop().time()
        self._next_due = max(self._next_due, now - MOST_AT_ONCE * SECONDS_FOR_A_MESSAGE) + SECONDS_FOR_A_MESSAGE
        await asyncio.sleep(max(0.0, self._next_due - now))

    async def _follow(self, campaign: str, after: int) -> None:
        if campaign in self._followed:
            self._followed.pop(campaign).cancel()
        self._followed = {name: task for name, task in self._followed.items() if not task.done()}
        if len(self._followed) < MOST_FOLLOWED:
            self._followed[campaign] = self._tasks.create_task(self._tell(campaign, after))
        else:
            await self._send({"campaign": campaign, "error": f"a page follows {MOST_FOLLOWED} campaigns at most"})

    async def _tell(self, campaign: str, after: int) -> None:
        try:
            seen, newest = await run_in_threadpool(newest_event, self._database, campaign)
        except DrivecalError as error:
            await self._send({"campaign": campaign, "error": str(error)})
            return
        position = after if after <= newest else 0  # an id that never was here: of a database that was replaced by an older one
        async with aclosing(self._hub.stream(seen.sequence, seen.id, position)) as chunks:
            async for chunk in chunks:
                for name, number, document in parsed(chunk):
                    if name == PROGRESS:
                        await self._send({"campaign": campaign, "progress": document})
                    else:
                        await self._send({"campaign": campaign, "event": {"id": number} | document})
        if not self._hub.closed:
            await self._send({"campaign": campaign, "ended": True})

    async def _stay_alive(self) -> None:
        while True:
            await asyncio.sleep(KEEPALIVE_SECONDS)
            await self._send({"alive": True})

    async def _send(self, message: dict[str, Any]) -> None:
        async with self._one_at_a_time, asyncio.timeout(STALLED_SECONDS):
            if not self._is_open:
                return
            if self._socket.state.is_admitted():
                await self._socket.send_text(json.dumps(message))
            else:
                await self._socket.close(NOT_UNDERSTOOD)


def parsed(chunk: bytes) -> Iterator[tuple[str, int | None, dict[str, Any]]]:
    """Yields name, number and content of each event in a piece of an event stream."""
    for block in chunk.decode().split("\n\n"):
        fields = dict(line.split(": ", 1) for line in block.splitlines() if ": " in line and not line.startswith(":"))
        if "event" in fields and "data" in fields:
            yield fields["event"], int(fields["id"]) if "id" in fields else None, json.loads(fields["data"])
