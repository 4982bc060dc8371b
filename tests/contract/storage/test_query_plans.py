"""Queries that must be fast on tables of any size use an index on both backends.

A plan must not read a whole table, and must use the expected index. PostgreSQL gathers statistics by itself, so the tests gather some,
and ask for less than one row in a hundred, as from a large table: it would read a small table whole. SQLite gathers no statistics
unless asked. Its queries have as many values as one `IN` may hold.
"""

import json
import re
import shutil
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

import psycopg
import pytest
from psycopg import sql
from sqlalchemy import Connection, event, make_url, text
from tests.support.server import new_database
from tests.support.storage import EVALUATOR, campaign, new_evaluation, new_run, sample_set_ids, sample_sets, setup_id

from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome, Purpose
from drivecal.domain.events import EventKind
from drivecal.storage import audits, campaigns, evaluations, events, leases, lots, results, revision_queries, studies
from drivecal.storage.engine.bulk import LARGEST_IN
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.evaluations import AnsweredCell
from drivecal.storage.maintenance import deletion
from drivecal.storage.references import parameter_sets, reference_keys, runs

pytestmark = pytest.mark.slow

ROWS = 4_000
SMALL = {"metric_names", "reference_indexes", "leases", "processes", "traces", "lots"}
"""One row per list of measures, per map, setup and evaluator, one per cell at a worker, some traces, and no lot: PostgreSQL rightly reads
all of them."""
KEYS = [number.to_bytes(16, "big") for number in range(LARGEST_IN)]


@pytest.fixture(scope="module")
def template(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], str]:
    """Gives the URL of a backend's filled database, which is filled once."""
    made: dict[str, str] = {}

    def of(backend: str) -> str:
        if backend not in made:
            made[backend] = new_database(request, backend, tmp_path_factory.mktemp("filled"))
            database = Database.open(made[backend])
            database.upgrade()
            fill(database)
            database.dispose()
        return made[backend]

    return of


@pytest.fixture
def filled(backend: str, template: Callable[[str], str], request: pytest.FixtureRequest, tmp_path: Path) -> Database:
    """Tables that are large enough for a planner to prefer an index, and statistics about them."""
    original = make_url(template(backend)).database
    assert original is not None
    if backend == "sqlite":
        url = f"sqlite:///{shutil.copy(original, tmp_path / 'filled.db')}"
    else:
        server = make_url(request.getfixturevalue("postgres_server"))
        url = server.set(database=f"{original}_{tmp_path.name}").render_as_string(hide_password=False)
        with psycopg.connect(request.getfixturevalue("postgres_server"), autocommit=True) as connection:
            names = map(sql.Identifier, (f"{original}_{tmp_path.name}", original))
            connection.execute(sql.SQL("CREATE DATABASE {} TEMPLATE {}").format(*names))
    return Database.open(url)


def fill(database: Database) -> None:
    """Two campaigns with answered cells, their runs and reference keys."""
    with database.transaction() as connection:
        sequence, other, setup = campaign(connection).sequence, campaign(connection).sequence, setup_id(connection)
        sets = sample_set_ids(connection, ROWS)
        for item in (sequence, other):
            cells = [
                new_evaluation(StageName.CALIBRATION, n % 40, n, "S1", setup, set_id, Outcome.SIMULATED, reference_key=KEYS[n])
                for n, set_id in enumerate(sets)
            ]
            ids = evaluations.insert(connection, item, cells)
            stored = runs.insert_results(
                connection, [new_run(setup, cell.parameter_set_id, evaluation=n) for n, cell in zip(ids, cells, strict=True)]
            )
            evaluations.answer(
                connection,
                [AnsweredCell(n, Outcome.SIMULATED, 5, 5.25, run.id) for n, run in zip(ids, stored, strict=True) if n % 100],
            )
    reference_keys.sync(database, 1, setup, EVALUATOR, 10**9, lambda _, values: [KEYS[int(row[0]) // 10**7] for row in values])
    gather_statistics(database)


def gather_statistics(database: Database) -> None:
    """Gathers statistics, as PostgreSQL does by itself after a while."""
    with database.transaction() as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(text("ANALYZE"))


def plans(connection: Connection, use: Callable[[Connection], Any]) -> str:
    """How the backend carries out the statements of `use`, one after the other."""
    explained: list[str] = []

    def explain(one: Connection, _: Any, statement: str, parameters: Any, __: Any, executemany: bool) -> None:
        if not statement.startswith("EXPLAIN") and re.match(
            r"(WITH|SELECT|UPDATE|DELETE|INSERT.*\sSELECT)\b", statement, re.DOTALL
        ):
            values = parameters[0] if executemany else parameters
            prefix = "EXPLAIN QUERY PLAN " if one.dialect.name == "sqlite" else "EXPLAIN (FORMAT JSON) "
            rows = one.exec_driver_sql(prefix + statement, values).all()
            explained.extend(row[-1] if isinstance(row[-1], str) else json.dumps(row[-1]) for row in rows)

    event.listen(connection, "before_cursor_execute", explain)
    use(connection)
    event.remove(connection, "before_cursor_execute", explain)
    assert explained, "nothing was asked"
    return re.sub(r"'\{[^']*\}'", "'{...}'", "\n".join(explained))


def scanned(plan: str) -> set[str]:
    """The tables that a plan reads in full."""
    # The index of active campaigns holds only them: reading all of it is what it is for.
    sqlite = re.findall(r"^SCAN (\w+)\b(?! USING INDEX ix_campaigns_active)", plan, re.MULTILINE)
    postgres = re.findall(r'"Node Type": "Seq Scan".*?"Relation Name": "(\w+)"', plan)
    return {*sqlite, *postgres} - SMALL


def some(connection: Connection) -> int:
    """How many values to look up."""
    return 30 if connection.dialect.name == "postgresql" else LARGEST_IN


LOOK_UPS: dict[str, tuple[Callable[[Connection], Any], str]] = {
    "shared reference keys": (
        lambda connection: reference_keys.look_up(connection, 1, 1, KEYS[: some(connection)], EVALUATOR, 10**6),
        "pk_reference_keys|SEARCH reference_keys USING PRIMARY KEY",
    ),
    "last runs of a setup": (lambda connection: runs.rated(connection, 1, EVALUATOR, 10**6, 20), "ix_runs_origin"),
    "measures of runs": (
        lambda connection: runs.values_of(connection, range(1, some(connection))),
        "pk_runs|SEARCH runs USING INTEGER PRIMARY KEY",
    ),
    "shared parameter sets": (
        lambda connection: runs.look_up_exact(connection, 1, list(range(1, some(connection))), EVALUATOR, 10**6),
        "uq_runs_setup_id_parameter_set_id|sqlite_autoindex_runs_1",
    ),
    "own reference keys": (
        lambda connection: evaluations.own_answers(connection, 1, "S1", 1, KEYS[: some(connection)], by_key=True),
        "ix_evaluations_campaign_sequence_scenario_reference_key_plan",
    ),
    "own parameter sets": (
        lambda connection: evaluations.own_answers(connection, 1, "S1", 1, list(range(1, some(connection)))),
        "ix_evaluations_campaign_sequence_scenario_parameter_set_id_plan",
    ),
    "parameter sets by key": (
        lambda connection: parameter_sets.ensure(connection, sample_sets(some(connection))),
        "uq_parameter_sets_key|sqlite_autoindex_parameter_sets_1",
    ),
    "parameter sets by id": (
        lambda connection: parameter_sets.load(connection, list(range(1, some(connection)))),
        "pk_parameter_sets|INTEGER PRIMARY KEY",
    ),
    "leases of a campaign": (lambda connection: leases.forget(connection, 1), "ix_evaluations_pending"),
    "pending cells": (lambda connection: results.pending(connection, 1), "ix_evaluations_pending"),
    "answers": (
        lambda connection: evaluations.answer(connection, [AnsweredCell(100, Outcome.FAILED, None, None, None)]),
        "pk_evaluations|INTEGER PRIMARY KEY",
    ),
    "times of the newest answers": (
        lambda connection: evaluations.occupied(connection, 2, 2 * ROWS - 10),
        "pk_evaluations|evaluations USING INTEGER PRIMARY KEY",
    ),
    "the newest answers": (
        lambda connection: lots.known_answers(connection, 2, [1], 2 * ROWS - 10),
        "pk_evaluations|evaluations USING INTEGER PRIMARY KEY",
    ),
    "released predictions": (lambda connection: lots.release_predictions(connection, 1, [7]), "ix_evaluations_pending"),
    "a page in the middle": (
        lambda connection: results.page(connection, 1, limit=50, cursor=results.page(connection, 1, limit=50)[1]),
        "uq_evaluations_|sqlite_autoindex_evaluations_1",
    ),
    "one iteration's answers": (
        lambda connection: list(results.answers(connection, 1, StageName.CALIBRATION, iteration=3)),
        "uq_evaluations_|sqlite_autoindex_evaluations_1",
    ),
    "cells of a run": (
        lambda connection: connection.execute(text("SELECT id FROM evaluations WHERE run_id = 7")).all(),
        "ix_evaluations_run_id",
    ),
    "a slice of a deleted campaign": (
        lambda connection: deletion.remove_slice(connection, 1, range(1, some(connection))),
        "pk_evaluations|evaluations USING INTEGER PRIMARY KEY",
    ),
    "a watermark": (runs.largest_id, "pk_runs|SEARCH runs"),
}


def test_look_ups_use_their_indexes(filled: Database, subtests: pytest.Subtests) -> None:
    with filled.transaction() as connection:
        for name, (use, index) in LOOK_UPS.items():
            with subtests.test(name):
                plan = plans(connection, use)
                assert scanned(plan) == set(), plan
                assert re.search(index, plan), plan
        with subtests.test("a page is not sorted"):
            plan = plans(connection, LOOK_UPS["a page in the middle"][0])
            assert "TEMP B-TREE" not in plan
            assert '"Sort"' not in plan
        with subtests.test("the check for scans finds one"):
            query = text("SELECT count(*) FROM runs WHERE milliseconds > 1")
            assert scanned(plans(connection, lambda one: one.execute(query).all())) == {"runs"}


def test_late_ratings_are_not_searched_for_among_all_runs(filled: Database) -> None:
    with filled.read() as connection:
        plan = plans(connection, lambda one: reference_keys._rated(one, 1, EVALUATOR, 0, 10**9, 100))
    assert "ix_ratings_since" in plan, plan


def test_the_self_check_reads_the_campaigns_own_cells_only(filled: Database, subtests: pytest.Subtests) -> None:
    with filled.transaction() as connection:
        sequence = campaign(connection).sequence
        donor = evaluations.own_answers(connection, 1, "S1", 1, KEYS[1:2], by_key=True)[KEYS[1]]
        audit = {"donor": donor, "purpose": Purpose.AUDIT}
        cells = [
            new_evaluation(StageName.CALIBRATION, 0, n, "S1", 1, 1 + n, Outcome.SIMULATED, reference_key=KEYS[n], **audit)
            for n in range(30)
        ]
        ids = evaluations.insert(connection, sequence, cells)
        evaluations.answer(connection, [AnsweredCell(n, Outcome.SIMULATED, 5, 5.25, 1) for n in ids])
    gather_statistics(filled)
    checks: dict[str, Callable[[Connection], Any]] = {
        "contradictions": lambda connection: audits.contradictions(connection, sequence, 1, EVALUATOR, 10**6),
        "counted audits": lambda connection: audits.count(connection, sequence, EVALUATOR),
        "settled audits": lambda connection: audits.settle(connection, sequence, StageName.CALIBRATION, 0, EVALUATOR),
    }
    with filled.transaction() as connection:
        for name, use in checks.items():
            with subtests.test(name):
                plan = plans(connection, use)
                assert scanned(plan) == set(), plan


def test_a_campaign_and_the_active_ones_are_found_among_many_ended_ones(database: Database) -> None:
    with database.transaction() as connection:
        for number in range(1500):
            campaign(connection, str(number))
        connection.execute(text("UPDATE campaigns SET state = 'succeeded', ended_at = created_at WHERE sequence < 1500"))
    gather_statistics(database)
    with database.read() as connection:
        plan = plans(connection, campaigns.active)
        assert scanned(plan) == set(), plan
        assert "ix_campaigns_active" in plan
        some_id = campaigns.by_sequence(connection, 700).id
        plan = plans(connection, lambda one: revision_queries.campaign_revision(one, some_id))
        assert scanned(plan) <= {"processes"}, plan  # a table of two rows
        plan = plans(connection, lambda one: revision_queries.revision(one, 7))
        assert scanned(plan) == set(), plan


def test_a_page_of_campaigns_reads_no_single_evaluation(database: Database) -> None:
    with database.transaction() as connection:
        for number in range(300):
            campaign(connection, str(number))
        connection.execute(text("UPDATE campaigns SET kind = 'evaluation' WHERE sequence > 5"))
        for number in range(5):
            columns = "kind, name, state, spec, notes, progress, error_rate, simulating_seconds, created_at"
            copied = f"INSERT INTO campaigns (id, {columns}) SELECT id || '{number}', {columns} FROM campaigns"
            connection.execute(text(f"{copied} WHERE kind = 'evaluation'"))
    gather_statistics(database)
    with database.read() as connection:
        plan = plans(connection, lambda one: campaigns.page(one, limit=50))
        assert len(campaigns.page(connection, limit=50)[0]) == 5
    assert "ix_campaigns_listed" in plan, plan
    assert "TEMP B-TREE" not in plan


def test_studies_about_a_campaign_are_found_among_many(database: Database) -> None:
    with database.transaction() as connection:
        for number in range(1500):
            made = campaigns.insert(connection, name="study", spec={"robustness": {"of": f"{number:032x}"}})
            studies.save(connection, made.sequence, StageName.ROBUSTNESS, {"items": []})
        first = campaigns.by_sequence(connection, 1)
    gather_statistics(database)
    with database.read() as connection:
        plan = plans(connection, lambda one: studies.about(one, f"{7:032x}", 1, "0" * 32))
        assert scanned(plan) <= {"about_it"}, plan  # what was found by indexes
        assert "ix_campaigns_robustness_of" in plan
        assert scanned(plans(connection, lambda one: deletion.references(one, first))) <= {"influence_maps"}


def test_events_are_read_and_forgotten_by_their_indexes(database: Database) -> None:
    with database.transaction() as connection:
        sequences = [campaign(connection).sequence for _ in range(40)]
        for _ in range(50):
            for sequence in sequences:
                events.add(connection, sequence, EventKind.NOTE, {"text": "x"})
        connection.execute(text("UPDATE events SET created_at = '2020-01-01 00:00:00' WHERE id < 20"))
    gather_statistics(database)
    old = now() - timedelta(days=1)
    with database.transaction() as connection:
        for use, index in (
            (lambda one: events.since(one, 3, 1_000, 100), "ix_events_campaign_sequence_id"),
            (lambda one: events.newest_id(one, 3), "ix_events_campaign_sequence_id"),
            (lambda one: events.prune(one, old, 10), "ix_events_created_at"),
        ):
            plan = plans(connection, use)
            assert scanned(plan) == set(), plan
            assert index in plan, plan
            assert "TEMP B-TREE" not in plan
