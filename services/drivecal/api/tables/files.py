"""Whole tables as CSV or Parquet, written piece by piece, so that a table of any size needs the memory of one piece."""

import csv
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, Literal

from fastapi.responses import StreamingResponse

from drivecal.api.http.queries import PARQUET
from drivecal.client.arrow import arrow_schema, arrow_table
from drivecal.contracts.tables import Column, spreadsheet_text

Row = Mapping[str, Any]
_AS_THEY_ARE = frozenset({int, float, type(None)})
"""Types whose values CSV holds as Python writes them; truth has a type of its own."""
_text = lru_cache(maxsize=1024)(spreadsheet_text)


def download(
    name: str, form: Literal["csv", "parquet"], columns: Sequence[Column], pieces: Iterable[Sequence[Row]]
) -> StreamingResponse:
    """Returns the answer with a whole table as a file called `name`."""
    content = _csv(columns, pieces) if form == "csv" else _parquet(columns, pieces)
    media_type = "text/csv; charset=utf-8; header=present" if form == "csv" else PARQUET
    headers = {"Content-Disposition": f'attachment; filename="{name}.{form}"', "Vary": "Accept"}
    return StreamingResponse(content, media_type=media_type, headers=headers)


def _csv(columns: Sequence[Column], pieces: Iterable[Sequence[Row]]) -> Iterator[bytes]:
    """Yields CSV (RFC 4180) with a header: missing values are empty, truth is `true` and `false`, lists are JSON, floats round-trip.

    Texts that a spreadsheet would carry out as a formula begin with an apostrophe.
    """
    text = io.StringIO()
    writer = csv.writer(text)
    names = [column.name for column in columns]
    writer.writerow(names)
    for piece in pieces:
        for row in piece:
            values = [row[name] for name in names]
            # Most are numbers or missing: calls for them would take half of the time.
            writer.writerow([value if type(value) in _AS_THEY_ARE else _plain(value) for value in values])
        yield text.getvalue().encode()
        text.seek(0)
        text.truncate()
    yield text.getvalue().encode()


def _plain(value: object) -> object:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        return json.dumps(value)
    return _text(value) if isinstance(value, str) else value


def _parquet(columns: Sequence[Column], pieces: Iterable[Sequence[Row]]) -> Iterator[bytes]:
    from pyarrow import parquet  # takes a while and memory; most servers never write Parquet

    schema = arrow_schema(columns)
    sink = _Sink()
    with parquet.ParquetWriter(sink, schema) as writer:
        for piece in pieces:
            writer.write_table(arrow_table(schema, piece))
            yield sink.take()
    yield sink.take()


class _Sink(io.RawIOBase):
    """A file that collects written bytes until they are taken."""

    def __init__(self) -> None:
        super().__init__()
        self._pieces: list[bytes] = []
        self._position = 0

    def writable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._position

    def write(self, content: Any) -> int:
        piece = bytes(content)
        self._pieces.append(piece)
        self._position += len(piece)
        return len(piece)

    def take(self) -> bytes:
        content, self._pieces = b"".join(self._pieces), []
        return content
