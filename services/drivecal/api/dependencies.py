"""What handlers are given."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Header, Request

from drivecal.storage.database import Database


async def _database(request: Request) -> Database:
    database: Database = request.app.state.database
    return database


DatabaseDependency = Annotated[Database, Depends(_database)]

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
Accept = Annotated[str, Header(description="text/csv and application/vnd.apache.parquet give the whole table.")]
"""To be declared with the default `*/*`."""
