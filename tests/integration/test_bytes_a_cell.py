"""The bytes of a cell on SQLite: counted, so that they are the same on every machine."""

from pathlib import Path

from sqlalchemy import text
from tests.benchmarks._years_rows import SCENARIOS, SPACE, index_references, measured
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.runs import post_map, run, submit

from drivecal.storage.engine.database import Database

MOST_BYTES = 670
"""650 when it was counted: 271 in runs, 114 in evaluations, 49 in reference keys, 35 in ratings, the rest in indexes and parameter sets."""


def counted(database: Database) -> tuple[int, int, int]:
    """Bytes in use, cells and simulated runs."""
    with database.read() as connection:
        used, free, page = (connection.scalar(text(f"PRAGMA {name}")) for name in ("page_count", "freelist_count", "page_size"))
        cells, simulated = (connection.scalar(text(f"SELECT count(*) FROM {table}")) for table in ("evaluations", "runs"))
    return (used - free) * page, cells, simulated


def test_a_cell_with_its_run_takes_no_more_bytes_than_promised(tmp_path: Path) -> None:
    database = migrated(f"sqlite:///{tmp_path / 'drivecal.db'}")
    regions = {"P2": {"influential": True, "lower": 0.5, "upper": 0.5}, "P9": {"influential": False}}
    stored = post_map(database, dict.fromkeys(SCENARIOS, regions))
    empty, *_ = counted(database)
    search = {"kind": "genetic", "population": 250, "iterations": 3, "seed": 1}
    campaign = submit(database, stored_map=stored, parameters=SPACE, catalogue=list(SCENARIOS), optimizer=search)
    run(database, campaign, ComputedBackend(answer=measured))
    index_references(database)  # as the next campaign on the map does
    full, cells, simulated = counted(database)
    database.dispose()
    assert cells > 2_000
    assert simulated > 0.95 * cells
    assert (full - empty) / cells <= MOST_BYTES
