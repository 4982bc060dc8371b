"""Makes the rows of a database of a release, for the tests of upgrades: `make.py FILE`, with the code of that release.

    git worktree add ../release COMMIT
    PYTHONPATH=../release:../release/shared:../release/services:../release/workers .venv/bin/python tests/support/revisions/make.py \
        tests/support/revisions/REVISION.json

To be run once, when a release goes out that made a new revision: 0001 is that of commit 8102bb0, 0003 that of 7dcb5b2, 0005 that
of be2ebb9. Everything that a user may have is in it: an analysis with its campaign, a rerun with other weights, a posted map with a
campaign that uses it, a single evaluation, a comparison of optimizers, a campaign that stopped in the middle, one that is queued and
one that was cancelled before it began.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from sqlalchemy import Boolean, LargeBinary, text
from tests.support.comparisons import submit_comparison
from tests.support.computed import IGNORED, ComputedBackend
from tests.support.runs import EXPERT_SPACE, WITH_ANALYSIS, dispatcher, get, influenced, post_map, run, submit

from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import metadata

ANALYSED: dict[str, Any] = WITH_ANALYSIS | {
    "sensitivity": {"intervals": 2, "samples": 4, "threshold": 0.02},
    "optimizer": {"kind": "genetic", "population": 10, "iterations": 3, "seed": 2},
}
SMALL_SEARCH = {"kind": "genetic", "population": 10, "iterations": 3, "seed": 3}


def main(file: Path) -> None:
    """Writes the rows."""
    with tempfile.TemporaryDirectory() as folder:
        database = Database.open(f"sqlite:///{folder}/drivecal.db")
        database.upgrade()
        fill(database)
        document = rows(database)
        database.dispose()
    tables = [
        json.dumps(name) + ": [\n" + ",\n".join(json.dumps(row) for row in listed) + "\n]" for name, listed in document.items()
    ]
    file.write_text("{\n" + ",\n".join(tables) + "\n}\n")
    print(f"{file}: {sum(map(len, document.values()))} rows, {file.stat().st_size:,} bytes")


def fill(database: Database) -> None:
    """Has campaigns carried out."""
    analysed = run(database, insert(database, "analysed", ANALYSED), ComputedBackend(1, influenced))
    again = ANALYSED | {"weights": {"S1": 1, "S2": 3}, "sensitivity": {"map": analysed.influence_map_id}}
    run(
        database,
        insert(database, "rerun", again, influence_map_id=analysed.influence_map_id, rerun_of=analysed.id),
        ComputedBackend(2, influenced),
    )
    stored_map = post_map(database, {scenario: {name: {"influential": False}} for scenario, name in IGNORED.items()})
    run(database, submit(database, stored_map=stored_map, catalogue=["S1", "S2"], optimizer=SMALL_SEARCH))
    evaluation = EvaluationSpecification(parameters={f"P{i}": 0.25 for i in range(1, 12)}, scenario="S1")
    with database.transaction() as connection:
        spec = evaluation.model_dump(mode="json")
        single = campaigns.insert(connection, name="evaluation", spec=spec, kind="evaluation")
    run(database, single)
    run(database, submit_comparison(database, populations=[6], seeds=[1, 2, 3], iterations=2))
    cancelled = submit(database)
    with database.transaction() as connection:
        campaigns.request_action(connection, cancelled.id, "cancel")
    running = submit(database, stored_map=stored_map, catalogue=["S1", "S2"], optimizer=SMALL_SEARCH | {"seed": 4})
    working = dispatcher(database, ComputedBackend(3))
    while not get(database, running).cells.simulated or not get(database, running).cells.pending:
        working.step()
    insert(database, "queued", {"parameters": EXPERT_SPACE}, idempotency_key="key", body_digests=["digest"])


def insert(database: Database, name: str, document: dict[str, Any], **more: Any) -> StoredCampaign:
    """Queues a campaign."""
    spec = CampaignSpecification.model_validate(document | {"name": name}).model_dump(mode="json")
    with database.transaction() as connection:
        return campaigns.insert(connection, name=name, spec=spec, **more)


def rows(database: Database) -> dict[str, list[list[Any]]]:
    """Of each table the names of its columns and all rows, in an order in which they can be inserted; bytes in hexadecimal digits,
    JSON and moments as their text."""
    found: dict[str, list[list[Any]]] = {}
    with database.read() as connection:
        for table in metadata.sorted_tables:
            listed = connection.execute(text(f"SELECT * FROM {table.name}")).mappings()
            names = [column.name for column in table.c]
            found[table.name] = [names, *([plain(table.c[name].type, row[name]) for name in names] for row in listed)]
    return found


def plain(kind: Any, value: Any) -> Any:
    """A value as JSON has it."""
    if value is not None and isinstance(kind, LargeBinary):
        return value.hex()
    return bool(value) if value is not None and isinstance(kind, Boolean) else value


if __name__ == "__main__":
    main(Path(sys.argv[1]))
