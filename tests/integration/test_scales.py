"""Campaigns whose scores have another scale than comfort: less is better, 0 to 100, no steps, a failed run is worth 100."""

import numpy as np
import pytest
from tests.support.computed import ComputedBackend, rating_of
from tests.support.runs import WITH_ANALYSIS, nothing_matters, post_map, rows_of, run, submit
from tests.support.scales import COST

from drivecal.analysis.solutions import Ranking
from drivecal.api.responses import campaign_answer
from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.problem import resolve
from drivecal.campaigns.results.explanation import explain
from drivecal.campaigns.stages.validation import compared
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.specification import CampaignSpecification, ReductionSpecification
from drivecal.contracts.tables import ValidationRow
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.scales import COMFORT
from drivecal.storage import events, generations, results
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now


@pytest.fixture(autouse=True)
def costs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every evaluator's scale is `COST`."""
    monkeypatch.setattr(Bench, "scale", property(lambda _: COST))


def costly(scenario: str, cell: Cell) -> CellResult:
    """Costs beyond 100, and failures that the worker believes to be the best of all."""
    cost = 17.0 * rating_of(scenario, cell)
    failed = cost < 8.5
    return CellResult(
        cell.id, 0.0 if failed else cost, 0 if failed else cost, {"cost": cost}, "collision" if failed else None, 7.0
    )


def test_the_search_minimises_and_a_failed_run_never_wins(database: Database) -> None:
    ended = run(database, submit(database), ComputedBackend(answer=costly))
    rows = rows_of(database, ended)
    assert {row.score for row in rows if row.failure} == {100}
    assert max(row.score or 0 for row in rows) == 100, "no score is worse than that of a failed run"
    assert any(isinstance(row.score, float) for row in rows)
    with database.read() as connection:
        ranking = Ranking({"S1": 1.0, "S2": 1.0, "S3": 1.0}, COST.sign)
        ranking.add(results.answers(connection, ended.sequence, StageName.CALIBRATION))
        ranked = ranking.ranking()
        figures = [each for _, each in generations.page(connection, ended.sequence)[0]]
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


def test_audits_of_reuse_are_wrong_beyond_the_tolerance(database: Database) -> None:
    """A map that says that nothing matters is found out, and cells say by how much it is wrong."""
    stored_map = post_map(database, nothing_matters())
    reduction = {"mode": "influence", "audit": 0.5, "max_error": 1.0}
    ended = run(database, submit(database, stored_map=stored_map, reduction=reduction), ComputedBackend(answer=costly))
    rows = {row.id: row for row in rows_of(database, ended)}
    audited = [row for row in rows.values() if row.audited]
    changes = [abs((row.score or 0.0) - (rows[row.reference or 0].score or 0.0)) for row in audited]
    rates = ended.error_rate.values()
    assert sum(rate.audited for rate in rates) == len(audited) > 0
    assert sum(rate.wrong for rate in rates) == sum(change > 2 + 1e-6 for change in changes)
    assert sum(rate.different for rate in rates) == sum(change > 1e-6 for change in changes)
    assert sum(rate.contradictions for rate in rates) > 0
    with database.read() as connection:
        for row, change in zip(audited, changes, strict=True):
            check = explain(connection, row.id).check
            assert check is not None
            assert (check.wrong, check.agrees) == (change > 2 + 1e-6, change <= 1e-6)


def test_an_analysis_of_scores_beyond_the_comfort_scale_ends(database: Database) -> None:
    ended = run(database, submit(database, **WITH_ANALYSIS), ComputedBackend(answer=costly))
    assert ended.influence_map_id is not None
    assert ended.best is not None
    assert ended.best.objective < 100


def test_differences_of_scores_cannot_exceed_their_range() -> None:
    given = {"sensitivity": None, "reduction": {"tolerance": 101.0}, "robustness": {"eta": 250.0}}
    with pytest.raises(InvalidInputError) as raised:
        resolve(CampaignSpecification.model_validate(given))
    assert [problem.field for problem in raised.value.problems] == ["robustness.eta", "reduction.tolerance"]


def test_the_default_tolerance_of_predictions_is_the_scores() -> None:
    default, given = ReductionSpecification(), ReductionSpecification(tolerance=0.5)
    assert [default.tolerance_on(scale) for scale in (COMFORT, COST)] == [0, 2]
    assert [given.tolerance_on(scale) for scale in (COMFORT, COST)] == [0.5, 0.5]


def test_validations_count_differences_in_steps_of_the_scale() -> None:
    row = compared(np.array([0.0, 1e-9, 0.9, -2.0, 2.1, -50.0]), COST)
    assert (row["compared"], row["wrong"], row["different"]) == (6, 2, 4)
    assert row["histogram"] == {"-12": 1, "0": 4, "1": 1}
    assert row["histogram_step"] == 4
    points = compared(np.array([0.0, 1.0, -1.0, 2.0]), COMFORT)
    assert (points["wrong"], points["different"], points["histogram"]) == (1, 3, {"-1": 1, "0": 1, "1": 1, "2": 1})
    assert ValidationRow.model_fields["histogram_step"].default == COMFORT.bin
