"""Explanations, contradictions and accounts of whole campaigns, with a formula in the place of the simulation."""

from types import SimpleNamespace
from typing import Any

import pytest
from tests.support.computed import IGNORED, ComputedBackend, computed
from tests.support.runs import EXPERT_SPACE, SMALL, influenced, nothing_matters, post_map, rows_of, run, submit

from drivecal.api.expectation import expected
from drivecal.campaigns.results.explanation import explain
from drivecal.configuration.settings import Settings
from drivecal.contracts.evaluation import Explanation
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.evaluations import Outcome
from drivecal.storage.engine.database import Database
from drivecal.storage.results import StoredEvaluation

TRUE_MAP = {scenario: {name: {"influential": False}} for scenario, name in IGNORED.items()}


def _explain(database: Database, cell: StoredEvaluation) -> Explanation:
    with database.read() as connection:
        return explain(connection, cell.id)


def test_every_reused_cell_is_explained_by_its_donor_and_what_differs(database: Database) -> None:
    campaign = run(database, submit(database, stored_map=post_map(database, TRUE_MAP)))
    rows = rows_of(database, campaign)
    reused = [row for row in rows if row.outcome is Outcome.REUSED]
    assert reused
    for row in reused:
        result = _explain(database, row)
        assert (result.reason, result.campaign, result.score) == ("reused", campaign.id, row.score)
        assert result.reference is not None
        assert result.reference.evaluation == row.reference
        assert [difference.parameter for difference in result.differences] == [IGNORED[row.scenario]]
        assert {(difference.region, difference.blocks) for difference in result.differences} == {("anywhere", False)}
    repeated = next(row for row in rows if row.outcome is Outcome.REPEATED)
    again = _explain(database, repeated)
    assert (again.reason, again.differences, again.stored) == ("repeated", [], None)


@pytest.mark.parametrize(
    ("changes", "with_map"), [({"reduction": {"mode": "off"}}, True), ({"reduction": {"mode": "exact"}}, True), ({}, False)]
)
def test_without_reuse_every_difference_blocks(database: Database, changes: dict[str, Any], with_map: bool) -> None:
    used = post_map(database, TRUE_MAP) if with_map else None
    small = {"optimizer": SMALL["optimizer"] | {"population": 8, "iterations": 2}}
    campaign = run(database, submit(database, stored_map=used, **small | changes))
    cell = next(row for row in rows_of(database, campaign) if row.outcome is Outcome.SIMULATED and row.iteration == 1)
    explanation = _explain(database, cell)
    assert explanation.reason == "simulated"
    assert all(difference.blocks for difference in explanation.differences)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["influence", "predicted"])
def test_a_baseline_is_simulated_as_a_given_set_where_others_are_reused(database: Database, mode: str) -> None:
    baseline = {f"P{number}": 0.5 for number in range(1, 12)}
    maps = {"stored_map": post_map(database, nothing_matters())} if mode == "influence" else {}
    run(database, submit(database, **maps))
    campaign = run(database, submit(database, baseline=baseline, reduction={"mode": mode}, **maps))
    given = [row for row in rows_of(database, campaign) if (row.iteration, row.individual) == (0, 0)]
    assert {(row.outcome, _explain(database, row).reason) for row in given} == {(Outcome.SIMULATED, "simulated")}


@pytest.mark.slow
def test_an_audit_is_explained_as_a_check_of_its_donor(database: Database) -> None:
    reduction = {"audit": 0.5, "max_error": 0.02}
    campaign = run(database, submit(database, stored_map=post_map(database, nothing_matters()), reduction=reduction))
    rows = {row.id: row for row in rows_of(database, campaign)}
    verdicts = set()
    for row in (row for row in rows.values() if (row.purpose == "audit")):
        explanation = _explain(database, row)
        assert (explanation.reason, explanation.reference is not None) == ("checked", True)
        assert explanation.check is not None
        donor = rows[row.reference or 0]
        assert (explanation.score, explanation.check.expected) == (row.score, donor.score)
        assert explanation.check.agrees == (row.score == donor.score) == row.agrees
        assert explanation.check.wrong == (abs((row.score or 0) - (donor.score or 0)) > 1)
        verdicts.add((explanation.check.agrees, explanation.check.wrong))
    assert verdicts == {(True, False), (False, False), (False, True)}


@pytest.mark.slow
def test_a_cell_without_a_result_is_explained_as_failed(database: Database) -> None:
    def fragile(scenario: str, cell: Cell) -> CellResult:
        if scenario == "S1" and cell.parameters["P9"] < 0.4:
            return CellResult(cell.id, None, None, {}, None, 1.0, "crash", "segmentation fault")
        return computed(scenario, cell)

    space = [EXPERT_SPACE[1], {**EXPERT_SPACE[8], "step": 0.1}]
    rest = {parameter["name"]: 0.5 for parameter in EXPERT_SPACE if parameter["name"] not in {"P2", "P9"}}
    changes: dict[str, Any] = {"parameters": space, "fixed": rest, "reduction": {"audit": 0.0}}
    ended = run(database, submit(database, stored_map=post_map(database, TRUE_MAP), **changes), ComputedBackend(answer=fragile))
    reasons = {(row.outcome is Outcome.FAILED, _explain(database, row).reason) for row in rows_of(database, ended)}
    assert (True, "failed") in reasons
    assert {reason for failed, reason in reasons if failed} == {"failed"}


def test_contradictions_of_a_wrong_map_are_counted_and_those_of_a_true_one_are_none(database: Database) -> None:
    wrong = run(database, submit(database, stored_map=post_map(database, nothing_matters()), reduction={"audit": 0.5}))
    assert {name: rate.contradictions for name, rate in wrong.error_rate.items()} == {"S1": 1, "S2": 1, "S3": 1}, "one key each"
    other = {"reduction": {"audit": 0.5}, "optimizer": SMALL["optimizer"] | {"seed": 4}}
    true = run(database, submit(database, stored_map=post_map(database, TRUE_MAP), **other))
    assert [rate.contradictions for rate in true.error_rate.values()] == [0, 0, 0]
    assert any(rate.audited for rate in true.error_rate.values())


def test_the_preview_of_a_campaign_warns_as_well(database: Database) -> None:
    stored = post_map(database, nothing_matters())
    validation = {"samples": 20, "references": 3, "largest": 20}
    study = submit(database, stored_map=stored, catalogue=["S1", "S3"], optimizer=None, validation=validation)
    run(database, study, ComputedBackend(answer=influenced))
    document = {**study.spec, "optimizer": {"kind": "random"}, "validation": None}
    assert document["sensitivity"] == {"map": stored}
    limits: Any = SimpleNamespace(settings=Settings(largest_campaign=10**9))
    warned = [{"mode": "influence"}, {"mode": "both", "max_error": 1}]
    for reduction in warned:
        notes = expected(database, limits, CampaignSpecification.model_validate(document | {"reduction": reduction})).notes
        assert any(study.id in note for note in notes)
    predicted = CampaignSpecification.model_validate(document | {"reduction": {"mode": "predicted"}})
    assert not any(study.id in note for note in expected(database, limits, predicted).notes)
