"""Files with results of vehicles, test benches and other tools."""

import csv
import io
import json
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from drivecal.contracts import strict_json
from drivecal.contracts.assignments import finite_number, settings
from drivecal.contracts.inventory import ProblemAnswer
from drivecal.domain.errors import InvalidInputError, Problem, file_faults, restated

HEADER = re.compile(r"(?P<name>[^\[]*?)\s*(?:\[(?P<unit>[^\]]*)\])?\s*")
"""A column's name, with its unit in brackets: `gap [m]`."""
PREFIXES = {"parameter_": "parameters", "measure_": "measures"}
"""Optional prefixes of columns, as in tables of evaluations."""


def read_results(path: Path, problem: ProblemAnswer) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Returns the rows of a file, as `POST /results` takes them, and the units that its header names.

    Args:
        path: A CSV, Parquet or JSON file. Its columns are `scenario`, the parameters, and scores or measures.
        problem: The problem, whose names decide what a column is.

    Raises:
        InvalidInputError: The file cannot be read, or has unknown columns or values that are no numbers.
    """
    rows: list[dict[str, Any]] = []
    units: dict[str, str] = {}
    for number, line in enumerate(_lines(path), 1):
        row: dict[str, Any] = {"parameters": {}, "scores": {}, "measures": {}}
        for header, value in line.items():
            parts = HEADER.fullmatch(header)
            name, unit = (parts["name"], parts["unit"]) if parts is not None else (header, None)
            kind, name = _kind(name, problem, str(path))
            if kind != "scenario" and name in row[kind]:
                raise InvalidInputError(Problem(f"{path}, {header}", f"another column is {name}, too", "leave one of them out"))
            if kind == "scenario":
                row |= {} if value is None else {kind: str(value)}
            elif kind == "parameters" and name in problem.shapes and value:
                row[kind] |= settings([f"{name}={value}"], f"{path}, row {number}, {name}")  # a list, or its text
            elif value not in (None, ""):
                row[kind][name] = str(value) if problem.parameters.get(name, {}).get("choices") else finite_number(value)
                if row[kind][name] is None:
                    fault = Problem(f"{path}, row {number}, {name}", f"{value!r} is no number", "give one with a decimal point")
                    raise InvalidInputError(fault)
            if unit is not None and units.setdefault(name, unit) != unit:
                fault = Problem(
                    f"{path}, row {number}, {name}", f"it is in {unit}, and before in {units[name]}", "write one unit"
                )
                raise InvalidInputError(fault)
        if "scenario" not in row:
            raise InvalidInputError(Problem(f"{path}, row {number}", "`scenario` is missing", "name the scenario of each row"))
        rows.append(row)
    if not rows:
        raise InvalidInputError(Problem(str(path), "the file has no rows", "give a row for each set and scenario"))
    return rows, units


def _lines(path: Path) -> list[dict[str, Any]]:
    with file_faults(path, "read", "give a CSV, JSON or Parquet file, texts in UTF-8"):
        if path.suffix.lower() == ".parquet":
            from pyarrow import parquet

            lines: list[dict[str, Any]] = parquet.read_table(io.BytesIO(path.read_bytes())).to_pylist()
            return [{name: None if value != value else value for name, value in line.items()} for line in lines]  # NaN: none
        text = path.read_text("utf-8-sig")
        if path.suffix.lower() != ".json":
            head = text.partition("\n")[0]
            reader = csv.DictReader(io.StringIO(text), delimiter=max(",;\t", key=head.count), restkey="", restval="")
            if twice := [name for name, columns in Counter(reader.fieldnames).items() if columns > 1]:
                raise InvalidInputError(Problem(str(path), f"two columns have the name {twice[0]!r}", "leave one of them out"))
            return list(reader)
        with restated(lambda fault: replace(fault, field=f"{path}, {fault.field}")):
            document = json.loads(text, object_pairs_hook=strict_json.unique_keys)
    if not isinstance(document, list) or not all(isinstance(line, dict) for line in document):
        raise InvalidInputError(Problem(str(path), "it is no list of objects", "write an object for each set and scenario"))
    return document


def _kind(name: str, problem: ProblemAnswer, path: str) -> tuple[str, str]:
    """Returns what a column holds and its name in the problem."""
    if name == "scenario":
        return name, name
    known_names: dict[str, Mapping[str, object]] = {
        "parameters": {**problem.parameters, **problem.shapes},
        "scores": problem.scores,
        "measures": problem.measures,
    }
    for kind, names in known_names.items():
        if name in names:
            return kind, name
    for prefix, kind in PREFIXES.items():
        if name.startswith(prefix) and name.removeprefix(prefix) in known_names[kind]:
            return kind, name.removeprefix(prefix)
    known = ", ".join(["scenario", *known_names["parameters"], *problem.scores, *problem.measures])
    raise InvalidInputError(Problem(path, f"{problem.name} knows no column {name!r}", f"one of {known}"))
