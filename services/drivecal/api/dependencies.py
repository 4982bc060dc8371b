"""Dependencies of the handlers."""

import inspect
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from functools import partial, wraps
from typing import Annotated, Any, Self, TypeVar

from anyio import CapacityLimiter, to_thread
from fastapi import Depends, Header, Request

from drivecal.api.http.authorisation import owner_of
from drivecal.api.http.limits import Places
from drivecal.configuration.settings import Settings
from drivecal.storage.engine.database import Database


async def _database(request: Request) -> Database:
    database: Database = request.app.state.database
    return database


DatabaseDependency = Annotated[Database, Depends(_database)]


LARGE_BODIES = 1
"""Large bodies that are read at the same time: each takes up to fifty times its size in memory."""
WAITING_BODIES = 16
"""Large bodies that may wait or be read."""

OPEN_ARCHIVES = 4
"""Archives of problems that may be received or sent at the same time, each whole in memory."""

COMPUTING = 8
"""Rankings, fronts and the like that are computed at the same time. Each further thread that computes delays all others by up to 5 ms at
every turn of the interpreter."""
COMPUTED = 64
"""The same, those included that wait for a thread. Others wait for none of these threads."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the server."""

    settings: Settings
    event_streams: Places
    waiting_bodies: Places
    archives: Places
    computed: Places
    large_bodies: CapacityLimiter
    computing: CapacityLimiter

    @classmethod
    def of(cls, settings: Settings) -> Self:
        """Creates the limits of the settings, with no place taken. Call it in the event loop that uses them."""
        return cls(
            settings,
            event_streams=Places(settings.event_streams, "event streams are open", retry_seconds=10),
            waiting_bodies=Places(WAITING_BODIES, "large documents are being read", retry_seconds=5),
            archives=Places(OPEN_ARCHIVES, "archives of problems are being received or sent", retry_seconds=5),
            computed=Places(COMPUTED, "rankings, fronts and the like are being computed", retry_seconds=5),
            large_bodies=CapacityLimiter(LARGE_BODIES),
            computing=CapacityLimiter(COMPUTING),
        )


async def _limits(request: Request) -> Limits:
    limits: Limits = request.app.state.limits
    return limits


LimitsDependency = Annotated[Limits, Depends(_limits)]


Owner = Annotated[str | None, Depends(owner_of)]
"""Name of the request's token, None on a server without tokens."""


async def _event_stream(limits: LimitsDependency) -> AsyncIterator[None]:
    with limits.event_streams.take():
        yield


EventStreamPlace = Annotated[None, Depends(_event_stream)]
"""Place of a route that streams events, until the stream ends. Raises OverloadError (429) if there is none."""


async def _archive(limits: LimitsDependency) -> AsyncIterator[None]:
    with limits.archives.take():
        yield


ArchivePlace = Annotated[None, Depends(_archive)]
"""Place of a route that sends an archive, until it is sent. Raises OverloadError (429) if there is none."""


IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=200,
        pattern=r"^[\x21-\x7e]+$",
        description="The same key and body give the same answer; the same key with another body is refused (409).",
    ),
]


@dataclass(frozen=True, slots=True)
class Intake:
    """The database, the limits, the owner and the Idempotency-Key of a request for work."""

    database: DatabaseDependency
    limits: LimitsDependency
    owner: Owner
    key: IdempotencyKey = None


IntakeDependency = Annotated[Intake, Depends()]
Accept = Annotated[str, Header(description="text/csv and application/vnd.apache.parquet give the whole table.")]
"""The `Accept` header; declare it with the default `*/*`."""


Answer = TypeVar("Answer")


def computed(handler: Callable[..., Answer]) -> Callable[..., Awaitable[Answer]]:
    """Returns a handler that computes in one of the threads for such answers. Use it below the decorator of the route.

    A request waits for a thread without using one of the others. It raises OverloadError (429) if too many wait already. An answer
    that is sent in pieces needs no thread of these: a client that reads slowly keeps no other from computing.
    """

    @wraps(handler)
    async def limited(*, limits: Limits, **given: Any) -> Answer:
        with limits.computed.take():
            return await to_thread.run_sync(partial(handler, **given), limiter=limits.computing)

    signature = inspect.signature(handler)
    place = inspect.Parameter("limits", inspect.Parameter.KEYWORD_ONLY, annotation=LimitsDependency)
    limited.__signature__ = signature.replace(parameters=[*signature.parameters.values(), place])  # type: ignore[attr-defined]  # FastAPI reads it
    return limited
