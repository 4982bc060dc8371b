"""Campaigns whose scores have another scale than comfort: less is better, 0 to 100, no steps, a failed run is worth 100."""

import pytest
from tests.support.computed import ComputedBackend, rating_of
from tests.support.runs import rows_of, run, submit
from tests.support.values import COST, by_score, faulty_fields

from drivecal.api.responses import campaign_answer
from drivecal.bundles.manifest import ScoreEntry
from drivecal.campaigns.resolve.problem import resolve
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import StageName
from drivecal.storage import events, generations, results
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now


@pytest.fixture(autouse=True)
def costs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every evaluator's scale is `COST`."""
    monkeypatch.setattr(ScoreEntry, "scale", lambda *_: COST)


def costly(scenario: str, cell: Cell) -> CellResult:
    """Costs beyond 100, and failures that the worker believes to be the best of all."""
    cost = 17.0 * rating_of(scenario, cell)
    failure, believed = ("collision", 0.0) if cost < 8.5 else (None, cost)
    return CellResult(cell.id, believed, believed, {"cost": cost}, failure, 7.0)


def test_the_search_minimises_and_a_failed_run_never_wins(database: Database) -> None:
    ended = run(database, submit(database), ComputedBackend(answer=costly))
    rows = rows_of(database, ended)
    assert {row.score for row in rows if row.failure} == {100}
    assert max(row.score or 0 for row in rows) == 100, "no score is worse than that of a failed run"
    assert any(isinstance(row.score, float) for row in rows)
    with database.read() as connection:
        ranking = by_score({"S1": 1.0, "S2": 1.0, "S3": 1.0}, COST)
        ranking.add(results.answers(connection, ended.sequence, StageName.CALIBRATION))
        ranked = ranking.best_first()
        figures = generations.course(connection, ended.sequence)
        told = [event.data["objective"] for event in events.since(connection, ended.sequence, 0, 1_000) if event.kind == "best"]
    assert ended.best is not None
    assert [each.objective for each in ranked] == sorted(each.objective for each in ranked)
    assert ended.best.objective == pytest.approx(ranked[0].objective)
    answer = campaign_answer(ended, now(), None)
    assert answer.scale == Campaign.model_validate_json(answer.model_dump_json()).scale == COST
    best = [each.best or 0.0 for each in figures]
    assert best == sorted(best, reverse=True)
    assert told == sorted(told, reverse=True)
    means = [each.mean or 0.0 for each in figures]
    assert all((each.minimum or 0.0) >= mean for each, mean in zip(figures, means, strict=True)), "the worst is the highest"
    assert means[-1] < means[0]


def test_differences_of_scores_cannot_exceed_their_range() -> None:
    given = {"sensitivity": None, "reduction": {"tolerance": 101.0}, "robustness": {"eta": 250.0}}
    assert faulty_fields(resolve, CampaignSpecification.model_validate(given)) == ["robustness.eta", "reduction.tolerance"]
