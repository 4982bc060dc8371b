"""The smallest change that reaches the limits: objectives and constraints that compare with a set."""

from typing import Any

import numpy as np
import pytest
from tests.support.computed import ComputedBackend
from tests.support.problems import scored, store, submit_checked
from tests.support.runs import rows_of, run
from tests.support.values import present

from drivecal.api.tables.front import bound_text
from drivecal.api.tables.ranking import solution_pages
from drivecal.campaigns.results.front import StoredRanking, front_of
from drivecal.contracts.input_errors import validated
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Cell, CellResult, SetupRequest
from drivecal.domain.errors import InvalidInputError
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

BASELINE = {f"p{number}": 0.5 for number in range(1, 7)} | {"mode": "eco"}
GAINS = {f"p{number}": {"lower": 0, "upper": 1} for number in range(1, 7)}
MANIFEST = scored("gains", GAINS | {"mode": {"choices": ["eco", "sport"]}}, baseline=BASELINE)
SPEC: dict[str, Any] = {
    "problem": "gains",
    "objectives": [{"changes": "baseline"}],
    "constraints": [{"score": "cost", "at_most": 1}],
    "optimizer": {"kind": "surrogate", "seed": 1},
    "budget": {"simulations": 120},
}


def driven(setup: SetupRequest, cell: Cell) -> CellResult:
    """p1 and p2 matter most: both together reach a cost of 1, neither does alone. All the others help a little."""
    p = {name: float(value) for name, value in cell.parameters.items() if name != "mode"}
    cost = 2 * abs(p["p1"] - 0.9) + 2 * abs(p["p2"] - 0.1) + 0.1 * sum(abs(p[f"p{number}"] - 0.7) for number in range(3, 7))
    return CellResult(cell.id, None, None, {"y": cost + 0.5 + 0.05 * (setup.scenario == "road")}, None, 7.0)


@pytest.fixture
def database(database: Database) -> Database:
    store(database, MANIFEST)
    return database


def carried_out(database: Database, **changes: Any) -> StoredCampaign:
    return run(database, submit_checked(database, SPEC | changes), ComputedBackend(driven=driven))


@pytest.mark.slow
def test_the_smallest_change_that_reaches_a_limit_is_found(database: Database) -> None:
    best = present(carried_out(database, budget={"simulations": 60}).best)
    changed = [name for name, value in BASELINE.items() if best.parameters[name] != value]
    assert (best.violation, changed, best.objective) == (0, ["p1", "p2"], 2)


@pytest.mark.slow
def test_no_set_beyond_limits_of_change_is_simulated(database: Database) -> None:
    limits = [{"changes": "baseline", "at_most": 3}, {"distance": "baseline", "norm": "sum", "at_most": 0.5}]
    ended = carried_out(database, objectives=[{"score": "cost"}], constraints=limits, budget={"simulations": 34})
    assert present(ended.best).objective < present(present(ended.baseline).objective) - 0.2
    for row in rows_of(database, ended):
        values = row.parameters.floats
        shares = np.array([abs(float(values[name]) - 0.5) for name in BASELINE if name != "mode"] + [values["mode"] != "eco"])
        assert np.count_nonzero(shares) <= 3
        assert shares.sum() <= 0.5 + 1e-9


def test_the_second_objective_is_the_distance_from_a_set_of_another_campaign(database: Database) -> None:
    small = {"constraints": [], "budget": {"simulations": 20}}
    first = carried_out(database, objectives=[{"score": "cost"}], **small)
    ended = carried_out(database, objectives=[{"score": "cost"}, {"distance": f"{first.id}#1"}], **small)
    assert ended.spec["objectives"][1]["distance"] == present(first.best).parameters
    front = front_of(StoredRanking.of(database, ended))
    with pytest.raises(InvalidInputError):
        carried_out(database, objectives=[{"score": "cost"}, {"distance": f"{first.id}#best"}], **small)
    assert 0.0 in [each.solution.judgement.amounts[1] for each in front.members], "the set itself, whose cells are stored"


def test_a_search_goes_on_while_its_front_or_a_violation_gets_better(database: Database) -> None:
    for goals in (
        {"objectives": [{"changes": "baseline"}, {"score": "cost"}], "constraints": []},
        {"constraints": [{"score": "cost", "at_most": 0.0001}]},
    ):
        ended = carried_out(database, **goals, budget={"simulations": 60, "stagnation": 12}, reduction={"isolated": True})
        assert present(ended.search).better_at > 10, "the first objective is best in the first set, the baseline"


def test_a_limit_next_to_nothing_is_broken_by_a_finite_amount(database: Database) -> None:
    best = present(carried_out(database, constraints=[{"measure": "y", "at_most": 5e-324}], budget={"simulations": 12}).best)
    assert 0 < best.violation < np.inf


def test_sets_are_ranked_under_other_weights_by_the_scenarios_that_have_one(database: Database) -> None:
    limits = [{"changes": "baseline", "at_most": 3}]
    goals = {"objectives": [{"score": "cost"}], "constraints": limits, "weights": {"road": 9}}
    ended = carried_out(database, **goals, budget={"simulations": 40})
    driven = {
        name: {row.parameters.key for row in rows_of(database, ended) if row.scenario == name} for name in ("city", "road")
    }
    assert driven["road"] - driven["city"], "sets were given up in between"
    whole = StoredRanking.of(database, ended)
    assert len(solution_pages(whole, "city=0,road=1")) == len(driven["road"])
    assert list(map(bound_text, whole.resolved.goals.bounds)) == ["changes <= 3"]


@pytest.mark.parametrize(
    ("goal", "field"),
    [
        ({"changes": "baseline", "at_most": -1}, "constraints[0]"),
        ({"changes": "baseline", "direction": "maximise"}, "objectives[0]"),
        ({"changes": {"p1": 0.5}}, "objectives[0].changes"),
        ({"distance": "f" * 32}, "objectives[0].distance"),
        ({"score": "cost", "changes": "baseline"}, "objectives[0]"),
    ],
)
def test_a_wrong_comparison_is_refused_by_its_field(database: Database, goal: dict[str, Any], field: str) -> None:
    goals = {field.partition("[")[0]: [goal]}
    with pytest.raises(InvalidInputError) as refused:
        submit_checked(database, validated(CampaignSpecification, SPEC | goals).model_dump())
    assert any(problem.field.startswith(field) for problem in refused.value.problems)
