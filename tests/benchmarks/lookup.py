"""How long does one look-up for a whole population take? `python tests/benchmarks/run.py lookup [--references 10000 1000000]`.

6,000 cells are asked for against tables of stored results, on SQLite and PostgreSQL: by reference key (Figure 6 of the paper), by
parameter set, and from the cells' values to their donors, keys included. The tables of all sizes stand beside each other and take
turns, and a time is the shortest of all rounds (the median is written down too), so that other work on the machine blurs the ratio of
two sizes as little as possible. Beside them a vectorised scan of Figure 6 over arrays that are in memory already, which is what the
keys replace; it is measured on a few cells and extrapolated. Also timed: computing the keys of all stored results under a new
influence map, which must take less than a minute for a million. Writes `.drivecal/bench/lookup.json`.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlalchemy import Connection, make_url, text
from tests.support.postgres import create_database, running_postgres

from drivecal.domain.evaluations import Donor
from drivecal.domain.influence import Influence, InfluenceMap
from drivecal.domain.parameters import ParameterSet, decimal
from drivecal.reduction.keys import BELOW, ReferenceKeys
from drivecal.storage.engine.database import Database
from drivecal.storage.references import reference_keys, runs

TARGET = Path(".drivecal/bench/lookup.json")
CELLS = 6_000
ROUNDS = 5
REPEATS = 5
"""Look-ups of a kind in each round."""
SCANNED = 20
"""Cells for which the scan is carried out."""
MOST_SECONDS_PER_MILLION = 60.0
NAMES = tuple(f"P{number}" for number in range(1, 12))
STEP = 10_000_000  # 0.01 in billionths
VALUES = 200
EVALUATOR = "reference 1"
MAP = InfluenceMap(
    {
        "S1": {
            "P1": Influence(influential=True, lower=decimal("0.5"), upper=decimal("1.5")),
            "P2": Influence(influential=True, upper=decimal(1)),
            "P3": Influence(influential=False),
        }
    }
)
LOWER, UPPER = (50, BELOW), (150, 100)
"""What MAP says of P1 and P2, in steps."""

Steps = npt.NDArray[np.int64]


def main(arguments: Sequence[str]) -> int:
    """Measures, prints and writes; 0 where the keys of a million results take less than a minute."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--references", type=int, nargs="+", default=[10_000, 1_000_000], help="sizes of the table")
    sizes = parser.parse_args(arguments).references
    figures: dict[str, dict[str, dict[str, float]]] = {str(size): {} for size in sizes}
    with ExitStack() as stack:
        tables: list[Table] = []
        for size in sizes:
            stored, asked = cells(size)
            for backend, new in (("sqlite", sqlite), ("postgresql", postgresql)):
                database = stack.enter_context(new())
                fill(database, stored)
                started = time.perf_counter()
                reference_keys.sync(database, 1, 1, EVALUATOR, size, keys_of)
                synced = time.perf_counter() - started
                figures[str(size)][backend] = {"keys_of_a_new_map_seconds": synced}
                tables.append(Table(size, backend, database, asked))
            figures[str(size)]["numpy"] = {"scan_in_memory_seconds": scan(stored, asked)}
        times: dict[tuple[int, str, str], list[float]] = {}
        for _ in range(ROUNDS):
            for table in tables:
                for name, seconds in measure(table).items():
                    times.setdefault((table.size, table.backend, name), []).extend(seconds)
    for (size, backend, name), seconds in times.items():
        figures[str(size)][backend] |= {f"{name}_seconds": min(seconds), f"{name}_median_seconds": median(seconds)}
    show(sizes, figures)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{CELLS:,} cells per look-up; memory of this process at its peak {peak:.0f} MB")
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps({"cells": CELLS, "references": figures, "peak_megabytes": peak}, indent=2))
    rates = [
        figures[str(size)][backend]["keys_of_a_new_map_seconds"] / size
        for size in sizes
        for backend in ("sqlite", "postgresql")
        if size >= 1_000_000
    ]
    return int(any(rate * 1_000_000 > MOST_SECONDS_PER_MILLION for rate in rates))


@dataclass(frozen=True, slots=True)
class Table:
    """Stored results in one database, and the cells that are asked for, in steps, shape (CELLS, n_p)."""

    size: int
    backend: str
    database: Database
    asked: Steps


def cells(size: int) -> tuple[Steps, Steps]:
    """Stored sets, shape (size, n_p), and asked ones, shape (CELLS, n_p), of which half are stored; in steps."""
    generator = np.random.default_rng(size)
    stored = generator.integers(0, VALUES, (size, len(NAMES)))
    asked = generator.integers(0, VALUES, (CELLS, len(NAMES)))
    asked[: CELLS // 2] = stored[generator.choice(size, CELLS // 2, replace=False)]
    return stored, asked


def measure(table: Table) -> dict[str, list[float]]:
    """The times of one round of look-ups, seconds."""
    keys = list(dict.fromkeys(keys_of(NAMES, table.asked * STEP)))
    wanted = np.random.default_rng(1).integers(1, 2 * table.size, CELLS).tolist()  # half of these are there
    with table.database.read() as connection:

        def by_key(some: Sequence[bytes] = keys) -> dict[bytes, Donor]:
            return reference_keys.look_up(connection, 1, 1, some, EVALUATOR, table.size)

        uses: dict[str, Callable[[], Any]] = {
            "look_up_by_key": by_key,
            "look_up_by_set": lambda: runs.look_up_exact(connection, 1, wanted, EVALUATOR, table.size),
            "look_up_of_cells": lambda: by_key(list(dict.fromkeys(keys_of(NAMES, table.asked * STEP)))),
        }
        found = by_key()
        if not CELLS // 2 - 10 <= len(found) < CELLS:
            raise SystemExit(f"half of the cells should have been found, not {len(found)}")
        return {name: [timed(use) for _ in range(REPEATS)] for name, use in uses.items()}


def timed(use: Callable[[], Any]) -> float:
    """How long `use` takes, seconds."""
    started = time.perf_counter()
    use()
    return time.perf_counter() - started


def show(sizes: Sequence[int], figures: dict[str, dict[str, dict[str, float]]]) -> None:
    """Prints what was measured; from the second size on, look-ups also as multiples of those against the first."""
    print(f"{'references':>10}  {'':22}  {'SQLite':>10}  {'PostgreSQL':>10}")
    for size in sizes:
        measured, first = figures[str(size)], figures[str(sizes[0])]
        for name in measured["sqlite"]:
            if "median" in name:
                continue
            sqlite_s, postgresql_s = measured["sqlite"][name], measured["postgresql"][name]
            times = ""
            if size != sizes[0] and name.startswith("look_up"):
                times = f"   {sqlite_s / first['sqlite'][name]:.1f} and {postgresql_s / first['postgresql'][name]:.1f} times"
            label = name.removesuffix("_seconds").replace("_", " ") + ", s"
            print(f"{size:10,}  {label:22}  {sqlite_s:10.3f}  {postgresql_s:10.3f}{times}")
        seconds = measured["numpy"]["scan_in_memory_seconds"]
        print(f"{size:10,}  {'scan in memory, s':22}  {seconds:10.3f}  {seconds:10.3f}   (from {SCANNED} cells)")


def keys_of(names: tuple[str, ...], values: Steps) -> list[bytes]:
    """Reference keys under MAP."""
    return ReferenceKeys(MAP, "S1", names).keys(values)


def scan(stored: Steps, asked: Steps) -> float:
    """Seconds for CELLS cells if each were compared with every stored set, parameter by parameter (Figure 6 of the paper)."""
    lower, upper = np.array(LOWER), np.array(UPPER)
    below, above = stored[:, :2] < lower, stored[:, :2] > upper
    started = time.perf_counter()
    for cell in asked[:SCANNED]:
        same = stored == cell
        same[:, :2] |= (below & (cell[:2] < lower)) | (above & (cell[:2] > upper))
        same[:, 2] = True
        np.flatnonzero(same.all(axis=1))[:1]
    return (time.perf_counter() - started) / SCANNED * CELLS


def fill(database: Database, stored: Steps, setup: tuple[str, str] = ("f", "S1")) -> None:
    """One setup's results, as fast as the backend takes them; `setup` is its fingerprint and scenario."""
    texts = [ParameterSet(NAMES, tuple(row)).to_json() for row in (stored[:1000] * STEP).tolist()]
    columns = {
        "parameter_sets": "id, key, parameter_values",
        "runs": "id, setup_id, parameter_set_id, metrics, milliseconds, worker, evaluation_id, campaign_sequence, stage, iteration,"
        " individual, created_at",
        "ratings": "run_id, evaluator, score, rating",
    }
    metrics = json.dumps({f"metric_{number}_mps2": number / 7 for number in range(12)})
    rows: dict[str, Callable[[int], tuple[Any, ...]]] = {
        "parameter_sets": lambda n: (n, n.to_bytes(16, "big"), texts[n - 1] if n <= len(texts) else shown(stored[n - 1])),
        "runs": lambda n: (n, 1, n, metrics, 7.0, "worker", n, 1, 2, n // 1000, n % 1000, "2026-01-01 00:00:00.000000"),
        "ratings": lambda n: (n, EVALUATOR, n % 8, n % 8 + 0.25),
    }
    with database.transaction() as connection:
        statement = text("INSERT INTO setups (id, fingerprint, scenario, document) VALUES (1, :fingerprint, :scenario, '{}')")
        connection.execute(statement, dict(zip(("fingerprint", "scenario"), setup, strict=True)))
        for table, row in rows.items():
            insert(connection, table, columns[table], map(row, range(1, len(stored) + 1)))
    if make_url(database.url).get_backend_name() == "postgresql":  # as it does by itself after a while
        with database.transaction() as connection:
            for table in ("setups", "parameter_sets", "runs"):
                connection.execute(text(f"SELECT setval(pg_get_serial_sequence('{table}', 'id'), max(id)) FROM {table}"))
            connection.execute(text("ANALYZE"))


def shown(row: Steps) -> str:
    """A parameter set's JSON, as ParameterSet writes it, only faster."""
    return "{" + ", ".join(f'"{name}": {value / 100:g}' for name, value in zip(NAMES, row.tolist(), strict=True)) + "}"


def insert(connection: Connection, table: str, columns: str, rows: Iterator[tuple[Any, ...]]) -> None:
    """Stores rows by COPY or executemany."""
    driver: Any = connection.connection.driver_connection
    if connection.dialect.name == "postgresql":
        with driver.cursor().copy(f"COPY {table} ({columns}) FROM STDIN") as copy:
            for row in rows:
                copy.write_row(row)
    else:
        marks = ", ".join("?" for _ in columns.split(","))
        driver.executemany(f"INSERT INTO {table} ({columns}) VALUES ({marks})", rows)


@contextmanager
def sqlite() -> Iterator[Database]:
    """A new SQLite database."""
    with (
        tempfile.TemporaryDirectory(prefix="drivecal-lookup-") as folder,
        opened(f"sqlite:///{folder}/drivecal.db") as database,
    ):
        yield database


@contextmanager
def postgresql() -> Iterator[Database]:
    """A new PostgreSQL database on a server of its own."""
    with running_postgres() as url, opened(create_database(url, "lookup")) as database:
        yield database


@contextmanager
def opened(url: str) -> Iterator[Database]:
    """A database with drivecal's tables."""
    database = Database.open(url)
    database.upgrade()
    yield database
    database.dispose()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
