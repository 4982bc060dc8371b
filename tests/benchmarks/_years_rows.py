"""Years of rows: a group of campaigns that a dispatcher carries out, and copies of the group with numbers, sets and setups of their own.

A copy keeps what `drivecal db check` promises, because its rows differ from those of the group in numbers, moments and parameter P1 alone.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any

import numpy as np
from sqlalchemy import Connection, text
from tests.support.computed import ComputedBackend, computed
from tests.support.problems import MANIFEST, store
from tests.support.runs import EXPERT_SPACE, post_map, run, submit

from drivecal.campaigns.resolve.maps import stored_map
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.setups import fingerprint_of
from drivecal.reduction.keys import ReferenceKeys
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps, reference_keys

SCENARIOS = ("S1", "S2", "S3", "S4", "S5", "S6")
SPACE = [parameter | {"step": 0.01} for parameter in EXPERT_SPACE]
METRICS = (
    *("comfort", "peak_lateral_acceleration_mps2", "peak_lateral_jerk_mps3", "peak_longitudinal_acceleration_mps2"),
    *("peak_longitudinal_jerk_mps3", "lateral_acceleration_rms_mps2", "longitudinal_acceleration_rms_mps2"),
    *("peak_yaw_rate_radps", "offset_rms_m", "offset_peak_m", "offset_overshoot_m", "steering_reversals_per_minute"),
    *("iso2631_lateral_rms_mps2", "iso2631_longitudinal_rms_mps2", "iso2631_horizontal_rms_mps2"),
    *("iso2631_lateral_msdv_mps15", "iso2631_longitudinal_msdv_mps15"),
)
"""Names as long and as many as those of a simulator of vehicles."""
YEARS = 2
SHIFT = 10_000
"""By which P1 of a copy is larger than P1 of the copy before, billionths."""
COUNTED = (
    "influence_maps",
    "campaigns",
    "setups",
    "parameter_sets",
    "runs",
    "reference_indexes",
    "lots",
    "evaluations",
    "events",
)
"""Tables whose rows are numbered."""


def grow(database: Database, cells: int, problems: int, progress: Callable[[str], None]) -> None:
    """Fills an empty database with about this many cells; every second group has the first setups, the others take turns with those of
    `problems` variants."""
    for number in range(problems):
        store(database, MANIFEST | {"problem": f"heater-{number}"})
    _carry_out(database)
    with database.transaction() as connection:
        group = _Group(connection)
        copies = max(1, -(-cells // group.cells))
        group.move(connection, _moment(0, copies))
    for number in range(1, copies):
        with database.transaction() as connection:
            group.copy(connection, number, 0 if number % 2 == 0 else 1 + number // 2 % (problems - 1), _moment(number, copies))
        if number % 50 == 0:
            progress(f"{number * group.cells:,} of {cells:,} cells")
    with database.transaction() as connection:
        _follow_numbers(connection)
    index_references(database)
    with database.transaction() as connection:
        connection.execute(text("ANALYZE") if connection.dialect.name == "postgresql" else text("PRAGMA optimize"))


def _carry_out(database: Database) -> None:
    """Runs four campaigns: by references with a map, a rerun of it under other weights, exact, and predicted; the third with a
    robustness study."""
    regions = {"P2": {"influential": True, "lower": 0.5, "upper": 0.5}, "P9": {"influential": False}}
    stored = post_map(database, dict.fromkeys(SCENARIOS, regions))
    common: dict[str, Any] = {"parameters": SPACE, "catalogue": list(SCENARIOS)}
    search = {"kind": "genetic", "population": 50, "iterations": 5, "seed": 1}
    backend = ComputedBackend(answer=measured)
    run(database, submit(database, stored_map=stored, optimizer=search, **common), backend)
    run(database, submit(database, stored_map=stored, optimizer=search, weights={"S1": 3, "S2": 0}, **common), backend)
    exact: dict[str, Any] = {
        "optimizer": search | {"seed": 2},
        "reduction": {"mode": "exact"},
        "robustness": {"delta": 0.02, "steps": 2, "samples": 3, "solutions": 2},
    }
    run(database, submit(database, **exact, **common), backend)
    predicted = {"mode": "predicted", "confirm": 0}
    run(database, submit(database, optimizer=search | {"seed": 3}, reduction=predicted, **common), backend)


def measured(scenario: str, cell: Cell) -> CellResult:
    """Metrics as many and as long as those of the built-in problem."""
    result = replace(computed(scenario, cell), milliseconds=40.0 + cell.id % 1000 / 7)
    values = [result.rating or 0.0, *(float(np.sin(cell.id * factor)) for factor in range(2, len(METRICS) + 1))]
    return replace(result, metrics=dict(zip(METRICS, values, strict=True)))


def _moment(number: int, copies: int) -> datetime:
    """The begin of a copy: they are spread evenly over the years up to yesterday."""
    return datetime.now(UTC) - timedelta(days=1) - timedelta(days=365 * YEARS) * (1 - number / copies)


class _Group:
    """The rows of the first campaigns, read once and copied with other numbers."""

    def __init__(self, connection: Connection) -> None:
        self._kept: dict[str, dict[str, tuple[list[Any], list[int]]]] = {}
        self._last = {
            name: connection.scalar(text(f"SELECT coalesce(max({_number(name)}), 0) FROM {name}")) for name in COUNTED
        }
        self.cells = int(connection.scalar(text("SELECT count(*) FROM evaluations")) or 0)
        rows = connection.execute(text("SELECT id, parameter_values FROM parameter_sets ORDER BY id"))
        self._sets = {number: ParameterSet.from_json(values) for number, values in rows}
        self._setups = [dict(row) for row in connection.execute(text("SELECT * FROM setups ORDER BY id")).mappings()]
        self._campaigns = [row.id for row in connection.execute(text("SELECT id FROM campaigns ORDER BY sequence"))]
        self._keys = self._class_keys(connection)
        self._made: set[int] = {0}

    def move(self, connection: Connection, moment: datetime) -> None:
        """Puts the first group itself at a moment."""
        connection.execute(
            text("UPDATE campaigns SET created_at = :at, started_at = :at, ended_at = :at"), {"at": _stored(moment)}
        )

    def copy(self, connection: Connection, number: int, problem: int, moment: datetime) -> None:
        """Stores the copy of this number."""
        fingerprints = self._ensure_setups(connection, problem)
        shifted = [_shifted(parameter_set, number) for parameter_set in self._sets.values()]
        first = self._last["parameter_sets"] * number
        rows = [(first + old, one.key, one.to_json()) for old, one in zip(self._sets, shifted, strict=True)]
        _insert(connection, "parameter_sets (id, key, parameter_values)", rows)
        keys = self._shifted_keys(connection, number)
        names = {old: f"{int(old, 16) ^ number * 0x9E3779B97F4A7C15F39CC060:032x}"[-32:] for old in self._campaigns}
        offsets = {name: number * last for name, last in self._last.items()} | {
            "setups": problem * self._last["setups"],
            "influence_maps": 0,
        }
        for table in _COPIED:
            self._copy_table(connection, table, offsets, moment, keys, names | fingerprints)

    def _copy_table(
        self,
        connection: Connection,
        table: str,
        offsets: Mapping[str, int],
        moment: datetime,
        keys: Mapping[bytes, bytes],
        texts: Mapping[str, str],
    ) -> None:
        """Stores a table's rows of the copy, made column by column."""
        if table not in self._kept:
            self._kept[table] = self._read(connection, table, texts)
        made: list[list[Any]] = []
        for name, (values, named) in self._kept[table].items():
            pointed = _POINTS.get((table, name), _POINTS.get(("", name)))
            if (table, name) == ("campaigns", "id"):
                made.append([texts[value] for value in values])
            elif pointed is not None:
                offset = offsets[pointed]
                made.append([value + offset if value else value for value in values] if offset else values)
            elif name == "reference_key":
                made.append([None if value is None else keys[bytes(value)] for value in values])
            elif name in _MOMENTS:
                stored = _stored(moment)
                made.append([None if value is None else stored for value in values])
            else:
                changed = list(values) if named else values
                for place in named:
                    changed[place] = _replaced(values[place], texts)
                made.append(changed)
        _insert(connection, f"{table} ({', '.join(self._kept[table])})", list(zip(*made, strict=True)))

    def _read(self, connection: Connection, table: str, texts: Mapping[str, str]) -> dict[str, tuple[list[Any], list[int]]]:
        """Returns the columns of the group's rows, documents as text, each with the places of the texts that name what a copy renames."""
        own = "campaign_sequence" if table not in {"campaigns", "ratings"} else _number(table)
        last = self._last["runs" if table == "ratings" else "campaigns"]
        result = connection.execute(text(f"SELECT * FROM {table} WHERE {own} <= :last"), {"last": last})  # names of tables
        names, rows = list(result.keys()), result.all()
        kept: dict[str, tuple[list[Any], list[int]]] = {}
        for name, column in zip(names, zip(*rows, strict=True) if rows else ((),) * len(names), strict=True):
            values, named = list(column), []
            if name in _DOCUMENTS and connection.dialect.name == "postgresql":
                values = [
                    value if value is None or isinstance(value, float) else json.dumps(value) for value in values
                ]  # generations have a number `best`
            if name in _DOCUMENTS | _NAMES:
                named = [
                    place for place, value in enumerate(values) if isinstance(value, str) and any(old in value for old in texts)
                ]
            kept[name] = values, named
        return kept

    def _ensure_setups(self, connection: Connection, problem: int) -> dict[str, str]:
        """Stores the setups of a problem, and returns their fingerprints by those of the group."""
        fingerprints: dict[str, str] = {}
        rows = []
        for row in self._setups:
            document = row["document"] if isinstance(row["document"], dict) else json.loads(row["document"])
            changed = document | {"seed": document["seed"] + problem}
            fingerprints[row["fingerprint"]] = fingerprint_of(changed)
            number = row["id"] + problem * self._last["setups"]
            rows.append((number, fingerprint_of(changed), row["scenario"], json.dumps(changed)))
        if problem not in self._made:
            _insert(connection, "setups (id, fingerprint, scenario, document)", rows)
            self._made.add(problem)
        return fingerprints

    def _class_keys(self, connection: Connection) -> list[tuple[bytes, str, ParameterSet]]:
        """The reference keys of the group's cells, each with its scenario and a set that has it."""
        query = text(
            "SELECT reference_key, scenario, min(parameter_set_id) FROM evaluations WHERE reference_key IS NOT NULL GROUP BY 1, 2"
        )
        return [(bytes(key), scenario, self._sets[number]) for key, scenario, number in connection.execute(query)]

    def _shifted_keys(self, connection: Connection, number: int) -> dict[bytes, bytes]:
        keys: dict[bytes, bytes] = {}
        the_map = _only_map(connection)
        for scenario in SCENARIOS:
            mine = [(key, parameter_set) for key, name, parameter_set in self._keys if name == scenario]
            if mine:
                values = np.array([_shifted(one, number).codes for _, one in mine], dtype=np.int64)
                new = ReferenceKeys(the_map, scenario, mine[0][1].names).keys(values)
                keys |= dict(zip((key for key, _ in mine), new, strict=True))
        return keys


_COPIED = ("campaigns", "campaign_stages", "generations", "lots", "runs", "ratings", "evaluations", "studies", "events")
_POINTS = {
    ("campaigns", "sequence"): "campaigns",
    ("campaigns", "parent_sequence"): "campaigns",
    ("campaigns", "watermark"): "runs",
    ("lots", "id"): "lots",
    ("evaluations", "id"): "evaluations",
    ("evaluations", "reference"): "evaluations",
    ("evaluations", "lot"): "lots",
    ("runs", "id"): "runs",
    ("ratings", "since"): "runs",
    ("events", "id"): "events",
    ("", "campaign_sequence"): "campaigns",
    ("", "setup_id"): "setups",
    ("", "parameter_set_id"): "parameter_sets",
    ("", "run_id"): "runs",
    ("", "evaluation_id"): "evaluations",
}
_MOMENTS = {"created_at", "started_at", "ended_at"}
_NAMES = {"rerun_of", "robustness_of", "validation_of"}
_DOCUMENTS = {
    *("spec", "resolution", "narrowed", "notes", "progress", "error_rate", "released", "best", "baseline", "pruned", "cells"),
    *("population", "changed", "optimizer_state", "objectives", "metrics", "document", "data"),
}


def _replaced(document: str, texts: Mapping[str, str]) -> str:
    for old, new in texts.items():
        document = document.replace(old, new)
    return document


def _number(table: str) -> str:
    return {"campaigns": "sequence", "influence_maps": "sequence", "ratings": "run_id"}.get(table, "id")


def _shifted(parameter_set: ParameterSet, number: int) -> ParameterSet:
    values = list(parameter_set.billionths)
    place = parameter_set.names.index("P1")
    values[place] = int(values[place]) + number * SHIFT
    return ParameterSet(parameter_set.names, tuple(values))


def _stored(moment: datetime) -> str:
    """A moment as both backends read it."""
    return moment.strftime("%Y-%m-%d %H:%M:%S.%f")


def _insert(connection: Connection, table: str, rows: Sequence[tuple[Any, ...]]) -> None:
    driver: Any = connection.connection.driver_connection
    if connection.dialect.name == "postgresql":
        with driver.cursor() as cursor, cursor.copy(f"COPY {table} FROM STDIN") as copy:
            for row in rows:
                copy.write_row(row)
    elif rows:
        marks = ", ".join("?" for _ in rows[0])
        driver.executemany(f"INSERT INTO {table} VALUES ({marks})", rows)  # names of tables


def _follow_numbers(connection: Connection) -> None:
    """Has PostgreSQL number new rows behind the copies; SQLite does so by itself."""
    if connection.dialect.name == "postgresql":
        for name in COUNTED:
            column = _number(name)
            query = f"SELECT setval(pg_get_serial_sequence('{name}', '{column}'), max({column})) FROM {name}"
            connection.execute(text(query))


def _only_map(connection: Connection) -> Any:
    [listed], _ = influence_maps.page(connection)
    return stored_map(listed)


def index_references(database: Database) -> None:
    """Computes the reference keys of all runs, as campaigns of each problem do when they start."""
    with database.read() as connection:
        the_map, indexes = _only_map(connection), reference_keys.indexes(connection)
        scenarios = {row.id: row.scenario for row in connection.execute(text("SELECT id, scenario FROM setups"))}
        newest = connection.scalar(text("SELECT max(id) FROM runs")) or 0
    [index] = {(one.influence_map_sequence, one.evaluator) for one in indexes}
    for setup, scenario in scenarios.items():
        keys = partial(_keys, the_map, scenario)
        reference_keys.sync(database, index[0], setup, index[1], newest, keys)


def _keys(the_map: Any, scenario: str, names: tuple[str, ...], values: Any) -> Sequence[bytes]:
    return ReferenceKeys(the_map, scenario, names).keys(values)
