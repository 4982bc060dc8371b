"""Whole tables as files: their formats, which one a client asks for, and rows by conditions on columns."""

import asyncio
import csv
import io
import json
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, Literal, cast

import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel
from tests.support.values import faults_of

from drivecal.api.http.queries import TableOf, TableQuery, form_of
from drivecal.api.tables.influence import map_rows
from drivecal.api.tables.paging import ROWS_AT_A_TIME, ROWS_AT_FIRST, download, slices, table_answer
from drivecal.api.tables.selection import selection
from drivecal.calibration_data.characteristics import Characteristic
from drivecal.calibration_data.files import write
from drivecal.campaigns.resolve.maps import map_to_document
from drivecal.campaigns.resolve.spaces import space_to_document
from drivecal.cli.commands.influence import bounds_text
from drivecal.contracts.tables import (
    Column,
    EvaluationRow,
    FrontRow,
    Kind,
    RobustnessRow,
    Solution,
    columns_of,
    file_row,
    spreadsheet_text,
)
from drivecal.domain.influence import Influence, InfluenceMap
from drivecal.domain.parameters import Parameter
from drivecal.storage.references.influence_maps import StoredInfluenceMap

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
        return b"".join([bytes(row, "utf-8") if isinstance(row, str) else bytes(row) async for row in response.body_iterator])

    return asyncio.run(collect())


@given(st.lists(rows, max_size=3))
def test_parquet_gives_back_what_was_written(pieces: list[list[dict[str, Any]]]) -> None:
    table = pq.read_table(io.BytesIO(content("parquet", pieces)))
    assert table.column_names == [column.name for column in COLUMNS]
    assert table.to_pylist() == [row for piece in pieces for row in piece]


@given(st.lists(rows, max_size=3))
def test_csv_gives_back_what_was_written(pieces: list[list[dict[str, Any]]]) -> None:
    lines = list(csv.reader(io.StringIO(content("csv", pieces).decode(), newline="")))
    assert lines[0] == [column.name for column in COLUMNS]
    written = [row for piece in pieces for row in piece]
    assert len(lines) == len(written) + 1
    for line, row in zip(lines[1:], written, strict=True):
        assert line[0] == ("" if row["id"] is None else str(row["id"]))
        assert (float(line[1]) if line[1] else None) == row["score"]
        assert line[2] == spreadsheet_text(row["name"] or "")
        assert line[3] == {None: "", True: "true", False: "false"}[row["audited"]]
        assert (json.loads(line[4]) if line[4] else None) == row["effects"]


FORMULAS = [
    "=cmd|' /C calc'!A0",
    "+1+1",
    "-x",
    "@SUM(A1)",
    "\t=1",
    "\r=1",
    "a;=1+1;b",
    "a\t=1",
    'a;"=1"',
    "a\n=1",
    "; @x",
    "＝1",
    '"=1"',
]


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("text", FORMULAS)
def test_no_reader_of_any_separator_finds_a_formula(text: str, delimiter: str) -> None:
    rows = [{"id": 1, "score": -1.5, "name": text, "audited": None, "effects": [-1.0]}]
    characteristics = [Characteristic(name=text, value=-1.5, unit=text, description=text)]
    for written in (content("csv", [rows]), write("csv", characteristics, None)):
        lines = csv.reader(io.StringIO(written.decode(), newline=""), delimiter=delimiter)
        cells = [cell for line in lines for cell in line]
        assert not [cell for cell in cells if cell.lstrip(' "')[:1] in set("=+@\t\r＝") or (cell[:1] == "-" and cell != "-1.5")]
        assert delimiter != "," or "-1.5" in cells


@pytest.mark.parametrize("text", ["-1.5", "+2", "x=1", "", "'=1", "1;-2", "a-b"])
def test_numbers_and_other_texts_are_written_as_they_are(text: str) -> None:
    assert spreadsheet_text(text) == text


def test_scores_have_whole_columns_on_whole_scales_only() -> None:
    keys: dict[str, list[str] | dict[str, Kind]] = {"constraints": [], "scores": ["S1"], "parameters": {"P1": "number"}}
    for whole, kind in ((True, "integer"), (False, "number")):
        evaluation = {column.name: column.kind for column in EvaluationRow.file_columns({"P1": "number"}, whole_scores=whole)}
        solution = {column.name: column.kind for column in columns_of(Solution, keys, whole_scores=whole)}
        assert (evaluation["score"], solution["score_S1"]) == (kind, kind)
        assert (evaluation["rating"], solution["objective"], evaluation["id"]) == ("number", "number", "integer")
    row = {"rank": 1, "objective": 1, "rating": 1, "scores": {}, "parameters": {}, "iteration": 0, "individual": 0}
    assert file_row(Solution.model_validate(row | {"seeds": [13, 14]}))["seeds"] == "13 14"


OWN_NAMES = sorted({name for model in (EvaluationRow, Solution, FrontRow, RobustnessRow) for name in model.model_fields})


@pytest.mark.parametrize("model", [Solution, FrontRow, RobustnessRow])
def test_no_parameter_shares_a_column_with_anything_else(model: type[BaseModel]) -> None:
    parameters: dict[str, Kind] = dict.fromkeys(
        [*OWN_NAMES, "score_S1", "objective_gap", "answer_S1", "measure_gap", "P1"], "number"
    )
    keys: dict[str, list[str] | dict[str, Kind]] = {
        "scores": ["S1"],
        "objectives": ["gap"],
        "uncertainty": ["gap_error", "gap_lower", "gap_upper"],
        "constraints": ["gap"],
        "values": ["gap@S1"],
        "answers": ["S1"],
    }
    names = [column.name for column in columns_of(model, {**keys, "parameters": parameters})]
    evaluated = [column.name for column in EvaluationRow.file_columns(parameters)]
    assert len(set(names)) == len(names)
    assert len(set(evaluated)) == len(evaluated)
    assert "P1" in names


def test_a_parameter_named_like_a_column_leaves_its_values_alone() -> None:
    row = Solution(
        rank=1, objective=6.0, rating=6.25, scores={"S1": 6}, parameters={"rank": 30.0, "radius": 0.5, "score_S1": 2.0}, iteration=0,
        individual=0,
    )  # fmt: skip
    flat = file_row(row)
    assert (flat["rank"], flat["score_S1"]) == (1, 6)
    assert (flat["parameter_rank"], flat["parameter_radius"], flat["parameter_score_S1"]) == (30.0, 0.5, 2.0)


def test_a_whole_score_is_written_without_a_point() -> None:
    row = Solution(
        rank=1, objective=6.0, rating=6.25, scores={"S1": 6, "S2": 6.5}, parameters={"P1": 1.0}, iteration=0, individual=0
    )
    assert row.model_dump(mode="json")["scores"] == {"S1": 6, "S2": 6.5}
    assert Solution.model_validate_json(row.model_dump_json()) == row
    assert '"S1":6,' in row.model_dump_json()


def test_a_measure_that_a_row_has_not_is_null_as_documented() -> None:
    """A cell without a run has no measures, whose columns are there all the same."""
    extra = EvaluationRow.model_json_schema(mode="serialization")["additionalProperties"]
    assert {"type": "null"} in extra["anyOf"]


def test_the_first_rows_of_a_long_csv_come_before_most_of_them_are_read() -> None:
    asked: list[tuple[int, int]] = []

    def rows(start: int, stop: int) -> list[dict[str, Any]]:
        asked.append((start, stop))
        return [{"id": number} for number in range(start, stop)]

    pages = slices(rows, 10 * ROWS_AT_A_TIME)
    answer = table_answer("table", TableQuery(format="csv"), "*/*", lambda: COLUMNS[:2], pages)

    async def first() -> str:
        return bytes(await anext(aiter(answer.body_iterator))).decode()  # type: ignore[attr-defined]  # it streams

    assert len(asyncio.run(first()).splitlines()) == 1 + ROWS_AT_FIRST
    assert asked[0] == (0, ROWS_AT_FIRST)


@pytest.mark.parametrize(
    ("accept", "form"),
    [
        ("*/*", "json"),
        ("", "json"),
        ("text/csv", "csv"),
        ("TEXT/CSV; charset=utf-8", "csv"),
        ("application/vnd.apache.parquet", "parquet"),
        ("application/json, text/csv", "json"),
        ("text/csv, */*;q=0.1", "csv"),
        ("text/csv;q=0.5, application/json;q=0.9", "json"),
        ("text/html,application/xhtml+xml,*/*;q=0.8", "json"),
        ("text/csv;q=x, application/json", "json"),
        ("text/csv;q=0", "json"),
        (",;q=,", "json"),
    ],
)
def test_the_accept_header_chooses_the_format_unless_the_query_does(accept: str, form: str) -> None:
    assert form_of(TableOf(), accept) == form
    assert form_of(TableOf(format="json"), accept) == "json"


CHOSEN_FROM = [
    Column("outcome", "text"),
    Column("mode", "text"),
    Column("P1", "number"),
    Column("id", "integer"),
    Column("audited", "truth"),
    Column("histogram", "numbers"),
]
ROWS: list[dict[str, Any]] = [
    {"id": 1, "outcome": "reused", "mode": "a=b", "P1": 0.5, "audited": False, "histogram": []},
    {"id": 2, "outcome": "failed", "mode": "eco", "audited": True, "histogram": []},
    {"id": 3, "outcome": "simulated", "mode": "eco", "P1": 2.0, "audited": True, "histogram": []},
    {"id": 4, "outcome": None, "mode": "eco", "P1": -1.5, "audited": False, "histogram": []},
]


def kept(*conditions: str) -> list[int]:
    keeps = selection(conditions, CHOSEN_FROM)
    return [row["id"] for row in ROWS if keeps(row)]


def test_several_values_of_a_column_are_alternatives_and_everything_else_has_to_hold() -> None:
    assert kept() == [1, 2, 3, 4]
    assert kept("outcome=reused", "outcome=simulated") == [1, 3]
    assert kept("outcome=simulated", "mode=eco", "audited=true") == [3]
    assert kept("mode=a=b") == kept("mode = a=b ") == [1]
    assert kept("outcome=") == []


def test_a_range_holds_its_ends_and_no_missing_value() -> None:
    assert kept("P1>=0.5") == [1, 3]
    assert kept("P1>=-1.5", "P1<=0.5") == [1, 4]
    assert kept("id=3") == kept("id = 3") == [3]


@pytest.mark.parametrize(
    "condition",
    ["", "P1", "=3", "unknown=1", "histogram=1", "P1=much", "outcome>=a", "audited=1", "P1>=", "P1>2", "P1>=nan", "P1<=inf"],
)
def test_a_condition_that_cannot_be_read_is_named(condition: str) -> None:
    assert [problem.field for problem in faults_of(selection, ["outcome=reused", condition], CHOSEN_FROM)] == ["where[1]"]


def test_a_choice_has_no_influential_bounds() -> None:
    space = Parameter.choice("mode", ["eco", "sport"]), Parameter.declared("P1", lower=0, upper=2)
    known = InfluenceMap({"S1": {each.name: Influence(influential=True) for each in space}})
    stored = SimpleNamespace(scenarios=map_to_document(known), parameters=space_to_document(space), basis=None)
    rows = map_rows(cast("StoredInfluenceMap", stored))
    assert [(row.lower, row.upper) for row in rows] == [(None, None), (0.0, 2.0)]
    assert [bounds_text(row) for row in rows] == ["everywhere", "0 .. 2"]
