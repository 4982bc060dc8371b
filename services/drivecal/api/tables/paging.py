"""Tables as pages of JSON, or as a whole in CSV and Parquet."""

import io
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Literal

from fastapi import Response
from fastapi.responses import JSONResponse, StreamingResponse
from pydantic import BaseModel

from drivecal.api.http.queries import PARQUET, TableOf, form_of
from drivecal.api.tables.selection import Keeps, Row, selection
from drivecal.configuration.arrow import arrow_schema
from drivecal.contracts.campaign import Page
from drivecal.contracts.tables import Column, csv_text, file_row
from drivecal.storage.engine.records import decode_cursor, encode_cursor


def download(
    name: str, form: Literal["csv", "parquet"], columns: Sequence[Column], pieces: Iterable[Sequence[Row]]
) -> StreamingResponse:
    """Returns the answer with a whole table as a file called `name`."""
    content = csv_pieces(columns, pieces) if form == "csv" else _parquet(columns, pieces)
    media_type = "text/csv; charset=utf-8; header=present" if form == "csv" else PARQUET
    headers = {"Content-Disposition": f'attachment; filename="{name}.{form}"', "Vary": "Accept"}
    return StreamingResponse(content, media_type=media_type, headers=headers)


def csv_pieces(columns: Sequence[Column], pieces: Iterable[Sequence[Row]]) -> Iterator[bytes]:
    """Yields CSV with a header, see `csv_text`; a row may lack columns."""
    names = [column.name for column in columns]
    head = csv_text([names])
    for piece in pieces:
        yield (head + csv_text(map(row.get, names) for row in piece)).encode()
        head = ""
    yield head.encode()


def _parquet(columns: Sequence[Column], pieces: Iterable[Sequence[Row]]) -> Iterator[bytes]:
    from pyarrow import Table, parquet  # takes a while and memory; most servers never write Parquet

    schema = arrow_schema(columns)
    sink = io.BytesIO()

    def taken() -> bytes:
        content = sink.getvalue()
        sink.seek(0)
        sink.truncate()
        return content

    with parquet.ParquetWriter(sink, schema) as writer:  # it counts by itself how much it has written
        for piece in pieces:
            writer.write_table(Table.from_pylist(list(piece), schema=schema))
            yield taken()
    yield taken()


ROWS_AT_A_TIME = 2000
ROWS_AT_FIRST = 250
"""Rows of CSV: readers that take it as it comes, as the page does, have the first rows after an eighth of the time."""

Rows = Sequence[BaseModel] | Sequence[Row]
"""Models, or plain rows that are the same in JSON and in a file."""
Pages = Callable[[int, str | None], tuple[Rows, str | None]]
"""Takes a number of rows and a cursor. Returns at most that number after the cursor, and the cursor of the next row."""
Columns = Callable[[], Sequence[Column]]
"""Returns the columns of a file."""

FILES: dict[str, Any] = {"content": {"text/csv": {}, "application/vnd.apache.parquet": {}}}
"""The OpenAPI description of a table as a file."""


def page_or_file(model: type[BaseModel]) -> dict[int | str, dict[str, Any]]:
    """Returns the OpenAPI description of a table's answer."""
    return {200: {"model": Page[model], "description": "A page, or the whole table", **FILES}}  # type: ignore[valid-type]  # made at run time


def slices(rows: Callable[[int, int], Rows], length: int) -> Pages:
    """Returns the pages of a list that is numbered from 0."""

    def pages(limit: int, cursor: str | None) -> tuple[Rows, str | None]:
        start = 0 if cursor is None else int(decode_cursor(cursor, int)[0])
        following = start + limit
        return rows(start, following), encode_cursor(following) if following < length else None

    return pages


def table_answer(name: str, query: TableOf, accept: str, columns: Columns, pages: Pages) -> Response:
    """Returns a page as JSON, or the whole table as a file called `name`, as the query or the `Accept` header asks."""
    form = form_of(query, accept)
    keeps = selection(query.where, columns()) if query.where else None
    if form == "json":
        rows, following = pages(query.limit, query.cursor)
        wanted = [row for row in rows if keeps is None or keeps(_flat(row))]
        items = [row.model_dump(mode="json") if isinstance(row, BaseModel) else row for row in wanted]
        return JSONResponse({"items": items, "next_cursor": following}, headers={"Vary": "Accept"})
    return download(name, form, columns(), _all(pages, keeps, ROWS_AT_FIRST if form == "csv" else ROWS_AT_A_TIME))


def listed(name: str, query: TableOf, accept: str, columns: Sequence[Column], rows: Sequence[BaseModel]) -> Response:
    """Returns `table_answer` of rows in memory."""
    return table_answer(name, query, accept, lambda: columns, slices(lambda start, stop: rows[start:stop], len(rows)))


def _flat(row: BaseModel | Row) -> Row:
    return file_row(row) if isinstance(row, BaseModel) else row


def _all(pages: Pages, keeps: Keeps | None, first: int) -> Iterator[Sequence[Row]]:
    """Yields every page, the first one of `first` rows, each read in its own transaction, so that a slow reader holds no connection."""
    cursor: str | None = None
    limit = first
    while True:
        rows, cursor = pages(limit, cursor)
        limit = ROWS_AT_A_TIME
        flat = [_flat(row) for row in rows]
        yield flat if keeps is None else [row for row in flat if keeps(row)]
        if cursor is None:
            return
