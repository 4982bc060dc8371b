"""Pruning: what stays is whole and answers as before, whatever was pruned and wherever it was killed."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from sqlalchemy import Connection, text
from tests.integration.test_certified_campaigns import alike
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.effort import examples
from tests.support.problems import MANIFEST, store
from tests.support.runs import dispatcher, finish, get, influenced, nothing_matters, post_map, run, submit
from typer.testing import CliRunner

from drivecal.api.responses import campaign_answer
from drivecal.api.routes.campaigns import accounting
from drivecal.api.tables.ranking import earlier_best, ranking
from drivecal.campaigns import retention
from drivecal.campaigns.resolve.problem import CalibrationProblem, resolve
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.results.explanation import explain
from drivecal.campaigns.results.verification import verify
from drivecal.campaigns.retention import RetentionPlan
from drivecal.campaigns.stages.prediction_validation import check_predictions
from drivecal.campaigns.stages.robustness import check_source
from drivecal.cli.main import app
from drivecal.contracts.specification import CampaignSpecification
from drivecal.domain.errors import ConflictError, InvalidInputError
from drivecal.storage import campaigns, generations, lots, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.retention import removal
from drivecal.storage.retention.selection import fingerprints_of

SPACE = [{"name": f"P{number}", "lower": 0, "upper": 1, "step": 0.25} for number in range(1, 12)]
CUTOFF = timedelta(days=90)
KINDS = ("exact", "influence", "certified", "predicted", "off")


@dataclass(frozen=True)
class Told:
    """A campaign of a history."""

    kind: str
    seed: int
    old: bool
    reruns: int | None
    """Position of the campaign that it names as its first, if there is such a position."""


campaigns_of_a_history = st.builds(
    Told,
    kind=st.sampled_from(KINDS),
    seed=st.integers(1, 2),
    old=st.booleans(),
    reruns=st.none() | st.integers(0, 3),
)


MIXED = ("influence", "certified", "predicted", "influence")


class KilledError(Exception):
    """Stands for the end of the process."""


@contextmanager
def fresh() -> Iterator[Database]:
    with tempfile.TemporaryDirectory() as folder:
        opened = migrated(f"sqlite:///{Path(folder) / 'drivecal.db'}")
        yield opened
        opened.dispose()


def tell(database: Database, history: list[Told]) -> list[StoredCampaign]:
    """Carries a history out, one campaign after the other; old ones ended 200 days ago."""
    stored = post_map(database, nothing_matters())
    made: list[StoredCampaign] = []
    for one in history:
        reduction = {"certified": one.kind == "certified", "mode": "exact" if one.kind == "certified" else one.kind}
        search = {"kind": "genetic", "population": 60 if one.kind == "predicted" else 8, "iterations": 2, "seed": one.seed}
        backend = ComputedBackend(answer=influenced, class_of=alike)
        campaign = submit(
            database,
            stored_map=stored if one.kind == "influence" else None,
            parameters=SPACE,
            catalogue=["S1", "S2"],
            optimizer=search,
            reduction=reduction,
        )
        if one.reruns is not None and one.reruns < len(made):
            set_column(database, campaign, "rerun_of", made[one.reruns].id)
        run(database, campaign, backend)
        if one.old:
            set_column(database, campaign, "ended_at", (now() - 2 * CUTOFF).strftime("%Y-%m-%d %H:%M:%S.%f"))
        made.append(get(database, campaign))
    return made


def set_column(database: Database, campaign: StoredCampaign, column: str, value: object) -> None:
    with database.transaction() as connection:
        statement = text(f"UPDATE campaigns SET {column} = :value WHERE sequence = :number")
        connection.execute(statement, {"value": value, "number": campaign.sequence})


def answers(database: Database, campaign: StoredCampaign) -> tuple[Any, ...]:
    """What a campaign answers: its row and cells, its ranking, the references of its cells, and the best set of its first campaign."""
    stored = get(database, campaign)
    with database.read() as connection:
        cells = list(results.stream(connection, campaign.sequence))
        figures, _ = generations.page(connection, campaign.sequence, limit=1_000)
        corrected = list(results.answers(connection, campaign.sequence, cells[0].stage, corrected_by=evaluator(stored)))
        explained = [explain(connection, cell.id) for cell in cells if cell.reference is not None or cell.proven_by is not None]
        inspected = lots.of_campaign(connection, campaign.sequence)
        first = None if stored.rerun_of is None else campaigns.get(connection, stored.rerun_of)
    ranked = ranking(database, stored, resolved_spec(stored), None)
    earlier = None if first is None else earlier_best(database, stored, first)
    return stored, cells, figures, corrected, explained, inspected, ranked.solutions(0, len(ranked)), earlier


def evaluator(campaign: StoredCampaign) -> str:
    return resolved_spec(campaign).evaluator


def problems(database: Database) -> list[str]:
    return [problem for verdict in verify(database, full=True) for problem in verdict.problems]


def planned(database: Database, keep_best: int) -> RetentionPlan:
    return retention.plan(database, now() - CUTOFF, keep_best)


def carry_out(database: Database, plan: RetentionPlan) -> None:
    retention.carry_out(database, plan, lambda *_: None)


def dangling(connection: Connection) -> int:
    """The cells that name a cell that is gone."""
    query = "SELECT count(*) FROM evaluations c WHERE {0} IS NOT NULL AND NOT EXISTS (SELECT 1 FROM evaluations d WHERE d.id = c.{0})"
    return sum(connection.execute(text(query.format(name))).scalar_one() for name in ("reference", "proven_by"))


@settings(max_examples=examples(2))
@example([Told("influence", 1, True, None), Told("influence", 2, True, None), Told("certified", 1, False, None)], 1, 3)
@given(
    history=st.lists(campaigns_of_a_history, min_size=2, max_size=3),
    keep_best=st.integers(0, 3),
    killed_after=st.none() | st.integers(1, 12),
)
def test_whatever_is_pruned_and_killed_the_rest_is_whole_and_answers_as_before(
    history: list[Told], keep_best: int, killed_after: int | None
) -> None:
    with fresh() as database:
        prune_a_history(database, history, keep_best, killed_after)


@pytest.mark.slow
def test_on_postgresql_the_rest_is_whole_and_answers_as_before(postgres_url: str) -> None:
    database = migrated(postgres_url)
    history = [Told(kind, 1 + number % 2, number < 3, 0 if number == 3 else None) for number, kind in enumerate(MIXED)]
    assert prune_a_history(database, history, 1, 3) > 0
    database.dispose()


def prune_a_history(database: Database, history: list[Told], keep_best: int, killed_after: int | None) -> int:
    """Carries a history out and prunes it, in small portions, killed once; everything that stays has to answer as before. Returns the
    number of cells that the first plan removes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(retention, "SLICE", 7)
        patch.setattr(retention, "CAMPAIGNS", 1)
        made = tell(database, history)
        plan = planned(database, keep_best)
        doomed: int = plan.doomed.cells
        prunable = {campaign.sequence for campaign in plan.selection.prunable}
        assert prunable <= {campaign.sequence for campaign, one in zip(made, history, strict=True) if one.old}
        kept = {campaign.sequence: answers(database, campaign) for campaign in made if campaign.sequence not in prunable}
        best = {
            campaign.sequence: ranking(database, campaign, resolved_spec(campaign), None).solutions(0, keep_best)
            for campaign in made
            if campaign.sequence in prunable
        }
        if killed_after is not None:
            with suppress(KilledError):
                carry_out(dying(database, killed_after), plan)
            assert problems(database) == []
            plan = planned(database, keep_best)
        carry_out(database, plan)
        assert problems(database) == []
        with database.read() as connection:
            assert dangling(connection) == 0
        for campaign in made:
            if campaign.sequence in kept:
                assert answers(database, campaign) == kept[campaign.sequence]
            else:
                left = ranking(database, campaign, resolved_spec(campaign), None).solutions(0, keep_best)
                assert left == best[campaign.sequence]
        assert planned(database, keep_best).doomed.cells == 0
    return doomed


def dying(database: Database, transactions: int) -> Database:
    """The same database for a process that is killed in the middle of its transaction of this number."""
    left = iter(range(transactions))

    class Dying(Database):
        @contextmanager
        def transaction(self) -> Iterator[Connection]:
            with super().transaction() as connection:
                yield connection
                if next(left, None) is None:
                    raise KilledError

    return Dying(database.url, database._engine)  # the same pool


SMALL: dict[str, Any] = {
    "parameters": SPACE,
    "catalogue": ["S1"],
    "optimizer": {"kind": "genetic", "population": 8, "iterations": 2, "seed": 1},
    "reduction": {"mode": "exact", "certified": False},
}


@pytest.fixture
def old(database: Database) -> StoredCampaign:
    """A campaign that ended long ago."""
    ended = run(database, submit(database, **SMALL))
    set_column(database, ended, "ended_at", (now() - 2 * CUTOFF).strftime("%Y-%m-%d %H:%M:%S.%f"))
    return get(database, ended)


def test_runs_that_a_later_campaign_was_answered_by_stay(database: Database, old: StoredCampaign) -> None:
    later = run(database, submit(database, **SMALL))
    assert later.cells.simulated == 0
    before = answers(database, later)
    carry_out(database, planned(database, 0))
    assert answers(database, later) == before
    assert get(database, old).cells == old.cells, "it counts what it had"


def test_a_pruned_campaigns_best_sets_need_no_simulation(database: Database, old: StoredCampaign) -> None:
    plan = planned(database, 2)
    carry_out(database, plan)
    assert plan.doomed.cells > plan.doomed.stay > 0
    again = run(database, submit(database, **SMALL))
    assert again.cells.repeated >= 2
    assert again.best == old.best
    assert "pruned" in get(database, old).notes[-1]
    assert problems(database) == []


def test_a_campaign_that_may_use_the_results_keeps_them(database: Database, old: StoredCampaign) -> None:
    running = submit(database, **SMALL | {"optimizer": SMALL["optimizer"] | {"seed": 5}})
    working = dispatcher(database, ComputedBackend())
    before = planned(database, 0)
    while get(database, running).started_at is None:
        working.step()
    plan = planned(database, 0)
    assert ([*plan.selection.prunable], plan.doomed.cells) == ([], 0)
    assert [spared.id for spared in plan.selection.spared] == [old.id]
    with pytest.raises(ConflictError):
        carry_out(database, before)
    finish(database, running, working)
    carry_out(database, planned(database, 0))
    assert problems(database) == []


def test_a_campaign_that_another_reruns_stays_whole(database: Database, old: StoredCampaign) -> None:
    again = run(database, submit(database, **SMALL))
    set_column(database, again, "rerun_of", old.id)
    assert [spared.id for spared in planned(database, 0).selection.spared] == [old.id]
    set_column(database, again, "ended_at", (now() - 2 * CUTOFF).strftime("%Y-%m-%d %H:%M:%S.%f"))
    assert len(planned(database, 0).selection.prunable) == 2


@pytest.mark.parametrize("field", ["rerun_of", "validation_of"])
def test_a_campaign_that_one_names_after_the_plan_stays_whole(database: Database, old: StoredCampaign, field: str) -> None:
    plan = planned(database, 0)
    queued = submit(database, **SMALL)
    if field == "rerun_of":
        set_column(database, queued, field, old.id)
    else:
        set_column(database, queued, "spec", json.dumps({**queued.spec, "validation": {"of": old.id}}))
    before = answers(database, old)
    with pytest.raises(ConflictError):
        carry_out(database, plan)
    assert answers(database, old) == before


def test_a_campaign_that_fails_before_its_setups_are_known_keeps_nothing(database: Database, old: StoredCampaign) -> None:
    plan = planned(database, 0)
    failed = submit(database, **SMALL)
    moment = now().strftime("%Y-%m-%d %H:%M:%S.%f")
    for column, value in {"state": "failed", "started_at": moment, "ended_at": moment}.items():
        set_column(database, failed, column, value)
    carry_out(database, plan)
    assert get(database, old).pruned_at is not None


def test_a_campaign_that_is_starting_is_waited_for(
    database: Database, old: StoredCampaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = planned(database, 0)
    starting = submit(database, **SMALL)
    set_column(database, starting, "started_at", now().strftime("%Y-%m-%d %H:%M:%S.%f"))
    waits: list[float] = []

    def wait(seconds: float) -> None:
        waits.append(seconds)
        if len(waits) == 2:  # the setups of another problem
            set_column(database, starting, "resolution", json.dumps({"setups": {"S1": "another"}}))

    monkeypatch.setattr("drivecal.campaigns.retention.time.sleep", wait)
    carry_out(database, plan)
    assert len(waits) == 2
    assert get(database, old).pruned_at is not None


def test_a_pruning_ends_though_another_has_removed_the_campaign(database: Database, old: StoredCampaign) -> None:
    set_column(database, old, "deleted_at", now().strftime("%Y-%m-%d %H:%M:%S.%f"))
    plans = [planned(database, 0) for _ in range(2)]
    for plan in plans:
        carry_out(database, plan)
    assert problems(database) == []
    with database.read() as connection:
        assert connection.scalar(text("SELECT count(*) FROM campaigns")) == 0


@pytest.mark.usefixtures("old")
def test_runs_of_more_setups_than_a_statement_takes_values_are_pruned(database: Database) -> None:
    many = range(10**6, 10**6 + 70_000)
    plan = planned(database, 0)
    with database.transaction() as connection:
        assert fingerprints_of(connection, [*plan.doomed.setups, *many]) == plan.fingerprints
        assert removal.retire_indexes(connection, many) == []


@pytest.mark.parametrize(("study", "check"), [("validation", check_predictions), ("robustness", check_source)])
def test_a_pruned_campaign_is_no_source_of_a_study(
    database: Database, old: StoredCampaign, study: str, check: Callable[[Connection, CalibrationProblem], None]
) -> None:
    carry_out(database, planned(database, 1))
    given = {"parameters": SPACE, "catalogue": ["S1"], "optimizer": None, "sensitivity": None, study: {"of": old.id}}
    asked = resolve(CampaignSpecification.model_validate(given))
    with database.read() as connection, pytest.raises(InvalidInputError) as refused:
        check(connection, asked)
    assert [(problem.field, "pruned" in problem.message) for problem in refused.value.problems] == [(f"{study}.of", True)]


def test_a_campaign_whose_influence_map_another_uses_stays_whole(database: Database, old: StoredCampaign) -> None:
    made = post_map(database, nothing_matters())
    with database.transaction() as connection:
        connection.execute(text("UPDATE influence_maps SET source = :maker, basis = '{}'"), {"maker": old.id})
    again = run(database, submit(database, **SMALL))
    set_column(database, again, "influence_map_id", made)
    assert [spared.id for spared in planned(database, 0).selection.spared] == [old.id]
    assert accounting(again.id, database).map is not None
    set_column(database, again, "ended_at", (now() - 2 * CUTOFF).strftime("%Y-%m-%d %H:%M:%S.%f"))
    plan = planned(database, 0)
    assert len(plan.selection.prunable) == 2
    carry_out(database, plan)
    later = run(database, submit(database, **SMALL))
    set_column(database, later, "influence_map_id", made)
    assert accounting(later.id, database).map is None, "nothing says what it cost"


def test_the_account_of_a_pruned_campaign_is_marked_and_does_not_claim_to_be_whole(
    database: Database, old: StoredCampaign
) -> None:
    assert not accounting(old.id, database).pruned
    carry_out(database, planned(database, 1))
    account, answer = accounting(old.id, database), campaign_answer(get(database, old), now(), silent=None)
    assert account.pruned
    assert account.requested < answer.cells.requested
    assert "pruned" in account.sentence
    assert answer.pruned_at is not None


def test_the_command_lists_what_goes_and_changes_nothing_in_a_dry_run(database: Database, old: StoredCampaign) -> None:
    url = database.url.render_as_string(hide_password=False)
    command = ["db", "prune", "--older", "90d", "--keep-best", "1", "--database-url", url, "--json"]
    dry = json.loads(CliRunner().invoke(app, [*command, "--dry-run"]).stdout)
    assert dry["cells"]["removed"] > 0
    assert [listed["id"] for listed in dry["campaigns"]] == [old.id]
    assert get(database, old) == old
    wet = json.loads(CliRunner().invoke(app, command).stdout)
    assert wet | {"dry_run": True} == dry
    assert json.loads(CliRunner().invoke(app, command).stdout)["cells"]["removed"] == 0
    assert CliRunner().invoke(app, ["db", "prune", "--older", "soon"]).exit_code == 2
    assert CliRunner().invoke(app, [*command, "--problem", "another"]).exit_code != 0
    store(database, MANIFEST | {"problem": "another"})
    other = json.loads(CliRunner().invoke(app, [*command, "--problem", "another"]).stdout)
    assert other["campaigns"] == []
