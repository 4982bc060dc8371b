"""Whole tables as files."""

from __future__ import annotations

import asyncio
import csv
import io
import json
from collections.abc import Sequence
from typing import Any, Literal

import pyarrow.parquet as pq
from hypothesis import given, settings
from hypothesis import strategies as st

from drivecal.api.tables.files import download
from drivecal.contracts.tables import Column

COLUMNS = [
    Column("id", "integer"),
    Column("score", "number"),
    Column("name", "text"),
    Column("audited", "truth"),
    Column("effects", "numbers"),
]
finite = st.floats(allow_nan=False, allow_infinity=False)
rows = st.lists(
    st.fixed_dictionaries(
        {
            "id": st.none() | st.integers(-(2**63), 2**63 - 1),
            "score": st.none() | finite,
            "name": st.none() | st.text(st.characters(codec="utf-8", exclude_characters="\r\0")),
            "audited": st.none() | st.booleans(),
            "effects": st.none() | st.lists(st.none() | finite),
        }
    ),
    max_size=5,
)


def content(form: Literal["csv", "parquet"], pieces: Sequence[list[dict[str, Any]]]) -> bytes:
    async def collect() -> bytes:
        response = download("table", form, COLUMNS, pieces)
        return b"".join(
            [bytes(piece, "utf-8") if isinstance(piece, str) else bytes(piece) async for piece in response.body_iterator]
        )

    return asyncio.run(collect())


@settings(deadline=None)
@given(st.lists(rows, max_size=3))
def test_parquet_gives_back_what_was_written(pieces: list[list[dict[str, Any]]]) -> None:
    table = pq.read_table(io.BytesIO(content("parquet", pieces)))
    assert table.column_names == [column.name for column in COLUMNS]
    assert table.to_pylist() == [row for piece in pieces for row in piece]


@settings(deadline=None)
@given(st.lists(rows, max_size=3))
def test_csv_gives_back_what_was_written(pieces: list[list[dict[str, Any]]]) -> None:
    lines = list(csv.reader(io.StringIO(content("csv", pieces).decode(), newline="")))
    assert lines[0] == [column.name for column in COLUMNS]
    written = [row for piece in pieces for row in piece]
    assert len(lines) == len(written) + 1
    for line, row in zip(lines[1:], written, strict=True):
        assert line[0] == ("" if row["id"] is None else str(row["id"]))
        assert (float(line[1]) if line[1] else None) == row["score"]
        assert line[2] == (row["name"] or "")
        assert line[3] == {None: "", True: "true", False: "false"}[row["audited"]]
        assert (json.loads(line[4]) if line[4] else None) == row["effects"]
