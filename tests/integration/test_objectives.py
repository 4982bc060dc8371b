"""Campaigns with several objectives and constraints: searched, predicted and confirmed by a dispatcher."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest
from tests.support.computed import ComputedBackend, rating_of
from tests.support.runs import get, nothing_matters, post_map, rows_of, run, study_of, submit
from tests.support.several import SEARCH, SEVERAL, installed
from tests.support.values import present

from drivecal.analysis.solutions import Ranking
from drivecal.api.tables.front import front_table
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.results.front import StoredRanking, answers_of, front_of
from drivecal.contracts.work import Cell, CellResult
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets

JERK = "peak_lateral_jerk_mps3"
TWO = [{"score": "comfort"}, {"measure": JERK, "direction": "minimise", "aggregate": "max", "failed": 20.0}]
SPLIT = [{"score": "comfort", "name": name, "scenarios": [name]} for name in ("S1", "S2")]


@pytest.fixture(autouse=True)
def _several() -> Iterator[None]:
    with installed():
        yield


def measured(scenario: str, cell: Cell) -> CellResult:
    """Comfort, and a jerk that grows with P1 and falls with P2; failures below a rating of 0.7."""
    rating = rating_of(scenario, cell)
    failure = "collision" if rating < 0.7 else None
    jerk = 5.0 + 3.0 * cell.parameters["P1"] - 4.0 * cell.parameters["P2"] + 0.3 * rating
    return CellResult(cell.id, rating, 0 if failure else round(rating), {JERK: jerk}, failure, 7.0)


def amounts(parameters: Mapping[str, Any], weights: Mapping[str, float]) -> tuple[float, float]:
    """Mean comfort and largest jerk of a set."""
    given = {name: measured(name, Cell(0, parameters)) for name in weights}
    jerks = [20.0 if answer.failure else answer.metrics[JERK] for answer in given.values()]
    return sum(weight * (given[name].score or 0) for name, weight in weights.items()), max(jerks)


def backend() -> ComputedBackend:
    return ComputedBackend(answer=measured)


def ranking_of(database: Database, campaign: StoredCampaign) -> Ranking:
    """The ranking by stored rows alone."""
    return StoredRanking(database, campaign, resolved_spec(get(database, campaign)), watermark=0).sets


def test_a_score_and_a_measure_are_searched_together(database: Database) -> None:
    ended = run(database, submit(database, objectives=TWO, optimizer=SEARCH, reduction={"mode": "exact"}), backend())
    front = [each.solution.judgement.amounts for each in ranking_of(database, ended).front()]
    assert len(front) > 2
    assert front == sorted(front, key=lambda each: -each[0])
    assert [each[1] for each in front] == sorted((each[1] for each in front), reverse=True)
    assert present(ended.best).objective == pytest.approx(front[0][0])
    asked = {(row.iteration, row.individual): row.parameters for row in rows_of(database, ended)}
    resolved = resolved_spec(ended)
    bare = SEVERAL.create(SEVERAL.settings.model_validate(SEARCH), resolved.space.n_values)
    for iteration in range(SEARCH["iterations"]):
        sets = resolved.space.parameter_sets(bare.ask().population)
        assert sets == [asked[iteration, individual] for individual in range(len(sets))], "the optimizer was told otherwise"
        told = [amounts(each.floats, resolved.weights) for each in sets]
        bare.tell(np.array(told) * (1, -1), np.zeros(len(sets)))
        for comfort, jerk in told:
            assert any(each[0] >= comfort - 1e-9 and each[1] <= jerk + 1e-9 for each in front), "a set beyond the front"


def test_one_score_in_several_scenarios_is_answered_by_references_and_confirmed(database: Database) -> None:
    stored_map = post_map(database, nothing_matters())
    spec: dict[str, Any] = {"objectives": SPLIT, "optimizer": SEARCH, "reduction": {"mode": "influence", "confirm": 500}}
    ended = run(database, submit(database, stored_map=stored_map, **spec), backend())
    assert ended.cells.reused > 0
    assert present(ended.confirmation).state == "confirmed"
    front = ranking_of(database, ended).front()
    assert not any(member.solution.reused for member in front)
    answers = answers_of(StoredRanking.of(database, ended), [member.solution for member in front])
    assert "confirmed" in {answer for each in answers.values() for answer in each.values()}
    best = present(ranking_of(database, ended).best())
    assert best[0].reused == ()
    assert present(ended.best).objective == best[0].objective


@pytest.mark.slow
def test_the_robustness_of_every_set_of_the_front_is_examined(database: Database) -> None:
    robust = {"delta": 0.05, "steps": 2, "samples": 3, "solutions": 1000}
    spec: dict[str, Any] = {"objectives": TWO, "optimizer": SEARCH, "reduction": {"mode": "exact"}, "robustness": robust}
    ended = run(database, submit(database, **spec), backend())
    front = {member.solution.parameter_set for member in ranking_of(database, ended).front()}
    with database.read() as connection:
        sets = parameter_sets.load(connection, sorted(front))
    examined = [item["parameters"] for item in study_of(database, ended)["items"]]
    assert len(examined) == len(front) > 1
    assert all(each.floats in examined for each in sets.values())
    rows = front_table(front_of(StoredRanking.of(database, ended)))
    assert [row.degree for row in rows].count(None) == 0


def test_sets_that_share_the_best_objective_and_keep_the_constraints_are_examined(database: Database) -> None:
    spec: dict[str, Any] = {
        "constraints": [{"measure": JERK, "at_most": 7.0, "failed": 20.0}],
        "optimizer": SEARCH,
        "reduction": {"mode": "exact"},
        "robustness": {"delta": 0.05, "steps": 1, "samples": 2, "solutions": 1000},
    }
    ended = run(database, submit(database, **spec), backend())
    listed = ranking_of(database, ended).best_first()
    good = [each for each in listed if each.violation == 0 and each.objective >= listed[0].objective - 1e-9]
    with database.read() as connection:
        sets = parameter_sets.load(connection, [each.parameter_set for each in good])
    assert 1 <= len(good) < len(listed)
    examined = {tuple(item["parameters"].values()): item["objective"] for item in study_of(database, ended)["items"]}
    expected = {tuple(sets[each.parameter_set].floats.values()): pytest.approx(each.objective) for each in good}
    assert examined == expected


def test_the_recommended_set_has_the_best_objective_and_keeps_the_constraints(database: Database) -> None:
    """Not the best mean score: the objective is the worst scenario's, and a named set breaks the constraint."""
    named = {f"P{number}": 0.5 for number in range(1, 12)} | {"P1": 1.0, "P2": 0.0}
    spec: dict[str, Any] = {
        "objectives": [{"score": "comfort", "aggregate": "min"}],
        "constraints": [{"measure": JERK, "at_most": 7.0, "failed": 20.0}],
        "optimizer": SEARCH,
        "reduction": {"mode": "exact"},
        "robustness": {"delta": 0.05, "steps": 1, "samples": 2, "sets": [named]},
    }
    ended = run(database, submit(database, **spec), backend())
    items = study_of(database, ended)["items"]
    [recommended] = [item for item in items if item["recommended"]]
    assert recommended["objective"] == min(recommended["scores"].values()) == present(ended.best).objective
    assert recommended["parameters"] != named
    assert all(item["objective"] == min(item["scores"].values()) for item in items)
    [also] = [item for item in items if item["parameters"] == named]
    assert not also["recommended"]
