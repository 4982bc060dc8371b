"""Narrowed spaces, expert start sets and reruns by weights, scenarios and evaluator: whole campaigns on a formula."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.effort import tries
from tests.support.runs import WITH_ANALYSIS, dispatcher, get, influenced, request, run
from tests.support.values import numbers

from drivecal.api import submission
from drivecal.api.dependencies import Limits
from drivecal.api.tables.ranking import earlier_best, ranking
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.cells.rerating import rate_stored_runs
from drivecal.campaigns.resolve.maps import map_from_document
from drivecal.campaigns.resolve.problem import resolve
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.configuration.settings import load_settings
from drivecal.contracts.specification import (
    CampaignSpecification,
    EvaluationSpecification,
    RerunSpecification,
)
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.evaluations import Outcome, Rating
from drivecal.highway.manoeuvres import Manoeuvre
from drivecal.plugins import registry
from drivecal.plugins.ports import Evaluator
from drivecal.storage import campaigns, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.references import influence_maps

LIMITS = Limits.of(load_settings())


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
    """What a worker with that evaluator gives."""
    usual = influenced(scenario, cell)
    if usual.failure:
        return usual
    rating = Strict().rate(Manoeuvre.LANE_CHANGE, usual.metrics)
    return CellResult(cell.id, rating.rating, rating.score, usual.metrics, None, 7.0)


@pytest.fixture
def strict(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second evaluator is installed."""
    usual = registry.evaluator

    def find(name: str) -> Evaluator:
        return Strict() if name == "strict" else usual(name)

    monkeypatch.setattr(registry, "evaluator", find)


def _run(database: Database, **changes: Any) -> StoredCampaign:
    specification = CampaignSpecification.model_validate(WITH_ANALYSIS | changes)
    return run(database, submission.submit(database, LIMITS, specification, None), ComputedBackend(answer=influenced))


def _rerun(database: Database, first: StoredCampaign, backend: ComputedBackend | None = None, **changes: Any) -> StoredCampaign:
    wanted = RerunSpecification.model_validate({"weights": {}} | changes)
    return run(
        database, submission.rerun(database, LIMITS, first.id, wanted, None), backend or ComputedBackend(answer=influenced)
    )


@pytest.mark.slow
def test_a_narrowed_campaign_searches_where_some_scenario_is_influenced(database: Database) -> None:
    wide = _run(database)
    assert wide.narrowed is None
    narrow = _run(database, reduction={"mode": "influence", "audit": 0.1, "max_error": 1, "narrow": True})
    assert narrow.narrowed is not None
    found = {one.parameter: one for one in narrow.narrowed}
    assert set(found) == {"P2", "P3", "P4"}
    assert (found["P4"].lower, found["P4"].upper, found["P4"].removed_values) == (0.5, 0.5, 20)
    assert (found["P2"].lower, found["P3"].upper) == (0.0, 1.0)
    assert 0.5 <= found["P2"].upper <= 0.7
    assert 0.2 <= found["P3"].lower <= 0.4
    with database.read() as connection:
        rows = [row for row in results.stream(connection, narrow.sequence) if row.stage is StageName.CALIBRATION]
    for name, one in found.items():
        assert all(one.lower <= numbers(row.parameters)[name] <= one.upper for row in rows)
    assert any("narrowed" in note and "P4 held at 0.5" in note for note in narrow.notes)
    assert narrow.best is not None
    assert wide.best is not None
    assert narrow.best.objective >= wide.best.objective


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(tries(1, 2)))
def test_a_narrowed_campaign_that_was_killed_ends_like_one_that_was_not(
    tmp_path: Path, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivecal.storage.lots.secrets.token_bytes", lambda size: b"s" * size)  # both draw the same samples
    draw = random.Random(seed)
    ends = []
    expert = {"P1": 1, "P2": 0, "P3": 0.9, "P4": 0.1}
    changes: dict[str, Any] = {
        "reduction": {"mode": "influence", "audit": 0.1, "narrow": True},
        "optimizer": WITH_ANALYSIS["optimizer"] | {"start_sets": [expert]},
        "baseline": dict.fromkeys(("P1", "P2", "P3", "P4"), 0.2),
    }
    for killed in (False, True):
        opened = migrated(f"sqlite:///{tmp_path / str(killed)}.db")
        specification = CampaignSpecification.model_validate(WITH_ANALYSIS | changes)
        campaign = submission.submit(opened, LIMITS, specification, None)
        while not get(opened, campaign).state.ended:
            one = dispatcher(opened, ComputedBackend(draw.randrange(99), answer=influenced))
            for _ in range(draw.randrange(1, 12) if killed else 9_999):
                one.step()
                if get(opened, campaign).state.ended:
                    break
        ended = get(opened, campaign)
        with opened.read() as connection:
            cells = [
                (row.iteration, row.individual, row.parameters, row.outcome, row.score) for row in results.stream(connection, 1)
            ]
        ends.append((cells, ended.cells, ended.best, ended.narrowed, ended.notes, ended.baseline))
        opened.dispose()
    assert ends[0] == ends[1]
    assert ends[0][3]


@pytest.mark.slow
def test_expert_sets_are_in_the_start_population_after_the_baseline(database: Database) -> None:
    baseline = dict.fromkeys(("P1", "P2", "P3", "P4"), 0.2)
    experts = [{"P1": 1, "P2": 0, "P3": 0.9, "P4": 0.1}, baseline, {"P1": 0, "P2": 1, "P3": 0.1, "P4": 0.9}]
    optimizer = WITH_ANALYSIS["optimizer"] | {"start_sets": experts}
    for reduction in ({}, {"narrow": True}):
        ended = _run(database, baseline=baseline, optimizer=optimizer, reduction=reduction)
        with database.read() as connection:
            rows = [row for row in results.stream(connection, ended.sequence) if row.stage is StageName.CALIBRATION]
        first = {row.individual: numbers(row.parameters) for row in rows if row.iteration == 0}
        given = [{name: first[place][name] for name in baseline} for place in range(3)]
        assert given == [baseline, experts[0], experts[2]], "each once"
        assert ended.baseline is not None
        assert ended.baseline.objective is not None


def test_start_sets_that_do_not_fit_are_refused_by_name() -> None:
    optimizer = {
        "kind": "random",
        "population": 2,
        "start_sets": [{"P1": 0.033}, *({f"P{i}": n / 10 for i in range(1, 5)} for n in range(3))],
    }
    specification = CampaignSpecification.model_validate(WITH_ANALYSIS | {"optimizer": optimizer})
    with pytest.raises(InvalidInputError) as caught:
        resolve(specification)
    text = str(caught.value)
    assert "optimizer.start_sets[0].P1: 0.033" in text
    assert "optimizer.start_sets[0].P2: " in text
    assert "optimizer.start_sets: 3" in text


def test_without_a_map_there_is_nothing_to_narrow_by() -> None:
    specification = CampaignSpecification.model_validate(WITH_ANALYSIS | {"sensitivity": None, "reduction": {"narrow": True}})
    with pytest.raises(InvalidInputError, check=lambda error: error.problems[0].field == "reduction.narrow"):
        resolve(specification)


@pytest.mark.slow
def test_a_rerun_of_a_subset_of_the_scenarios_simulates_those_alone(database: Database) -> None:
    first = _run(database)
    backend = ComputedBackend(answer=influenced)
    again = _rerun(database, first, backend, weights={"S1": 0})
    assert again.influence_map_id == first.influence_map_id
    assert again.counts(StageName.SENSITIVITY).requested == 0
    assert set(again.error_rate) == {"S2"}
    assert {scenario for scenario, _ in backend.sent} <= {"S2"}
    assert any("S1" in note for note in again.notes)
    assert (again.cells.repeated + again.cells.reused) / again.cells.requested > 0.8


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
        rows = list(results.stream(connection, again.sequence))
        made = influence_maps.get(connection, again.influence_map_id or "none")
    assert made.basis is not None
    assert made.basis["evaluator"] == "strict 7"
    assert map_from_document(made.scenarios).influence("S1", "P1").influential
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


def forgetful(scenario: str, cell: Cell) -> CellResult:
    """What a worker gave that did not measure every run's comfort: that other evaluator cannot rate these."""
    usual = influenced(scenario, cell)
    return replace(usual, metrics={"undefined": 0.0}) if cell.parameters["P1"] < 0.3 else usual


@pytest.mark.slow
@pytest.mark.usefixtures("strict")
def test_what_another_campaign_simulates_meanwhile_changes_no_evaluators_view_of_stored_runs(tmp_path: Path) -> None:
    found = []
    for accompanied in (False, True):
        opened = migrated(f"sqlite:///{tmp_path / str(accompanied)}.db")
        specification = CampaignSpecification.model_validate(WITH_ANALYSIS)
        first = run(opened, submission.submit(opened, LIMITS, specification, None), ComputedBackend(answer=forgetful))
        changes = RerunSpecification(weights={}, evaluator="strict")
        slow = submission.rerun(opened, LIMITS, first.id, changes, None)
        one = dispatcher(opened, ComputedBackend(answer=strict_answer))
        one.step()
        request(opened, slow, "pause")
        while get(opened, slow).state is not CampaignState.PAUSED:
            one.step()
        if accompanied:
            fast = run(opened, submission.rerun(opened, LIMITS, first.id, changes, None), ComputedBackend(answer=strict_answer))
            assert fast.cells.unrepeatable > 0, "it simulated runs that the evaluator could not rate"
        request(opened, slow, "resume")
        run(opened, slow, ComputedBackend(answer=strict_answer))
        with opened.read() as connection:
            rows = [
                (row.stage, row.iteration, row.individual, row.scenario, row.plan, row.outcome, row.score)
                for row in results.stream(connection, slow.sequence)
            ]
        found.append((rows, get(opened, slow).best))
        opened.dispose()
    assert found[0] == found[1]


@pytest.mark.usefixtures("strict")
def test_a_single_evaluation_by_another_evaluator_is_answered_from_the_stored_run(database: Database) -> None:
    first = _run(database)
    with database.read() as connection:
        row = next(row for row in results.stream(connection, first.sequence) if row.scenario == "S1" and not row.failure)
    wanted = EvaluationSpecification.model_validate(
        {"parameters": numbers(row.parameters), "scenario": "S1", "evaluator": "strict"}
    )
    backend = ComputedBackend(answer=strict_answer)
    ended = run(database, submission.evaluate(database, LIMITS, wanted, None), backend)
    assert (ended.cells.repeated, ended.cells.simulated, backend.sent) == (1, 0, [])


def test_an_evaluator_that_is_not_installed_is_refused(database: Database) -> None:
    first = _run(database)
    with pytest.raises(InvalidInputError, check=lambda error: error.problems[0].field == "evaluator"):
        submission.rerun(database, LIMITS, first.id, RerunSpecification(weights={}, evaluator="learnt"), None)


@pytest.mark.parametrize("begun", [False, True])
@pytest.mark.parametrize(
    ("weights", "expected"),
    [({}, None), ({"S2": 0}, [0.5, 1.5]), ({"S1": 0, "S2": 0}, [1.5]), ({"S2": 0, "S3": 7}, [0.5, 1.5])],
)
def test_a_rerun_keeps_each_scenarios_own_eta(
    database: Database, weights: dict[str, float], expected: list[float] | None, *, begun: bool
) -> None:
    document = {
        "catalogue": ["S1", "S2", "S3"], "weights": {"S2": 0}, "sensitivity": None, "robustness": {"eta": [0.5, 1.5]},
        "optimizer": {"population": 10, "iterations": 2},
    }  # fmt: skip
    specification = CampaignSpecification.model_validate(document)
    queued = submission.submit(database, LIMITS, specification, None)
    with database.transaction() as connection:
        if begun:
            campaigns.set_resolution(connection, queued.sequence, resolve(specification).resolution())
        campaigns.request_action(connection, queued.id, "cancel")
    dispatcher(database, ComputedBackend()).step()
    changes = RerunSpecification.model_validate({"weights": weights})
    if expected is None:
        with pytest.raises(InvalidInputError, check=lambda error: error.problems[0].field == "robustness.eta"):
            submission.rerun(database, LIMITS, queued.id, changes, None)
    else:
        assert submission.rerun(database, LIMITS, queued.id, changes, None).spec["robustness"]["eta"] == expected


@pytest.mark.slow
@pytest.mark.usefixtures("strict")
def test_the_best_set_of_the_first_campaign_is_known_under_the_weights_of_its_rerun(database: Database) -> None:
    first = _run(database)
    again = _rerun(database, first, weights={"S2": 4}, optimizer={"iterations": 1, "population": 4})
    known = earlier_best(database, again, first)
    assert known is not None
    assert (known.campaign, known.weights["S2"], set(known.weights)) == (first.id, 4, set(resolved_spec(first).weights))
    weights = ",".join(f"{name}={weight:g}" for name, weight in known.weights.items())
    listed = ranking(database, first, resolved_spec(first), weights).solutions(0, 1)
    assert known.objective == listed[0].objective
    assert earlier_best(database, again, replace(first, pruned_at=now())) == replace(known, is_pruned=True)
    other = ComputedBackend(answer=strict_answer)
    rated = _rerun(database, first, other, evaluator="strict")
    assert earlier_best(database, rated, first) is None
    of_earlier_release = replace(rated, spec={name: value for name, value in rated.spec.items() if name != "problem"})
    assert earlier_best(database, of_earlier_release, first) is None
    assert earlier_best(database, replace(again, state=CampaignState.RUNNING), first) is None
