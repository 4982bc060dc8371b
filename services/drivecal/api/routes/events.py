"""The event stream of a campaign."""

import asyncio
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import aclosing
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import StreamingResponse
from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event
from pydantic import Field
from starlette.types import Send

from drivecal.api.dependencies import DatabaseDependency, EventStreamPlace
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import Parameters
from drivecal.api.live.streams import EventHub, Sent
from drivecal.contracts.campaign import PROGRESS, CampaignEvent, CampaignProgress
from drivecal.domain.events import EventKind
from drivecal.storage import events, revision_queries
from drivecal.storage.engine.database import Database

router = APIRouter(prefix="/campaigns", tags=["campaigns"], route_class=StrictRoute)

STALLED_SECONDS = 60.0
"""Time after which a client that reads nothing is disconnected; it can resume."""

RETRY_MILLISECONDS = 2_000
"""Time after which a client whose stream broke off is asked to come back."""

EventId = Annotated[int, Field(ge=0, le=2**63 - 1)]

STREAM = f"""Events as `text/event-stream`: {", ".join(f"`{kind}`" for kind in EventKind)}, each with its `id`, its name as `event`, and as
`data` a `CampaignEvent`; in between, at most twice a second and without an id, `progress` with a `CampaignProgress`. Also
without an id: `degraded` and `recovered`, which no process can store while the dispatcher or the database is silent."""


class EventsOf(Parameters):
    """Start of a stream."""

    last_event_id: EventId | None = None
    """The last event that was received, for tools that cannot send the header `Last-Event-ID`."""


class EventStream(StreamingResponse):
    """A stream that ends when its client does not read it, or `is_admitted` no more."""

    media_type = "text/event-stream"

    def __init__(self, messages: AsyncGenerator[Sequence[Sent]], is_admitted: Callable[[], bool]) -> None:
        # Buffering proxies would hold events back until there are many.
        self._chunks, self._is_admitted = encoded(messages), is_admitted
        super().__init__(self._chunks, headers={"Cache-Control": "no-cache", "X-Accel-Buffering": "no"})

    async def stream_response(self, send: Send) -> None:
        """Sends chunk by chunk."""
        await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
        async with aclosing(self._chunks):
            async for chunk in self._chunks:
                if not self._is_admitted():
                    break
                async with asyncio.timeout(STALLED_SECONDS):
                    await send({"type": "http.response.body", "body": chunk, "more_body": True})
        await send({"type": "http.response.body", "body": b"", "more_body": False})


async def encoded(stream: AsyncGenerator[Sequence[Sent]]) -> AsyncGenerator[bytes]:
    """Yields the text of an event stream."""
    yield format_sse_event(retry=RETRY_MILLISECONDS)
    async with aclosing(stream):
        async for messages in stream:
            yield b"".join(map(_event, messages)) or KEEPALIVE_COMMENT


def _event(sent: Sent) -> bytes:
    number, kind = (None, PROGRESS) if isinstance(sent, CampaignProgress) else (sent.id, sent.kind)
    return format_sse_event(id=None if number is None else str(number), event=kind, data_str=sent.model_dump_json())


@router.get(
    "/{campaign_id}/events",
    status_code=200,  # FastAPI would look for it in the signature of the class
    response_class=EventStream,
    responses={
        200: {"description": STREAM, "model": CampaignEvent | CampaignProgress},
        204: {"description": "The campaign has ended, and the client has all of its events: there is no need to come back"},
    },
)
async def stream(
    campaign_id: str,
    request: Request,
    query: Annotated[EventsOf, Query()],
    database: DatabaseDependency,
    place: EventStreamPlace,
    last_event_id: Annotated[EventId | None, Header(alias="Last-Event-ID")] = None,
) -> Response:
    """Events of a campaign, from its beginning or after the event `Last-Event-ID`, past and future. The stream
    closes when the campaign has ended and when the server stops: come back with the last id, and nothing is missed or told twice. It
    also closes if the token is no longer valid.

    Old events are forgotten after a while, the last one of a campaign never. Single evaluations have a stream as well.
    """
    del place  # held until the stream ends
    last = last_event_id if last_event_id is not None else query.last_event_id
    hub: EventHub = request.app.state.event_hub
    seen, newest = await run_in_threadpool(newest_event, database, campaign_id)
    if last is not None and last == newest and seen.state.ended:
        return Response(status_code=204)
    if last is None or last > newest:  # an id that never was here: of a database that was replaced by an older one
        last = 0
    return EventStream(hub.stream(seen.sequence, seen.id, last), request.state.is_admitted)


def newest_event(database: Database, campaign_id: str) -> tuple[revision_queries.CampaignRevision, int]:
    """Returns the revision of a campaign and the id of its newest event."""
    with database.read() as connection:
        seen, _ = revision_queries.campaign_revision(connection, campaign_id)
        return seen, events.newest_id(connection, seen.sequence)
