"""Answers that are computed for long: rankings, fronts, importances. They have a few threads of their own.

The others share one pool of threads, /readyz among them: forty slow rankings would keep a health check waiting.
"""

import inspect
from collections.abc import Awaitable, Callable
from functools import partial, wraps
from typing import Any, TypeVar

from anyio import to_thread

from drivecal.api.dependencies import Limits, LimitsDependency

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
