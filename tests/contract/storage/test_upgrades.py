"""Databases of earlier revisions, with data in them, become current: nothing is lost, everything works, and nothing lies in between."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from sqlalchemy import Connection, Engine, event, inspect, text
from tests.support import effort
from tests.support.computed import ComputedBackend
from tests.support.revisions import load
from tests.support.runs import dispatcher, finish, run, submit
from tests.support.storage import PROCESSES, migrate
from typer.testing import CliRunner

from drivecal.campaigns.results.verification import verify
from drivecal.cli.main import app
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import DatabaseError
from drivecal.domain.scenarios import Scenario
from drivecal.plugins import registry
from drivecal.storage import campaigns, events, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine import locks, schema
from drivecal.storage.engine.database import Database
from drivecal.storage.references import reference_keys, runs, setups

REVISIONS = ("0001", "0002", "0003", "0004", "0005", "0006", "0007", "0008", "0009", "0010", "0011", "0012", "0013", "0014")
RELEASED = ("0001", "0003", "0005")


def make(database: Database, revision: str) -> None:
    """A database at a revision as somebody left it. Of revisions that no release had, as their upgrades and services filled them."""
    load.create(database, max(one for one in RELEASED if one <= revision))
    with database.transaction() as connection:
        schema.upgrade(connection, database.name, revision)
        if revision == "0002":
            running = connection.execute(text("SELECT sequence FROM campaigns WHERE state = 'running'")).scalar_one()
            pending = connection.execute(text("SELECT min(id) FROM evaluations WHERE outcome IS NULL")).scalar_one()
            connection.execute(text("INSERT INTO leases VALUES (:id, 2, 1, 0, '2026-01-01 00:00:00+00')"), {"id": pending})
            row = "(campaign_sequence, kind, data, created_at) VALUES (:id, 'note', '{\"text\": \"old\"}', '2026-01-01 00:00:00+00')"
            connection.execute(text(f"INSERT INTO events {row}"), {"id": running})


KEPT = (*RELEASED, REVISIONS[-1])
every = pytest.mark.parametrize(
    ("backend", "revision"),
    [
        (backend, revision)
        for backend in ("sqlite", "postgresql")
        for revision in (REVISIONS if effort.LONG or backend == "sqlite" else KEPT)
    ],
    indirect=["backend"],
)
"""All revisions on SQLite; in the everyday suite those of releases and the last one on PostgreSQL."""
kept = pytest.mark.parametrize(
    ("backend", "revision"),
    [
        (backend, revision)
        for backend in ("sqlite", "postgresql")
        for revision in (REVISIONS if effort.LONG else KEPT if backend == "sqlite" else (KEPT[0], KEPT[-1]))
    ],
    indirect=["backend"],
)
"""All revisions in the long form; in the everyday suite those of releases and the last one, on PostgreSQL the first and the last."""


@pytest.fixture
def old(empty_url: str, revision: str) -> Iterator[Database]:
    """A database at that revision."""
    opened = Database.open(empty_url)
    make(opened, revision)
    yield opened
    opened.dispose()


def stored(connection: Connection, columns: dict[str, list[str]]) -> dict[str, list[tuple[Any, ...]]]:
    """Columns of all rows of tables, as the driver gives them."""
    found = {}
    for table, names in columns.items():
        rows = connection.execute(text(f"SELECT {', '.join(names)} FROM {table}"))
        found[table] = sorted((tuple(row) for row in rows), key=repr)
    return found


def columns_of(connection: Connection) -> dict[str, list[str]]:
    """The columns of all tables but that of the revision."""
    tables = inspect(connection).get_table_names()
    return {
        table: [one["name"] for one in inspect(connection).get_columns(table)]
        for table in tables
        if table != schema.REVISION_TABLE
    }


def test_every_revision_is_tried() -> None:
    assert tuple(sorted(schema.known_revisions())) == REVISIONS, "make the rows of a release with support/revisions/make.py"


@pytest.mark.slow(*(f"sqlite-{revision}" for revision in REVISIONS[1:]), *(f"postgresql-{revision}" for revision in RELEASED))
@every
def test_everything_that_was_there_is_there_and_the_whole_is_sound_and_as_new(old: Database, migrated: Database) -> None:
    with old.read() as connection:
        columns = columns_of(connection)
        moved = [name for name in columns["campaigns"] if name in load.COUNTS]
        columns["campaigns"] = [name for name in columns["campaigns"] if name not in moved]
        before = stored(connection, columns)
        counts = stored(connection, {"campaigns": ["sequence", *moved]})["campaigns"]
    old.upgrade()
    old.check()
    with old.read() as connection:
        assert stored(connection, columns) == before
        after = stored(connection, {"campaign_stages": ["campaign_sequence", "stage", "cells"]})["campaign_stages"]
    if moved:
        listed = [
            (row[0], load.COUNTS[name], cells) for row in counts for name, cells in zip(moved, row[1:], strict=True) if cells
        ]
        assert after == sorted(listed, key=repr)
    assert len(before["runs"]) > 200
    assert [verdict for verdict in verify(old, full=True) if verdict.problems] == []
    assert_same_tables(old, migrated)
    assert_references_answer(old)


def assert_same_tables(old: Database, migrated: Database) -> None:
    """AssertionError if an upgraded database has other tables, indexes or constraints than a new one."""
    shapes = []
    for database in (old, migrated):
        with database.read() as connection:
            shapes.append(sorted(connection.execute(text(SHAPE[connection.dialect.name])), key=repr))
    assert shapes[0] == shapes[1]
    assert len(shapes[0]) > 30


SHAPE = {
    "sqlite": "SELECT type, name, tbl_name, sql FROM sqlite_master",
    "postgresql": "SELECT table_name, column_name, data_type || coalesce(collation_name, ''), coalesce(column_default, '') || is_nullable"
    " FROM information_schema.columns WHERE table_schema = 'public'"
    " UNION ALL SELECT tablename, indexname, '', indexdef FROM pg_indexes WHERE schemaname = 'public'"
    " UNION ALL SELECT conrelid::regclass::text, conname, '', pg_get_constraintdef(oid) FROM pg_constraint"
    " WHERE connamespace = 'public'::regnamespace",
}
"""All that a schema consists of, in the backend's own words."""


@pytest.fixture
def migrated(request: pytest.FixtureRequest, backend: str) -> Iterator[Database]:
    """A database that was new at this drivecal's revision."""
    name = "migrated_sqlite" if backend == "sqlite" else "migrated_postgres"
    found = request.getfixturevalue(name)
    opened = Database.open(f"sqlite:///{found}" if backend == "sqlite" else str(found))
    yield opened
    opened.dispose()


def assert_references_answer(old: Database) -> None:
    """AssertionError if a reference of an upgraded database answers by another run."""
    with old.read() as connection:
        asked = connection.execute(text("SELECT * FROM reference_keys")).mappings().all()
        indexes = {index.id: index for index in reference_keys.indexes(connection)}
        for row in asked:
            index = indexes[row["index_id"]]
            found = reference_keys.look_up(
                connection, index.influence_map_sequence, index.setup_id, [bytes(row["key"])], index.evaluator, row["run_id"]
            )
            [donor] = found.values()
            assert (donor.run, donor.evaluation) == (row["run_id"], row["evaluation_id"])
        [(setup, parameter_set, evaluation)] = connection.execute(
            text("SELECT setup_id, parameter_set_id, evaluation_id FROM runs WHERE id = 7")
        )
        exact = runs.look_up_exact(connection, setup, [parameter_set], indexes[1].evaluator, 10**6)
        assert [one.evaluation for one in exact.values()] == [evaluation]
    assert len(asked) > 250


@pytest.mark.slow("sqlite-0003", "sqlite-0005", "sqlite-0014", "postgresql-0001")
@kept
def test_campaigns_of_the_old_release_are_shown_carried_on_and_rerun(old: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    old.upgrade()
    install_versions_of(old, monkeypatch)
    with old.read() as connection:
        listed, _ = campaigns.page(connection)
        analysed, running = (next(one for one in listed if test(one)) for test in (_is_analysed, _is_running))
        assert {
            one.name: len(list(results.stream(connection, one.sequence))) for one in listed if one.kind != "comparison"
        } == {
            "queued": 0,
            "test": 32,
            "rerun": 32,
            "analysed": 224,
        }
        assert analysed.best is not None
        assert (analysed.priority, analysed.degraded) == (0, None)
        told = [one.kind for one in events.since(connection, running.sequence, 0, 10)]
        assert told in ([], ["note"], ["queued", "running", "stage"]), "of revisions before and since events"
    with old.transaction() as connection:
        campaigns.request_action(connection, next(one.id for one in listed if one.name == "queued"), "cancel")
    ended = finish(old, running, dispatcher(old, ComputedBackend(5)))
    assert (ended.state, ended.error) == (CampaignState.SUCCEEDED, None)
    again = run(
        old, submit(old, stored_map=running.influence_map_id, catalogue=["S1", "S2"], optimizer=running.spec["optimizer"])
    )
    assert again.cells.simulated == 0, "the same search on the same references"
    assert again.best is not None
    assert again.cells.repeated + again.cells.reused == again.cells.requested > 0
    assert [verdict for verdict in verify(old, full=True) if verdict.problems] == []


def install_versions_of(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    """The versions of the release: others would not go on with its campaigns, nor use its references."""
    with database.read() as connection:
        documents = [setup.document for setup in setups.counts(connection)]
    digests = {document["scenario"]: document["scenario_digest"] for document in documents}
    monkeypatch.setattr(type(registry.driving_function("frenet")), "version", documents[0]["driving_function_version"])
    monkeypatch.setattr("drivecal.plugins.setups.simulator", lambda: documents[0]["simulator"])
    monkeypatch.setattr(Scenario, "digest", property(lambda scenario: digests.get(scenario.id, scenario.id)))


def _is_analysed(campaign: StoredCampaign) -> bool:
    return campaign.name == "analysed"


def _is_running(campaign: StoredCampaign) -> bool:
    return campaign.state is CampaignState.RUNNING


@pytest.mark.slow("postgresql", "sqlite-1")
@pytest.mark.parametrize("statement", [1, 12, None])
def test_a_killed_upgrade_leaves_the_old_revision_or_the_new_one(empty_url: str, statement: int | None) -> None:
    database = Database.open(empty_url)
    load.create(database, "0001")
    with database.read() as connection:
        columns = columns_of(connection)
        before = stored(connection, columns)
    database.dispose()
    process = PROCESSES.Process(target=_upgrade_and_die, args=(empty_url, statement))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    with database.read() as connection:
        assert schema.revision_of(connection) == "0001"
        assert columns_of(connection) == columns
        assert stored(connection, columns) == before
    database.upgrade()
    assert [verdict for verdict in verify(database, full=True) if verdict.problems] == []
    database.dispose()


def _upgrade_and_die(url: str, at: int | None) -> None:
    """Ends without another word after so many statements of the upgrade that change something; None: when it is about to commit."""
    changes = 0

    def count(_: Any, __: Any, statement: str, *___: Any) -> None:
        nonlocal changes
        changes += statement.lstrip().startswith(("CREATE", "ALTER", "INSERT", "UPDATE", "DROP"))
        if changes == at:
            os.kill(os.getpid(), signal.SIGKILL)

    def commit(_: Any) -> None:
        if changes:
            os.kill(os.getpid(), signal.SIGKILL)

    event.listen(Engine, "after_cursor_execute", count)
    event.listen(Engine, "commit", commit)
    Database.open(url).upgrade()


def test_two_processes_may_upgrade_an_old_database_at_once(empty_url: str) -> None:
    database = Database.open(empty_url)
    load.create(database, "0001")
    with PROCESSES.Pool(2) as pool:
        pool.map(migrate, [empty_url] * 2)
    assert [verdict for verdict in verify(database, full=True) if verdict.problems] == []
    database.dispose()


def test_an_upgrade_is_refused_while_a_server_holds_the_database(empty_url: str) -> None:
    database = Database.open(empty_url)
    load.create(database, "0001")
    arguments = ["db", "upgrade", "--database-url", empty_url]
    with locks.hold(empty_url):
        refused = CliRunner().invoke(app, arguments)
        assert refused.exit_code == 1
        assert "another drivecal server" in refused.output
        with database.read() as connection:
            assert schema.revision_of(connection) == "0001"
    assert CliRunner().invoke(app, arguments).exit_code == 0
    database.check()
    database.dispose()


def test_a_reader_during_an_upgrade_sees_the_old_revision_or_the_new_one(empty_url: str) -> None:
    database = Database.open(empty_url)
    load.create(database, "0001")

    def seen() -> tuple[str | None, int, bool]:
        """The revision, the rows and the shape of one moment."""
        with database.read() as connection:
            rows = sum(
                connection.execute(text(f"SELECT count(*) FROM {table}")).scalar_one() for table in ("campaigns", "runs")
            )
            return schema.revision_of(connection), rows, "leases" in columns_of(connection)

    before, ended, moments = seen(), threading.Event(), []

    def upgrade() -> None:
        try:
            database.upgrade()
        finally:
            ended.set()

    writer = threading.Thread(target=upgrade)
    writer.start()
    while not ended.is_set():
        moments.append(seen())
    writer.join()
    after = seen()
    assert (before[0], before[2], after[0], after[2]) == ("0001", False, REVISIONS[-1], True)
    assert after[1] == before[1]
    assert set(moments) <= {before, after}
    database.dispose()


def test_an_upgrade_that_fails_leaves_the_old_revision(empty_url: str) -> None:
    database = Database.open(empty_url)
    load.create(database, "0001")
    with database.transaction() as connection:
        connection.execute(text("CREATE TABLE events (somebody TEXT)"))  # in the way of the next revision
    with pytest.raises(Exception, match=r"(?i)events.*already exists"):
        database.upgrade()
    with database.read() as connection:
        assert schema.revision_of(connection) == "0001"
        assert "leases" not in columns_of(connection)
        assert "priority" not in columns_of(connection)["campaigns"]
    with pytest.raises(DatabaseError, match="0001"):
        database.check()
    database.dispose()
