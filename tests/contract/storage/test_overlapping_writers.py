"""Writing transactions overlap on PostgreSQL. On SQLite each of them excludes other writers from its start."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import pytest
from fastapi import Request
from sqlalchemy import Connection, event, text
from tests.support.comparisons import runs_of
from tests.support.computed import ComputedBackend
from tests.support.problems import LIMITS
from tests.support.runs import SHORT, influenced, run, submit

from drivecal.api import submission
from drivecal.api.http.authorisation import ANYBODY
from drivecal.api.routes.evaluations import read_trace
from drivecal.contracts.comparison import ComparisonSpecification
from drivecal.contracts.specification import CampaignSpecification, RerunSpecification
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import ConflictError, DrivecalError, NotFoundError
from drivecal.domain.evaluations import Outcome
from drivecal.storage import campaigns, events, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance import deletion
from drivecal.storage.outside import sets as outside_sets
from drivecal.storage.outside.sets import OutsideSet

pytestmark = pytest.mark.slow

PATIENCE = 60
"""Seconds after which an overlap that never comes fails its test."""


@pytest.fixture
def postgres(clean_postgres: str) -> Database:
    """A migrated PostgreSQL database without rows."""
    return Database.open(clean_postgres)


@pytest.fixture
def beside() -> Iterator[ThreadPoolExecutor]:
    """A thread for the second transaction."""
    with ThreadPoolExecutor(1) as pool:
        yield pool


def settle(database: Database, second: Future[Any]) -> None:
    """Returns when the second transaction is over or waits for a lock of the first."""
    waiting = text(
        "SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() AND wait_event_type = 'Lock' AND state = 'active'"
    )
    for _ in range(PATIENCE * 20):
        with database.read() as connection:
            if second.done() or connection.scalar(waiting):
                return
        time.sleep(0.05)
    raise AssertionError("the second transaction neither ended nor waits for a lock")


def delete(database: Database, campaign: StoredCampaign) -> None:
    with database.transaction() as connection:
        deletion.delete_campaign(connection, campaign.id)


def rerun(database: Database, first: StoredCampaign) -> StoredCampaign:
    return submission.rerun(database, LIMITS, first.id, RerunSpecification(weights={}), None)


def study(database: Database, first: StoredCampaign) -> StoredCampaign:
    document = SHORT | {"sensitivity": None, "optimizer": None, "robustness": {"of": first.id, "solutions": 1}}
    return submission.submit(database, LIMITS, CampaignSpecification.model_validate(document), None)


def use_of_map(database: Database, first: StoredCampaign) -> StoredCampaign:
    document = SHORT | {"sensitivity": {"map": first.influence_map_id}}
    return submission.submit(database, LIMITS, CampaignSpecification.model_validate(document), None)


def comparison_on_map(database: Database, first: StoredCampaign) -> StoredCampaign:
    document = {name: SHORT[name] for name in ("catalogue", "parameters", "fixed")}
    document |= {"optimizers": [{"kind": "genetic"}], "populations": [6], "iterations": 2, "seeds": [1, 2, 3]}
    document |= {"reductions": ["influence"], "sensitivity": {"map": first.influence_map_id}}
    tag = submission.compare(database, LIMITS, ComparisonSpecification.model_validate(document), "key")
    return runs_of(database, tag)[0]


USES = pytest.mark.parametrize("use", [rerun, study, use_of_map, comparison_on_map])
Use = Callable[[Database, StoredCampaign], StoredCampaign]


@pytest.fixture
def first(postgres: Database) -> StoredCampaign:
    """An ended campaign with a map of its own."""
    return run(postgres, submit(postgres, **SHORT), ComputedBackend(answer=influenced))


@USES
def test_submissions_wait_for_deletion(postgres: Database, first: StoredCampaign, beside: ThreadPoolExecutor, use: Use) -> None:
    with postgres.transaction() as connection:
        deletion.delete_campaign(connection, first.id)
        submitted = beside.submit(use, postgres, first)
        settle(postgres, submitted)
    with pytest.raises(
        DrivecalError, match=str(first.influence_map_id if use in {use_of_map, comparison_on_map} else first.id)
    ):
        submitted.result(PATIENCE)


@USES
def test_a_deletion_waits_for_a_submission_that_was_checked_and_is_refused(
    postgres: Database, first: StoredCampaign, beside: ThreadPoolExecutor, use: Use, monkeypatch: pytest.MonkeyPatch
) -> None:
    deleting: list[Future[None]] = []
    usual = campaigns.insert

    def insert(*arguments: Any, **fields: Any) -> StoredCampaign:
        """The campaign is checked now, and not stored yet."""
        if not deleting:
            deleting.append(beside.submit(delete, postgres, first))
            settle(postgres, deleting[0])
        return usual(*arguments, **fields)

    monkeypatch.setattr(campaigns, "insert", insert)
    submitted = use(postgres, first)
    with pytest.raises(ConflictError, match=f"refer to {first.id}"):
        deleting[0].result(PATIENCE)
    with postgres.read() as connection:
        referring = set(deletion.references(connection, first))
    stored = {submitted.id, *(each.id for tag in submitted.tags for each in runs_of(postgres, tag))}
    assert referring
    assert referring <= stored


@pytest.mark.parametrize(
    "write",
    [
        lambda connection, number: campaigns.degrade(connection, [number], "no workers"),
        lambda connection, number: campaigns.explain(connection, {number: "no licence"}),
    ],
    ids=["degrade", "explain"],
)
def test_a_heartbeat_changes_no_campaign_that_ends_while_it_waits(
    postgres: Database, beside: ThreadPoolExecutor, write: Callable[[Connection, int], None]
) -> None:
    campaign = submit(postgres, **SHORT)

    def beat() -> None:
        with postgres.transaction() as connection:
            write(connection, campaign.sequence)

    with postgres.transaction() as connection:
        campaigns.start(connection, campaign.sequence)
    with postgres.transaction() as connection:
        assert campaigns.end(connection, campaign.sequence, CampaignState.SUCCEEDED)
        late = beside.submit(beat)
        settle(postgres, late)
    late.result(PATIENCE)
    with postgres.read() as connection:
        ended = campaigns.by_sequence(connection, campaign.sequence)
        last = events.since(connection, campaign.sequence, 0, 100)[-1]
    assert (ended.degraded, ended.waiting, last.kind) == (None, None, "succeeded")


def test_a_trace_of_a_removed_cell_is_refused(postgres: Database, first: StoredCampaign, beside: ThreadPoolExecutor) -> None:
    with postgres.read() as connection:
        copied = [row.id for row in results.stream(connection, first.sequence) if row.outcome == Outcome.REUSED]
    requested: list[Future[Any]] = []
    asking = Request({"type": "http", "state": {"token": ANYBODY}})

    def request(_connection: Connection, _cursor: Any, statement: str, *_: Any) -> None:
        """The traces of these cells are gone now, and the cells are still there."""
        if statement.startswith("DELETE FROM evaluations") and not requested:
            requested.append(beside.submit(read_trace, str(copied[0]), asking, postgres, LIMITS))
            settle(postgres, requested[0])

    event.listen(postgres._engine, "before_cursor_execute", request)
    delete(postgres, first)
    assert all(deletion.removal(postgres))
    with pytest.raises(NotFoundError):
        requested[0].result(PATIENCE)
    with postgres.read() as connection:
        left = {row.id for row in results.stream(connection, first.sequence)}
        assert connection.scalar(text("SELECT count(*) FROM traces")) == 0
    assert left.isdisjoint(copied)


def test_a_set_is_cancelled_while_a_round_is_stored(postgres: Database, beside: ThreadPoolExecutor) -> None:
    campaign = submit(postgres, **SHORT | {"sensitivity": None, "optimizer": {"kind": "external"}})
    with postgres.transaction() as connection:
        outside_sets.add(connection, campaign, [OutsideSet("a", [0] * len(SHORT["parameters"]))])

    def cancel() -> tuple[int, bool]:
        with postgres.transaction() as connection:
            return outside_sets.cancel(connection, campaign.id, "a")

    with postgres.transaction() as connection:
        assert outside_sets.hold(connection, campaign.sequence, [1]) == 1
        second = beside.submit(cancel)
        settle(postgres, second)
        campaigns.save_progress(connection, campaign, {})
    assert second.result(PATIENCE) == (1, True)
