"""Pruning: what stays is whole and answers as before, whatever was pruned and wherever it was killed."""

import json
from collections.abc import Callable
from typing import Any

import pytest
from sqlalchemy import Connection, text
from tests.support.computed import ComputedBackend
from tests.support.problems import MANIFEST, store
from tests.support.pruning import CUTOFF, SPACE, answers, carry_out, planned, problems, set_column
from tests.support.runs import dispatcher, finish, get, nothing_matters, post_map, run, submit
from typer.testing import CliRunner

from drivecal.api.responses import campaign_answer
from drivecal.api.results.document import account_of
from drivecal.campaigns.resolve.problem import CalibrationProblem, resolve
from drivecal.campaigns.stages.robustness import check_source
from drivecal.campaigns.stages.validation import check_predictions
from drivecal.cli.main import app
from drivecal.contracts.accounting import Accounting
from drivecal.contracts.specification import CampaignSpecification
from drivecal.domain.errors import ConflictError, InvalidInputError
from drivecal.storage.campaigns import StoredCampaign, by_sequence
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now

SMALL: dict[str, Any] = {
    "parameters": SPACE,
    "catalogue": ["S1"],
    "optimizer": {"kind": "genetic", "population": 8, "iterations": 2, "seed": 1},
    "reduction": {"mode": "exact"},
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


def accounting(database: Database, campaign: StoredCampaign) -> Accounting:
    with database.read() as connection:
        return account_of(connection, by_sequence(connection, campaign.sequence))


def test_a_campaign_whose_influence_map_another_uses_stays_whole(database: Database, old: StoredCampaign) -> None:
    made = post_map(database, nothing_matters())
    with database.transaction() as connection:
        connection.execute(text("UPDATE influence_maps SET source = :maker, basis = '{}'"), {"maker": old.id})
    again = run(database, submit(database, **SMALL))
    set_column(database, again, "influence_map_id", made)
    assert [spared.id for spared in planned(database, 0).selection.spared] == [old.id]
    assert accounting(database, again).map is not None
    set_column(database, again, "ended_at", (now() - 2 * CUTOFF).strftime("%Y-%m-%d %H:%M:%S.%f"))
    plan = planned(database, 0)
    assert len(plan.selection.prunable) == 2
    carry_out(database, plan)
    later = run(database, submit(database, **SMALL))
    set_column(database, later, "influence_map_id", made)
    assert accounting(database, later).map is None, "nothing says what it cost"


def test_the_account_of_a_pruned_campaign_is_marked_and_does_not_claim_to_be_whole(
    database: Database, old: StoredCampaign
) -> None:
    assert not accounting(database, old).pruned
    carry_out(database, planned(database, 1))
    account, answer = accounting(database, old), campaign_answer(get(database, old), now(), silent=None)
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
