"""How does a database of years work? `python tests/benchmarks/run.py years [--cells 20000 200000] [--backends sqlite postgresql]`.

Fills databases with groups of four campaigns and a study of the built-in problem, half of the groups with the same setups, and stores
500 problems next to them (`_years_rows.py`; 10,000,000 cells are 16,000 campaigns). Measures what users and operators do: questions over
HTTP, look-ups of 6,000 cells, start of the API, check, backup and pruning. A question's time is the shortest of some repeats.
What concerns one campaign or a page must not grow with the database: from the first size to the last it may grow by a factor of
MOST_GROWTH. Work on the whole database has a limit for each million cells (`PER_MILLION`). Writes `.drivecal/bench/years.json`.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import timedelta
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import httpx
from sqlalchemy import Connection, text
from tests.benchmarks._years_rows import COUNTED, grow
from tests.support.api_process import api_process
from tests.support.postgres import create_database, running_postgres

from drivecal.campaigns import retention
from drivecal.campaigns.results.verification import verify
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.maintenance import backup
from drivecal.storage.references import reference_keys, runs

TARGET = Path(".drivecal/bench/years.json")
PROBLEMS = 500
LOOKED_UP = 6_000
MOST_LOOK_UP_SECONDS = 0.04
MOST_GROWTH = 3.0
QUESTIONS = {
    "list of campaigns": "/campaigns?limit=50",
    "campaign": "/campaigns/{id}",
    "generations": "/campaigns/{id}/generations",
    "evaluations, a page": "/campaigns/{id}/evaluations?limit=100",
    "solutions": "/campaigns/{id}/solutions?limit=50",
    "solutions, other weights": "/campaigns/{id}/solutions?limit=50&weights={weights}",
    "front": "/campaigns/{id}/front?limit=50",
    "explanation of a copy": "/evaluations/{copy}/explain",
    "results": "/campaigns/{id}/results",
    "studies": "/campaigns/{id}/studies",
    "problems": "/problems?limit=50",
}
WHOLE = {
    "explanation of a simulated cell": "/evaluations/{simulated}/explain",
    "references": "/references",
    "metrics": "/metrics",
}
"""Questions about the whole database."""
PER_MILLION = dict.fromkeys(WHOLE, 2.0) | {
    "start of the API": 1.0,
    "backup": 20.0,
    "check": 60.0,
    "prune, plan": 20.0,
    "prune, longest slice": 2.0,
}
"""Most seconds for each million cells; at least `SHORT` are allowed in all."""
SHORT = 5.0
Figures = dict[str, float]


def main(arguments: Sequence[str]) -> int:
    """Measures, prints and writes; 0 if nothing grows that should not, and look-ups are fast enough."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, nargs="+", default=[20_000, 200_000], help="sizes of the databases")
    parser.add_argument("--backends", nargs="+", choices=["sqlite", "postgresql"], default=["sqlite", "postgresql"])
    parser.add_argument(
        "--folder", type=Path, default=Path(".drivecal/bench/years"), help="where the databases are made, and removed"
    )
    chosen = parser.parse_args(arguments)
    folder = chosen.folder.absolute()  # the API works in another one
    figures: dict[str, dict[str, Figures]] = {}
    for backend in chosen.backends:
        for cells in chosen.cells:
            with _database(backend, folder) as url:
                figures.setdefault(backend, {})[str(cells)] = measure(url, cells, folder)
            TARGET.parent.mkdir(parents=True, exist_ok=True)
            TARGET.write_text(json.dumps(figures, indent=2))
    faults = [fault for backend, sizes in figures.items() for fault in judged(backend, sizes)]
    show(figures)
    print("\n".join(faults))
    return int(bool(faults))


def measure(url: str, cells: int, folder: Path) -> Figures:
    """Fills a database and measures everything."""
    database = Database.open(url)
    database.upgrade()
    figures: Figures = {"filling": timed(lambda: grow(database, cells, PROBLEMS, lambda line: print(line, flush=True)))}
    with database.read() as connection:
        figures |= sizes(connection)
        figures |= look_ups(connection)
        asked_about = examples(connection)
    figures |= over_http(url, folder, asked_about)
    copy = folder / "backup.db"
    figures["backup"] = timed(lambda: backup.write(database, copy, lambda *_: None, force=True))
    copy.unlink()
    verdicts: list[str] = []
    figures["check"] = timed(
        lambda: verdicts.extend(problem for check in verify(database, full=False) for problem in check.problems)
    )
    if verdicts:
        raise SystemExit(f"the database is not whole: {verdicts}")
    plans: list[retention.RetentionPlan] = []
    figures["prune, plan"] = timed(lambda: plans.append(retention.plan(database, now() - timedelta(days=365), 10)))
    slices: list[float] = []
    began = time.perf_counter()

    def note(_: str, __: int, ___: int) -> None:
        slices.append(time.perf_counter())

    retention.carry_out(database, plans[0], note)
    figures["prune"] = time.perf_counter() - began
    figures["prune, longest slice"] = max(after - before for before, after in pairwise(slices))
    figures["prune, cells"] = plans[0].doomed.cells
    database.dispose()
    return figures


def sizes(connection: Connection) -> Figures:
    """Returns the numbers of rows, and the bytes of tables and indexes."""
    rows = {
        f"rows of {name}": float(connection.scalar(text(f"SELECT count(*) FROM {name}")) or 0)  # names of tables
        for name in COUNTED
    }
    if connection.dialect.name == "sqlite":
        query = "SELECT name, sum(pgsize) FROM dbstat GROUP BY name"
    else:
        query = (
            "SELECT relname, CAST(pg_relation_size(oid) AS bigint) FROM pg_class"
            " WHERE relkind IN ('r', 'i', 't') AND relnamespace <> 'pg_catalog'::regnamespace"
        )
    parts = {str(name): float(size) for name, size in connection.execute(text(query)) if size}
    cells = rows["rows of evaluations"]
    print(
        "\n".join(
            f"{size / cells:8.1f} bytes a cell  {name}" for name, size in sorted(parts.items(), key=lambda part: -part[1])[:15]
        )
    )
    total = sum(parts.values())
    return rows | {"bytes": total, "bytes a cell": total / cells}


def look_ups(connection: Connection) -> Figures:
    """Times look-ups in the largest setup by reference key and by parameter set."""
    setup = connection.scalar(text("SELECT setup_id FROM runs GROUP BY setup_id ORDER BY count(*) DESC, setup_id LIMIT 1"))
    [index] = [row for row in reference_keys.indexes(connection) if row.setup_id == setup]
    spread = {"setup": setup, "index": index.id, "count": LOOKED_UP}
    keys = connection.scalars(
        text("SELECT key FROM reference_keys WHERE index_id = :index ORDER BY run_id % 7919 LIMIT :count"), spread
    )
    sets = connection.scalars(
        text("SELECT parameter_set_id FROM runs WHERE setup_id = :setup ORDER BY id % 7919 LIMIT :count"), spread
    )
    wanted, numbers = [bytes(key) for key in keys], list(sets)
    watermark = runs.largest_id(connection)

    def by_key() -> None:
        reference_keys.look_up(connection, index.influence_map_sequence, index.setup_id, wanted, index.evaluator, watermark)

    return {
        "look-up by key": best(by_key),
        "look-up by set": best(lambda: runs.look_up_exact(connection, index.setup_id, numbers, index.evaluator, watermark)),
        "look-up, cells": float(len(wanted)),
    }


def examples(connection: Connection) -> dict[str, str]:
    """Returns a young campaign of the first problem that reused results, a cell that it copied, one that it simulated, and weights."""
    newest = "SELECT max(campaign_sequence) FROM evaluations WHERE outcome = 'reused' AND setup_id = 1"
    sequence = connection.scalar(text(newest))
    campaign = connection.scalar(text("SELECT id FROM campaigns WHERE sequence = :number"), {"number": sequence})
    cell = "SELECT max(id) FROM evaluations WHERE campaign_sequence = :number AND NOT audited AND outcome = :outcome"
    cells = {
        name: connection.scalar(text(cell), {"number": sequence, "outcome": outcome})
        for name, outcome in (("copy", "reused"), ("simulated", "simulated"))
    }
    scenarios = "SELECT DISTINCT scenario FROM evaluations WHERE campaign_sequence = :number ORDER BY scenario"
    names = connection.scalars(text(scenarios), {"number": sequence})
    weights = ",".join(f"{name}={weight}" for weight, name in enumerate(names))
    return {"id": str(campaign), "weights": weights} | {name: str(number) for name, number in cells.items()}


def over_http(url: str, folder: Path, about: dict[str, str]) -> Figures:
    """Times the start of the API, and its answers."""
    figures: Figures = {}
    began = time.perf_counter()
    with api_process(url, folder) as api:
        figures["start of the API"] = time.perf_counter() - began
        for name, path in (QUESTIONS | WHOLE).items():
            address = path if path == "/metrics" else "/api/v1" + path.format(**about)
            figures[f"first: {name}"] = timed(partial(asked, api.http, address))
            figures[name] = best(partial(asked, api.http, address))
        figures["memory of the API, MB"] = api.megabytes
    return figures


def asked(http: httpx.Client, address: str) -> None:
    """Asks once. Raises RuntimeError with the answer for an error."""
    answer = http.get(address)
    if answer.is_error:
        raise RuntimeError(f"{address}: {answer.status_code} {answer.text}")


def timed(use: Callable[[], Any]) -> float:
    """Returns how long `use` takes, s."""
    began = time.perf_counter()
    use()
    return time.perf_counter() - began


def best(use: Callable[[], Any]) -> float:
    """Returns the shortest of some times, s."""
    use()
    return min(timed(use) for _ in range(5))


def judged(backend: str, sizes: dict[str, Figures]) -> Iterator[str]:
    """Yields what is too slow, or grows with the database and should not."""
    first, last = next(iter(sizes.values())), list(sizes.values())[-1]
    for name in ("look-up by key", "look-up by set"):
        if last[name] > MOST_LOOK_UP_SECONDS:
            yield f"{backend}: {name} takes {last[name] * 1000:.0f} ms, at most {MOST_LOOK_UP_SECONDS * 1000:.0f} wanted"
    for name in QUESTIONS:
        if last[name] > MOST_GROWTH * max(first[name], 0.005):
            yield f"{backend}: {name} grows from {first[name] * 1000:.0f} to {last[name] * 1000:.0f} ms"
    for name, seconds in PER_MILLION.items():
        most = max(SHORT, seconds * last["rows of evaluations"] / 1e6)
        if last[name] > most:
            yield f"{backend}: {name} takes {last[name]:.1f} s, at most {most:.1f} wanted"


def show(figures: dict[str, dict[str, Figures]]) -> None:
    """Prints a table: seconds, unless the name says otherwise."""
    columns = [(backend, size) for backend, sizes in figures.items() for size in sizes]
    print(f"{'':32}" + "".join(f"{f'{backend} {int(size):,}':>24}" for backend, size in columns))
    for name in next(iter(next(iter(figures.values())).values())):
        print(f"{name:32}" + "".join(f"{figures[backend][size].get(name, 0):24,.4g}" for backend, size in columns))


@contextmanager
def _database(backend: str, folder: Path) -> Iterator[str]:
    """Yields the URL of a new database; it is gone afterwards."""
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        own = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True)))
        if backend == "sqlite":
            yield f"sqlite:///{own / 'drivecal.db'}"
            return
        yield create_database(stack.enter_context(running_postgres(own)), "years")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
