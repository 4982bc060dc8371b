"""Comparisons through database and dispatcher, with formulas in the place of the simulation."""

from collections.abc import Iterator
from typing import Any

import pytest
from sqlalchemy import update
from tests.support.comparisons import TWO_OPTIMIZERS, finish_comparison, read_comparison, runs_of, submit_comparison
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.runs import EXPERT_SPACE, everything, get, nothing_matters, post_map, rows_of, run, submit

from drivecal.api import submission
from drivecal.api.dependencies import Limits
from drivecal.campaigns import comparison
from drivecal.configuration.settings import load_settings
from drivecal.contracts.comparison import ComparisonSpecification
from drivecal.domain.errors import ConflictError, NotFoundError, OverloadError
from drivecal.storage.engine import tables
from drivecal.storage.engine.database import Database

Compared = tuple[Database, str, ComputedBackend]


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Compared]:
    """A comparison on an empty database, carried out to its end."""
    opened = migrated(f"sqlite:///{tmp_path_factory.mktemp('compared') / 'drivecal.db'}")
    backend, tag = ComputedBackend(), submit_comparison(opened)
    finish_comparison(opened, tag, backend)
    yield opened, tag, backend
    opened.dispose()


@pytest.mark.slow
def test_common_cells_are_simulated_once_and_counted_by_each(compared: Compared) -> None:
    database, tag, backend = compared
    campaigns = runs_of(database, tag)
    assert len(backend.sent) < sum(campaign.cells.simulated for campaign in campaigns)
    for campaign in campaigns:
        rows = rows_of(database, campaign)
        distinct = {(row.scenario, *row.parameters.floats.values()) for row in rows}
        assert campaign.cells.simulated == len(distinct), "what it would have taken alone"
        assert campaign.cells.repeated == len(rows) - len(distinct)


def test_a_repeated_request_queues_no_campaign_again(database: Database) -> None:
    wanted, room = ComparisonSpecification.model_validate(TWO_OPTIMIZERS), Limits.of(load_settings(queued_campaigns=12))
    tag = submission.compare(database, room, wanted, "key")
    queued = runs_of(database, tag)
    assert len(queued) == 12
    with pytest.raises(OverloadError):
        submission.compare(database, Limits.of(load_settings(queued_campaigns=23)), wanted, "other key")
    with database.transaction() as connection:  # as its deletion does
        connection.execute(
            update(tables.campaigns).where(tables.campaigns.c.sequence == queued[0].sequence).values(idempotency_key=None)
        )
    assert submission.compare(database, room, wanted, "key") == tag
    assert [campaign.id for campaign in runs_of(database, tag)] == [campaign.id for campaign in queued]
    with pytest.raises(ConflictError):
        submission.compare(database, room, wanted.model_copy(update={"iterations": 4}), "key")


@pytest.mark.slow
def test_what_was_stored_before_changes_no_count(compared: Compared, database: Database) -> None:
    before, tag, _ = compared
    run(database, submit(database, catalogue=["S1", "S2"]))
    alone = submit_comparison(database, optimizers=[{"kind": "swarm"}])
    finish_comparison(database, alone)
    swarms = [everything(before, campaign) for campaign in runs_of(before, tag)[6:]]
    assert [everything(database, campaign) for campaign in runs_of(database, alone)] == swarms
    backend, again = ComputedBackend(), submit_comparison(database, optimizers=[{"kind": "swarm"}])
    finish_comparison(database, again, backend)
    assert backend.sent == []
    assert [everything(database, campaign) for campaign in runs_of(database, again)] == swarms


WITHOUT_LOTS = {"mode": "influence", "audit": 0.4, "max_error": 1}


def test_a_shared_cell_counts_in_the_budget_of_each(database: Database) -> None:
    optimizer = {"kind": "genetic", "population": 10, "iterations": 100, "seed": 1}
    search: dict[str, Any] = {"optimizer": optimizer, "budget": {"simulations": 120}, "reduction": {"isolated": True}}
    own, shared = (run(database, submit(database, **search), ComputedBackend()).cells for _ in range(2))
    assert (own.requested, own.runs, shared.requested, shared.runs) == (own.requested, own.simulated, own.requested, 0)


def test_unconfirmed_campaigns_have_the_best_they_simulated(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparison, "CONFIRMED", 0)
    stored_map = post_map(database, nothing_matters() | {"S1": {"P1": {"influential": True}}})
    given: dict[str, Any] = {
        "optimizers": [{"kind": "genetic"}],
        "populations": [9],
        "reductions": [WITHOUT_LOTS],
        "start": "halton",
    }
    runs = finish_comparison(database, submit_comparison(database, stored_map, **given)).runs
    assert [run.confirmations for run in runs] == [0, 0, 0]
    assert any(run.best != run.simulated_best for run in runs)


def test_any_campaigns_with_a_common_tag_are_compared(database: Database) -> None:
    tagged = [
        submit(database, optimizer={"kind": kind, "population": 6, "iterations": 2, "seed": 1}) for kind in ("random", "swarm")
    ]
    with database.transaction() as connection:
        connection.execute(update(tables.campaigns).values(tags=("mine",)))
    answer = finish_comparison(database, "mine")
    assert [(run.campaign, run.optimizer) for run in answer.runs] == [(tagged[0].id, "random"), (tagged[1].id, "swarm")]
    with pytest.raises(NotFoundError):
        read_comparison(database, "yours")


def test_a_confirmed_campaign_has_the_optimum_of_its_objective(database: Database) -> None:
    stored_map = post_map(database, nothing_matters() | {"S1": {"P1": {"influential": True}}})
    objectives = [{"score": "comfort", "aggregate": "min"}]
    optimizer = {"kind": "genetic", "population": 9, "iterations": 3}
    submitted = submit(database, stored_map=stored_map, objectives=objectives, optimizer=optimizer, parameters=EXPERT_SPACE)
    with database.transaction() as connection:
        connection.execute(update(tables.campaigns).values(tags=("mine",)))
    [compared_run] = finish_comparison(database, "mine").runs
    campaign = get(database, submitted)
    assert campaign.best is not None
    assert campaign.best.objective == min(campaign.best.scores.values())
    assert campaign.confirmation is not None
    assert compared_run.simulated_best == campaign.best.objective
