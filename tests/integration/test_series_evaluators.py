"""Whole campaigns whose evaluator needs the time series: what it is given without a simulation, what is simulated again, and that once."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import pytest
from tests.support.changes import install
from tests.support.computed import ComputedBackend
from tests.support.problems import LIMITS, submit_checked
from tests.support.runs import WITH_ANALYSIS, influenced, run
from tests.support.values import present

from drivecal.api import submission
from drivecal.contracts.specification import RerunSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Rating
from drivecal.plugins.ports import Series
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance.consistency import verify

MAPPED = WITH_ANALYSIS | {"sensitivity": {"intervals": 2, "samples": 4, "threshold": 0.02}}


@dataclass(frozen=True)
class Seeing:
    """Rates half of what the simulation did, and only what it sees."""

    name: str = "seeing"
    version: str = "1"

    def rate(self, rated_as: str, metrics: Mapping[str, float]) -> Rating:
        raise ValueError(f"{rated_as} with {len(metrics)} metrics cannot be rated")

    def rate_series(self, rated_as: str, series: Series) -> Rating:
        raise AssertionError(f"asked of the coordinator: {rated_as}, {series}")


def seen(scenario: str, cell: Cell) -> CellResult:
    """Returns what a worker with that evaluator gives."""
    usual = influenced(scenario, cell)
    if usual.failure or usual.rating is None:
        return usual
    return replace(usual, rating=usual.rating / 2, score=round(usual.rating / 2))


@pytest.fixture(autouse=True)
def seeing(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, "evaluator", Seeing())


def rerun(database: Database, first: StoredCampaign, evaluator: str, backend: ComputedBackend) -> StoredCampaign:
    changes = RerunSpecification(weights={}, evaluator=evaluator)
    return run(database, submission.rerun(database, LIMITS, first.id, changes, None), backend)


@pytest.mark.slow
def test_runs_are_simulated_again_for_it_once_and_nothing_is_for_who_rates_by_metrics(database: Database) -> None:
    first = run(database, submit_checked(database, MAPPED), ComputedBackend(answer=influenced))
    again = rerun(database, first, "seeing", ComputedBackend(answer=seen))
    asked = again.cells.simulated + again.counts(StageName.SENSITIVITY).simulated
    assert asked > 100
    assert again.cells.unrepeatable == 0
    third = rerun(database, again, "seeing", ComputedBackend(answer=seen))
    assert third.influence_map_id == again.influence_map_id
    assert third.cells.simulated == third.cells.failed == 0, "the same search on the same ratings"
    assert present(third.best).objective == present(again.best).objective
    back = rerun(database, again, "reference", ComputedBackend(answer=influenced))
    assert back.counts(StageName.SENSITIVITY).simulated == 0
    assert back.best == first.best
    assert [verdict for verdict in verify(database) if verdict.problems] == []
