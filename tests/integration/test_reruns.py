"""Expert start sets and reruns by weights, scenarios and evaluator: whole campaigns on a formula."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pytest
from tests.support.changes import install
from tests.support.computed import ComputedBackend
from tests.support.problems import LIMITS, scored, store, submit_checked
from tests.support.runs import WITH_ANALYSIS, influenced, rows_of, run
from tests.support.values import faulty_fields, numbers, present

from drivecal.api import submission
from drivecal.api.tables.ranking import solution_pages
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.cells.rerating import rate_stored_runs
from drivecal.campaigns.resolve.maps import map_from_document
from drivecal.campaigns.resolve.problem import resolve
from drivecal.campaigns.results.front import StoredRanking
from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification, RerunSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome, Rating
from drivecal.domain.setups import Setup
from drivecal.highway.comfort.reference import Manoeuvre
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps


@dataclass(frozen=True)
class Strict:
    """Rates 1 lower than the simulation did, never below 0, from the metric that it left."""

    name: str = "strict"
    version: str = "7"

    def rate(self, rated_as: str, metrics: Mapping[str, float]) -> Rating:
        del rated_as
        rating = max(0.0, metrics["comfort"] - 1)
        return Rating(rating, round(rating))


def strict_answer(scenario: str, cell: Cell) -> CellResult:
    """Returns what a worker with that evaluator gives."""
    usual = influenced(scenario, cell)
    if usual.failure:
        return usual
    rating = Strict().rate(Manoeuvre.LANE_CHANGE, usual.metrics)
    return CellResult(cell.id, rating.rating, rating.score, usual.metrics, None, 7.0)


@pytest.fixture
def strict(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second evaluator is installed."""
    install(monkeypatch, "evaluator", Strict())


def _run(database: Database, **changes: Any) -> StoredCampaign:
    return run(database, submit_checked(database, WITH_ANALYSIS | changes), ComputedBackend(answer=influenced))


def _rerun(database: Database, first: StoredCampaign, backend: ComputedBackend | None = None, **changes: Any) -> StoredCampaign:
    new = RerunSpecification.model_validate({"weights": {}} | changes)
    return run(database, submission.rerun(database, LIMITS, first.id, new, None), backend or ComputedBackend(answer=influenced))


@pytest.mark.slow
def test_expert_sets_are_in_the_start_population_after_the_baseline(database: Database) -> None:
    baseline = dict.fromkeys(("P1", "P2", "P3", "P4"), 0.2)
    experts = [{"P1": 1, "P2": 0, "P3": 0.9, "P4": 0.1}, baseline, {"P1": 0, "P2": 1, "P3": 0.1, "P4": 0.9}]
    optimizer = WITH_ANALYSIS["optimizer"] | {"start_sets": experts}
    ended = _run(database, baseline=baseline, optimizer=optimizer)
    rows = [row for row in rows_of(database, ended) if row.stage is StageName.CALIBRATION]
    first = {row.individual: numbers(row.parameters) for row in rows if row.iteration == 0}
    given = [{name: first[place][name] for name in baseline} for place in range(3)]
    assert given == [baseline, experts[0], experts[2]], "each once"
    assert present(ended.baseline).objective is not None


@pytest.mark.usefixtures("strict")
def test_a_mode_that_was_asked_for_beside_a_map_stays_with_another_evaluator(database: Database) -> None:
    first, other = _run(database, reduction={"mode": "predicted"}), RerunSpecification(weights={}, evaluator="strict")
    assert submission.rerun(database, LIMITS, first.id, other, None).spec["reduction"]["mode"] == "predicted"


@pytest.mark.slow
@pytest.mark.usefixtures("strict")
def test_another_evaluator_rates_stored_runs_and_simulates_only_what_is_new(database: Database) -> None:
    first = _run(database)
    backend = ComputedBackend(answer=strict_answer)
    again = _rerun(database, first, backend, evaluator="strict")
    assert again.spec["evaluator"] == "strict"
    assert again.influence_map_id != first.influence_map_id, "the map was made from the other ratings"
    assert again.counts(StageName.SENSITIVITY).repeated > 0.7 * again.counts(StageName.SENSITIVITY).requested
    assert again.cells.repeated + again.cells.reused > 0
    with database.read() as connection:
        made = influence_maps.get(connection, again.influence_map_id or "none")
    assert present(made.basis)["evaluator"] == "strict 7"
    assert map_from_document(made.scenarios).influence("S1", "P1").influential
    rows = rows_of(database, again)
    for row in rows:
        if row.outcome is not Outcome.REUSED:
            expected = strict_answer(row.scenario, Cell(1, numbers(row.parameters)))
            assert (row.score, row.rating, row.failure) == (expected.score, expected.rating, expected.failure)
    assert any(row.failure == "collision" and row.score == 0 and row.outcome is Outcome.REPEATED for row in rows)
    assert len(backend.sent) == again.cells.simulated + again.counts(StageName.SENSITIVITY).simulated
    for rate in again.error_rate.values():
        assert rate.wrong == rate.different == 0
    third = _rerun(database, again, weights={"S1": 3}, evaluator="strict")
    assert third.influence_map_id == again.influence_map_id
    back = _rerun(database, again, evaluator="reference")
    assert back.counts(StageName.SENSITIVITY).simulated == 0
    assert back.best == first.best


@pytest.mark.usefixtures("strict")
def test_ratings_are_added_in_chunks_to_what_the_campaign_sees_and_once(database: Database) -> None:
    first = _run(database, sensitivity=None)
    problem = resolve(CampaignSpecification.model_validate(WITH_ANALYSIS | {"evaluator": "strict"}))
    view = View(1, 10, problem.bench)
    assert rate_stored_runs(database, view, chunk=3) == 10
    assert rate_stored_runs(database, view, chunk=3) == 0
    everything = View(1, 10**6, problem.bench)
    assert rate_stored_runs(database, everything) == first.cells.simulated - 10


@pytest.mark.usefixtures("strict")
def test_a_single_evaluation_by_another_evaluator_is_answered_from_the_stored_run(database: Database) -> None:
    first = _run(database, sensitivity=None, optimizer={"kind": "random", "population": 6, "iterations": 1})
    row = next(row for row in rows_of(database, first) if row.scenario == "S1" and not row.failure)
    wanted = EvaluationSpecification(parameters={**numbers(row.parameters)}, scenario="S1", evaluator="strict")
    backend = ComputedBackend(answer=strict_answer)
    ended = run(database, submission.evaluate(database, LIMITS, wanted, None), backend)
    assert (ended.cells.repeated, ended.cells.simulated, backend.sent) == (1, 0, [])


@pytest.mark.slow("without lots")
@pytest.mark.parametrize("limit", [1, 0.2], ids=["without lots", "with lots"])
def test_a_rerun_with_equal_weights_simulates_nothing(database: Database, limit: float) -> None:
    first = _run(database, reduction={"mode": "influence", "audit": 0.1, "max_error": limit})
    again = _rerun(database, first, weights={"S1": 5, "S2": 5})
    assert first.cells.reused > 0
    assert (again.cells.runs, again.cells.simulated, again.counts(StageName.SENSITIVITY).runs) == (0, 0, 0)
    assert (again.best, again.cells.requested, again.cells.reused) == (first.best, first.cells.requested, first.cells.reused)


RANGES = {name: {"lower": 0, "upper": 1, "step": 0.01} for name in ("a", "b")}
SCORES = {name: {"formula": of, "direction": "minimise", "range": [0, 10]} for name, of in (("cost", "y"), ("other", "z"))}
OPTIMIZER = {"kind": "random", "population": 4, "iterations": 5, "seed": 21}  # the best sets are not in the start population
CITY = {"weights": {"city": 9}}
SEARCH: dict[str, Any] = {"problem": "mine", "sensitivity": None, "optimizer": OPTIMIZER}
MINE = scored("mine", RANGES, baseline={"a": 0.5, "b": 1}) | {"measures": {"y": "1", "z": "1"}, "scores": SCORES}


def _driven(setup: Setup, cell: Cell) -> CellResult:
    a, b = float(cell.parameters["a"]), float(cell.parameters["b"])
    measures = {"y": a, "z": 3 * a} if setup.scenario == "city" else {"y": 5 * b, "z": 5 * (1 - a)}
    return CellResult(cell.id, None, None, measures, None, 7.0)


@pytest.mark.parametrize(
    ("asked", "changes", "by"),
    [
        ({}, CITY, ("city=9,road=1", None)),
        ({}, {"weights": {"road": 0}, "evaluator": "other"}, ("city=1,road=0", "other@mine")),
        ({"weights": {"city": 0.7, "road": 0.1}}, {"weights": {"city": 7}, "optimizer": {"seed": 5}}, None),
        ({"reduction": {"isolated": True}}, CITY, None),
        ({"optimizer": None, "sensitivity": {"samples": 2}}, {"optimizer": OPTIMIZER}, None),
        ({"optimizer": OPTIMIZER | {"population": 30, "iterations": 1}}, CITY, None),
        (
            {"optimizer": OPTIMIZER | {"start_sets": [{"a": 0, "b": 0}]}},
            CITY | {"optimizer": {"start_sets": []}},
            ("city=9", None),
        ),
    ],
)
def test_a_rerun_of_populations_begins_with_the_best_stored_set(
    database: Database, asked: dict[str, Any], changes: dict[str, Any], by: tuple[str | None, str | None] | None
) -> None:
    store(database, MINE)
    first = run(database, submit_checked(database, SEARCH | asked), ComputedBackend(driven=_driven))
    again = submission.rerun(database, LIMITS, first.id, RerunSpecification(**{"weights": {}} | changes), None)
    ranked = by and solution_pages(StoredRanking.of(database, first), *by).solutions(0, 1)
    assert again.spec["optimizer"]["start_sets"] == [row.parameters for row in ranked or ()]


def test_a_default_search_of_another_push_begins_with_the_best_set_of_the_first(database: Database) -> None:
    store(database, MINE)
    asked = SEARCH | {"optimizer": {"kind": "surrogate"}, "budget": {"simulations": 16}, "objectives": [{"score": "cost"}]}
    first = run(database, submit_checked(database, asked), ComputedBackend(driven=_driven))
    store(database, MINE | {"problem": "another"})

    def rerun(**changes: Any) -> StoredCampaign:
        return submission.rerun(database, LIMITS, first.id, RerunSpecification(weights={}, **changes), None)

    assert rerun(name="knows it").spec["optimizer"]["start_sets"] == []
    store(database, MINE, {"model.py": "another version"})
    assert rerun(problem="mine").spec["optimizer"]["start_sets"] == [present(first.best).parameters]
    assert rerun(problem="mine", optimizer={"kind": "external"}).spec["optimizer"]["start_sets"] == []
    assert faulty_fields(rerun, problem="another") == ["problem"]
    assert faulty_fields(rerun, evaluator="other") == ["evaluator"], "objectives keep the scores that they name"


def test_a_rerun_of_another_push_begins_with_a_set_that_it_allows(database: Database) -> None:
    store(database, MINE)
    first = run(database, submit_checked(database, SEARCH), ComputedBackend(driven=_driven))
    least = float(present(first.best).parameters["b"]) + 0.1
    store(database, MINE | {"constraints": [f"b >= {least}"]})
    again = submission.rerun(database, LIMITS, first.id, RerunSpecification(weights={}, problem="mine"), None)
    (begun,) = again.spec["optimizer"]["start_sets"]
    assert begun["b"] >= least
