"""Puts the API together. Nothing is created at import; the database is opened when the server starts."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI

from drivecal.api import problems
from drivecal.api.answers import ROOT
from drivecal.api.limits import BodyLimit
from drivecal.api.routes import campaigns, evaluations, health, influence_maps, inventory, tables
from drivecal.configuration.settings import Settings
from drivecal.storage.database import Database


def create_app(settings: Settings) -> FastAPI:
    """The ASGI application. Raises DatabaseError where the settings name no usable database."""
    database = Database.open(settings.database_url)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        app.state.database = database
        yield
        database.dispose()

    app = FastAPI(
        title="drivecal",
        version=version("drivecal"),
        description="Calibrates the parameters of automated driving functions; errors are problem+json (RFC 9457).",
        lifespan=lifespan,
        redirect_slashes=False,
        responses=problems.RESPONSES,
    )
    app.add_middleware(BodyLimit)
    problems.install(app)
    for router in (campaigns.router, tables.router, evaluations.router, influence_maps.router, inventory.router):
        app.include_router(router, prefix=ROOT)
    app.include_router(health.router)
    return app
