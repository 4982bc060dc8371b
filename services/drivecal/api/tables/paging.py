"""A table as pages of JSON or as a whole in CSV and Parquet, whichever is asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from fastapi import Response
from fastapi.responses import JSONResponse

from drivecal.api.http.queries import TableOf, form_of
from drivecal.api.tables.files import Column, Row, download
from drivecal.storage.engine import cursors

ROWS_AT_A_TIME = 2000

Page = tuple[Sequence[Row], str | None]
Pages = Callable[[int, str | None], Page]
"""Gives at most so many rows from a cursor on, and the cursor of what follows."""


def slices(rows: Callable[[int, int], Sequence[Row]], length: int) -> Pages:
    """Pages of a list that is numbered from 0."""

    def pages(limit: int, cursor: str | None) -> Page:
        start = 0 if cursor is None else int(cursors.decode(cursor, int)[0])
        following = start + limit
        return rows(start, following), cursors.encode(following) if following < length else None

    return pages


def table_answer(name: str, query: TableOf, accept: str, columns: Callable[[], Sequence[Column]], pages: Pages) -> Response:
    """A page as JSON, or the whole table as a file called `name`, as the query or the `Accept` header asks."""
    form = form_of(query, accept)
    if form == "json":
        rows, following = pages(query.limit, query.cursor)
        return JSONResponse({"items": list(rows), "next_cursor": following}, headers={"Vary": "Accept"})
    return download(name, form, columns(), _all(pages))


def _all(pages: Pages) -> Iterator[Sequence[Row]]:
    """Every page, each read in a transaction of its own, so that a slow reader holds no connection."""
    cursor: str | None = None
    while True:
        rows, cursor = pages(ROWS_AT_A_TIME, cursor)
        yield rows
        if cursor is None:
            return
