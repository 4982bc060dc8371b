"""Stored runs of earlier versions of a problem answer its campaigns if the manifest says what they mean."""

from typing import Any

import pytest
from tests.support.computed import ComputedBackend
from tests.support.problems import LIMITS, scored, store, submit_checked
from tests.support.runs import dispatcher, finish, rows_of
from tests.support.values import faulty_fields, present

from drivecal.api import submission
from drivecal.api.expectation import expected
from drivecal.campaigns.results.explanation import explain
from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification, RerunSpecification
from drivecal.contracts.work import Cell, CellResult, SetupRequest
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.evaluations import Outcome
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance.consistency import CHECKS

BEFORE: dict[str, Any] = {"x": {"lower": 0, "upper": 1, "step": 0.01}, "n": {"lower": 1, "upper": 4, "integer": True}}
JERK: dict[str, Any] = {"jerk_max": {"lower": 5, "upper": 25, "step": 1}}
GAIN: dict[str, Any] = {"gain": {"curve": {"axis": [0, 5, 10]}, "lower": 0, "upper": 3, "step": 0.1}}
SPEC: dict[str, Any] = {"problem": "acc", "optimizer": {"kind": "random", "population": 10, "seed": 1, "iterations": 4}}


def driven(setup: SetupRequest, cell: Cell) -> CellResult:
    """Without jerk_max it is 20, without n it is 2; `m` is another name of n."""
    p = {"jerk_max": 20.0, "n": 2.0} | {"n" if name == "m" else name: float(value) for name, value in cell.parameters.items()}
    cost = (p["x"] - 0.4) ** 2 + 0.1 * p["n"] + abs(p["jerk_max"] - 15) / 100 + 0.1 * (setup.scenario == "road")
    return CellResult(cell.id, None, None, {"y": cost}, None, 7.0)


def push(database: Database, parameters: dict[str, Any], model: str = "", **claims: Any) -> None:
    store(database, scored("acc", parameters) | claims, {"model.py": model})


def carried_out(database: Database, **changes: Any) -> StoredCampaign:
    return finish(database, submit_checked(database, SPEC | changes), dispatcher(database, ComputedBackend(driven=driven)))


def evaluated(database: Database, parameters: dict[str, Any], **changes: Any) -> StoredCampaign:
    specification = EvaluationSpecification.model_validate({"problem": "acc", "parameters": parameters} | changes)
    single = submission.evaluate(database, LIMITS, specification, None)
    return finish(database, single, dispatcher(database, ComputedBackend(driven=driven)))


def foretold(database: Database, **changes: Any) -> list[str]:
    return expected(database, LIMITS, CampaignSpecification.model_validate(SPEC | changes)).notes


@pytest.fixture
def database(database: Database) -> Database:
    """The problem's earlier version is pushed."""
    push(database, BEFORE)
    return database


@pytest.mark.slow("renamed", "curve")
@pytest.mark.parametrize(
    ("parameters", "claims", "fixed"),
    [
        (BEFORE | JERK, {"added": {"jerk_max": 20}}, {"jerk_max": 20}),
        (BEFORE | GAIN, {"added": {"gain": [1, 1, 1]}}, {"gain": [1, 1, 1]}),
        ({"x": BEFORE["x"], "m": BEFORE["n"]}, {"renamed": {"m": "n"}}, {}),
    ],
    ids=["number", "curve", "renamed"],
)
def test_the_same_search_is_answered_by_runs_of_the_earlier_version(
    database: Database, parameters: dict[str, Any], claims: dict[str, Any], fixed: dict[str, Any]
) -> None:
    earlier = carried_out(database)
    push(database, parameters, **claims)
    told = foretold(database, fixed=fixed)
    ended = carried_out(database, fixed=fixed)
    assert ended.state is CampaignState.SUCCEEDED, ended.error
    assert ended.cells.requested == ended.cells.repeated == earlier.cells.requested
    checked = ended.counts(StageName.CLAIMS)
    assert 5 <= checked.runs == checked.simulated <= 20
    assert [f" {checked.runs} " in note for note in told if "claims" in note] == [True]
    assert present(ended.best).objective == present(earlier.best).objective
    assert carried_out(database, fixed=fixed).counts(StageName.CLAIMS).runs == 0, "the sample is stored by now"
    rows = [row for row in rows_of(database, ended) if row.stage is StageName.CALIBRATION]
    with database.read() as connection:
        explained = [explain(connection, row.id).reference for row in rows]
        assert [list(check(connection)) for check in CHECKS.values()] == [[] for _ in CHECKS]
    of_earlier = [reference for reference in explained if reference is not None and reference.campaign == earlier.id]
    assert len(of_earlier) >= len(rows) - checked.simulated
    assert all(reference.claimed for reference in of_earlier)


def test_runs_with_the_value_of_a_removed_parameter_answer(database: Database) -> None:
    earlier = carried_out(database, fixed={"n": 2})
    push(database, {"x": BEFORE["x"]}, removed={"n": 2})
    ended = carried_out(database)
    assert ended.cells.requested == ended.cells.repeated == earlier.cells.requested


def test_a_search_by_the_cell_begins_with_runs_of_the_earlier_version(database: Database) -> None:
    earlier = carried_out(database)
    push(database, BEFORE | JERK, added={"jerk_max": 20})
    ended = carried_out(database, optimizer={"kind": "surrogate", "seed": 1}, budget={"simulations": 20})
    first = rows_of(database, ended)
    asked = [row for row in first if row.stage is StageName.CALIBRATION and row.outcome is Outcome.REPEATED]
    assert present(earlier.best).parameters | {"jerk_max": 20.0} in [row.parameters.floats for row in asked]


@pytest.mark.parametrize("value", [19, 20])
def test_a_wrong_claim_ends_campaigns_and_evaluations_and_is_named(database: Database, value: float) -> None:
    earlier, is_wrong = carried_out(database), value == 19
    stored = [row.parameters.floats | {"jerk_max": value} for row in rows_of(database, earlier)]
    push(database, BEFORE | JERK, added={"jerk_max": value})
    before, ended, after = (
        evaluated(database, stored[0]), carried_out(database, fixed={"jerk_max": value}), evaluated(database, stored[-1])
    )  # fmt: skip
    for each in (before, ended, after):
        assert (each.state is CampaignState.FAILED) == is_wrong
        assert [text in (each.error or "") for text in ("added.jerk_max", earlier.id)] == [is_wrong] * 2
    assert ended.cells.requested == (0 if is_wrong else ended.cells.repeated)
    assert before.cells.simulated == 2, "a sample would take more runs"
    assert after.cells.repeated == (0 if is_wrong else 2)
    assert evaluated(database, stored[-1], fresh=True).state is CampaignState.SUCCEEDED, "claims say nothing about new runs"
    push(database, BEFORE | JERK | {"k": {"lower": 0, "upper": 9}}, added={"jerk_max": value, "k": 3})
    assert (evaluated(database, stored[-1] | {"k": 3}).state is CampaignState.FAILED) == is_wrong, "after one more parameter"
    with database.read() as connection:
        assert [list(check(connection)) for check in CHECKS.values()] == [[] for _ in CHECKS]


@pytest.mark.slow
def test_nothing_is_claimed_without_a_claim_about_each_difference(database: Database) -> None:
    carried_out(database)
    push(database, BEFORE | JERK | {"k": {"lower": 0, "upper": 9}}, added={"jerk_max": 20})
    fixed: dict[str, Any] = {"jerk_max": 20, "k": 3}
    ended = carried_out(database, fixed=fixed)
    assert ended.cells.simulated == len({(row.scenario, row.parameters) for row in rows_of(database, ended)})
    assert any("parameters.k" in note for note in ended.notes)


def test_a_change_of_files_alone_is_named_before_and_by_a_campaign(database: Database) -> None:
    push(database, BEFORE, "changed")
    for notes in (foretold(database), carried_out(database).notes):
        assert any("model.py" in note for note in notes)


def test_a_rerun_on_other_curves_takes_lists_anew_and_refuses_coefficients(database: Database) -> None:
    few: dict[str, Any] = {"lower": 0, "upper": 3, "coefficients": 3}
    push(database, BEFORE | {"gain": few | {"curve": {"axis": [0, 5, 10, 20]}}})
    fixed, line = {"x": 0, "n": 1}, [0, 0.75, 1.5, 3]
    listed = carried_out(database, baseline=fixed | {"gain": line})
    single = carried_out(database, baseline=fixed | {"gain_1": 0, "gain_2": 1, "gain_3": 3})
    push(database, BEFORE | {"gain": few | {"curve": {"axis": [0, 1, 5, 20]}}})
    changes = RerunSpecification(weights={}, problem="acc")
    rerun = submission.rerun(database, LIMITS, listed.id, changes, None)
    again = finish(database, rerun, dispatcher(database, ComputedBackend(driven=driven)))
    assert present(again.baseline).parameters != present(listed.baseline).parameters
    assert faulty_fields(submission.rerun, database, LIMITS, single.id, changes, None) == ["problem"]
    with pytest.raises(InvalidInputError) as refused:
        foretold(database, constraints=[{"changes": f"{listed.id}#1", "at_most": 2}])
    assert [problem.field for problem in refused.value.problems] == ["constraints[0].changes"]
