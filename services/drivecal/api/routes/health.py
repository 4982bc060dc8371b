"""Whether the service lives, and whether it can do work. Outside /api, for supervisors and load balancers."""

from __future__ import annotations

from datetime import timedelta

from fastapi import APIRouter, Response

from drivecal.api.dependencies import DatabaseDependency
from drivecal.contracts.inventory import Readiness
from drivecal.domain.errors import DrivecalError
from drivecal.storage import processes
from drivecal.storage.database import Database
from drivecal.storage.types import now

router = APIRouter(tags=["health"])

FRESH = timedelta(seconds=10)
"""A dispatcher that has been silent for longer counts as gone; it speaks every second."""


@router.get("/healthz")
async def alive() -> dict[str, str]:
    """The process answers."""
    return {"status": "alive"}


@router.get("/readyz", responses={503: {"model": Readiness, "description": "Not ready; `problems` says why"}})
def ready(response: Response, database: DatabaseDependency) -> Readiness:
    """Campaigns can be stored, and a dispatcher is there to carry them out. With a worker at work it is ready even where `problems` says
    that others are missing, or refuse somebody's campaign."""
    problems, is_ready = _state(database)
    if not is_ready:
        response.status_code = 503
        response.headers["Retry-After"] = "1"
    return Readiness(ready=is_ready, problems=problems)


def _state(database: Database) -> tuple[list[str], bool]:
    """What is wrong, and whether work can be done all the same."""
    try:
        database.check()
        with database.read() as connection:
            dispatcher = processes.read(connection, "dispatcher")
    except DrivecalError as error:
        return [str(error)], False
    if dispatcher is None:
        return ["no dispatcher has started yet"], False
    silent = now() - dispatcher.heartbeat_at
    if silent > FRESH:
        return [f"the dispatcher has been silent for {silent.total_seconds():.0f} s"], False
    problem = dispatcher.detail.get("degraded")
    if not problem:
        return [], True
    return [str(problem)], any(worker["state"] != "starting" for worker in dispatcher.detail.get("workers", []))
