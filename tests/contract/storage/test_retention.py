"""Pruning on both backends: cells, runs and keys go in slices, and what is left is whole."""

from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy import text
from tests.support.computed import ComputedBackend
from tests.support.runs import nothing_matters, post_map, rows_of, run, submit

from drivecal.campaigns import retention
from drivecal.campaigns.results.verification import verify
from drivecal.domain.evaluations import Outcome
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.retention import removal
from drivecal.storage.retention.deletion import delete_campaign, remove_cells

SEARCH: dict[str, Any] = {"kind": "genetic", "population": 12, "iterations": 2, "seed": 1}


@pytest.mark.slow("postgresql")
def test_what_a_younger_campaign_needs_is_left_and_nothing_else(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retention, "SLICE", 10)
    monkeypatch.setattr(removal, "KEYS", 2)
    stored = post_map(database, nothing_matters())
    first = run(database, submit(database, stored_map=stored, optimizer=SEARCH))
    backend = ComputedBackend()
    second = run(database, submit(database, stored_map=stored, optimizer=SEARCH | {"seed": 2}), backend)
    assert second.cells.reused > 0
    before = rows_of(database, second)
    needed = {row.reference for row in before if row.outcome is Outcome.REUSED}
    with database.transaction() as connection:
        connection.execute(text("UPDATE campaigns SET ended_at = '2020-01-01 00:00:00+00' WHERE sequence = 1"))
    gone: list[int] = []
    retention.carry_out(
        database, retention.plan(database, now() - timedelta(days=30), 0), lambda _, done, total: gone.extend((done, total))
    )
    assert gone[-1] == gone[-2] > 10
    assert rows_of(database, second) == before
    assert needed <= {row.id for campaign in (first, second) for row in rows_of(database, campaign)}
    assert [check for check in verify(database, full=True) if check.problems] == []
    with database.read() as connection:
        assert connection.scalar(text("SELECT count(*) FROM reference_keys")) == 0
    third = run(database, submit(database, stored_map=stored, optimizer=SEARCH | {"seed": 3}))
    assert third.cells.reused > 0, "the keys are computed again"
    assert [check for check in verify(database, full=True) if check.problems] == []


@pytest.mark.slow("postgresql")
def test_what_a_deleted_campaign_left_goes_with_its_row(database: Database) -> None:
    first = run(database, submit(database, optimizer=SEARCH))
    with database.transaction() as connection:
        number = delete_campaign(connection, first.id)
    remove_cells(database, number)
    assert [check for check in verify(database, full=True) if check.problems] == []
    retention.carry_out(database, retention.plan(database, now(), 10), lambda *_: None)
    with database.read() as connection:
        left = [connection.scalar(text(f"SELECT count(*) FROM {name}")) for name in ("campaigns", "evaluations", "runs")]
    assert left == [0, 0, 0]
    assert [check for check in verify(database, full=True) if check.problems] == []
