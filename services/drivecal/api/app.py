"""Composition of the API. Nothing is created at import."""

import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache
from importlib.metadata import version
from typing import Any

from fastapi import APIRouter, Depends, FastAPI
from starlette.routing import BaseRoute

from drivecal.api.dependencies import Limits
from drivecal.api.http import problems, queries
from drivecal.api.http.authorisation import OPEN, Authorisation
from drivecal.api.http.limits import BodyLimit
from drivecal.api.http.requests import RequestRecords
from drivecal.api.live.streams import EventHub
from drivecal.api.live.worker_time import RecentWork
from drivecal.api.metrics import Meters
from drivecal.api.responses import ROOT
from drivecal.api.results import routes as results
from drivecal.api.routes import (
    campaigns,
    comparisons,
    evaluations,
    events,
    health,
    influence_maps,
    inventory,
    outside,
    page,
    page_session,
    stored_results,
    tables,
    user_problems,
)
from drivecal.configuration.pushing import OFF, Pushing
from drivecal.configuration.settings import Settings
from drivecal.configuration.tokens import TokenFile
from drivecal.domain.errors import DatabaseError, UnavailableError
from drivecal.storage.admission import add_installed
from drivecal.storage.engine.database import PROMPT, Database

log = logging.getLogger(__name__)

EVENTS = "text/event-stream"


def store_installed(database: Database) -> None:
    """Stores the installed problems. A database that cannot be used is told by `/readyz`; campaigns find these problems without it."""
    try:
        database.check()
        with database.transaction() as connection:
            add_installed(connection)
    except (DatabaseError, UnavailableError) as error:
        log.warning("the installed problems are not listed: %s", error)
    finally:
        database.dispose()  # a connection of the start would outlive its file


def create_app(settings: Settings, pushing: Pushing = OFF) -> FastAPI:
    """Creates the ASGI application. `pushing`: who may push problems; by default no user.

    Raises DatabaseError if the database is unusable, InvalidInputError if the tokens file is.
    """
    database = Database.open(settings.database_url, PROMPT)
    meters = Meters(database)
    tokens = None if settings.tokens_file is None else TokenFile(settings.tokens_file)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        app.state.database = database
        app.state.recent_work = RecentWork()
        app.state.meters = meters
        app.state.pushing = pushing
        app.state.tokens = tokens
        app.state.limits = limits = Limits.of(settings)
        meters.event_streams.set_function(lambda: limits.event_streams.taken)
        store_installed(database)
        app.state.event_hub = EventHub(database)
        yield
        app.state.event_hub.close()
        database.dispose()

    app = FastAPI(
        title="drivecal",
        version=version("drivecal"),
        description="Calibrates the parameters of automated driving functions; errors are problem+json (RFC 9457).",
        lifespan=lifespan,
        redirect_slashes=False,
        docs_url=None,  # FastAPI's own pages load scripts of other hosts; see routes.page
        redoc_url=None,
    )
    app.add_middleware(Authorisation, tokens=tokens)
    app.add_middleware(
        BodyLimit,
        others={user_problems.PATH: settings.problem_mb * 2**20}
        | dict.fromkeys(stored_results.PATHS, stored_results.BODY_MB * 2**20),
    )
    app.add_middleware(RequestRecords, meters=meters)  # the last one is the first that a request meets
    problems.install(app)
    app.router.routes.extend(_routes())
    _describe(app, asks_for_tokens=tokens is not None)
    return app


@cache
def _routes() -> list[BaseRoute]:
    """Every route, built once in a process: FastAPI would read the signatures of all handlers again for each application."""
    router = APIRouter(responses=problems.RESPONSES, dependencies=[Depends(queries.check_names)])
    for noun in (
        campaigns,
        comparisons,
        events,
        tables,
        results,
        evaluations,
        stored_results,
        influence_maps,
        user_problems,
        inventory,
        outside,
        page_session,
    ):
        router.include_router(noun.router, prefix=ROOT)
    router.include_router(page.router)
    router.include_router(health.router)
    return router.routes


def _describe(app: FastAPI, *, asks_for_tokens: bool) -> None:
    """Completes the OpenAPI document that `app` shows."""
    made: dict[str, Any] = {}

    def document() -> dict[str, Any]:
        if not made:
            made.update(FastAPI.openapi(app))
            _complete(made)
            if asks_for_tokens:
                _ask_for_tokens(made)
        return made

    app.openapi = document  # type: ignore[method-assign]  # FastAPI's own way to extend it


def _complete(node: object) -> None:
    """Completes schemas: objects with patterned keys refuse others, and event streams describe their events."""
    if isinstance(node, dict):
        if "patternProperties" in node:
            node.setdefault("additionalProperties", False)
        if EVENTS in node:
            node[EVENTS] = {"schema": _event(node[EVENTS].get("schema", {}))}
        for inner in node.values():
            _complete(inner)
    elif isinstance(node, list):
        for inner in node:
            _complete(inner)


def _event(data: dict[str, Any]) -> dict[str, Any]:
    """Returns the schema of a stream's event, with JSON text as data; before OpenAPI 3.2 it stands for the stream."""
    content = {key: value for key, value in data.items() if key not in {"type", "title"}}
    text = {"type": "string"}
    parts = {"id": text, "event": text, "data": text | {"contentMediaType": "application/json", "contentSchema": content}}
    return {"type": "object", "properties": parts, "required": ["data"]}


def _ask_for_tokens(document: dict[str, Any]) -> None:
    scheme = {"type": "http", "scheme": "bearer", "description": "A token of the server's tokens file"}
    document.setdefault("components", {})["securitySchemes"] = {"token": scheme}
    document["security"] = [{"token": []}]
    for path in OPEN & document["paths"].keys():
        for operation in document["paths"][path].values():
            operation["security"] = []
