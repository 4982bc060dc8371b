"""Explanations, contradictions and accounts of whole campaigns, with a formula in the place of the simulation."""

from __future__ import annotations

from typing import Any

import pytest
from sqlalchemy import update
from tests.support.computed import IGNORED, ComputedBackend, computed
from tests.support.runs import EXPERT_SPACE, SMALL, dispatcher, get, nothing_matters, post_map, rows_of, run, step_until, submit
from tests.support.values import numbers

from drivecal.campaigns.results.explanation import explain
from drivecal.contracts.explanation import Explanation
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import campaigns
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
        found = _explain(database, row)
        assert (found.reason, found.campaign, found.score) == ("reused", campaign.id, row.score)
        assert found.reference is not None
        assert found.reference.evaluation == row.reference
        assert [one.parameter for one in found.differences] == [IGNORED[row.scenario]]
        assert {(one.region, one.blocks) for one in found.differences} == {("anywhere", False)}
        assert str(row.reference) in found.sentence
        assert "of no influence" in found.sentence
    repeated = next(row for row in rows if row.outcome is Outcome.REPEATED)
    again = _explain(database, repeated)
    assert (again.reason, again.differences, again.stored) == ("repeated", [], None)


def _blocks(scenario: str, one: dict[str, float], other: dict[str, float]) -> int:
    return sum(one[name] != other[name] for name in one if IGNORED.get(scenario) != name)


@pytest.mark.slow
def test_every_simulated_cell_names_the_nearest_set_that_the_campaign_saw(database: Database) -> None:
    used = post_map(database, TRUE_MAP)
    earlier = rows_of(database, run(database, submit(database, stored_map=used)))
    campaign = run(database, submit(database, stored_map=used, optimizer={"population": 16, "iterations": 4, "seed": 9}))
    run(database, submit(database, stored_map=used, optimizer={"population": 16, "iterations": 4, "seed": 5}))  # seen by nobody
    rows = rows_of(database, campaign)
    simulated = [row for row in rows if row.outcome is Outcome.SIMULATED and not row.audited]
    assert len(simulated) > 20
    stored = [row for row in earlier if row.outcome is Outcome.SIMULATED]
    for cell in simulated[:: len(simulated) // 20]:
        own = [
            row
            for row in rows
            if row.outcome is Outcome.SIMULATED and (row.iteration, row.individual) < (cell.iteration, cell.individual)
        ]
        visible = [row for row in stored + own if row.scenario == cell.scenario]
        found = _explain(database, cell)
        assert (found.reason, found.stored) == ("blocked", len(visible))
        expected = min(  # every blocking parameter differs by one or two halves of its range, 1
            visible,
            key=lambda row: (
                _blocks(cell.scenario, numbers(cell.parameters), numbers(row.parameters)),
                sum(
                    (numbers(cell.parameters)[name] - value) ** 2
                    for name, value in numbers(row.parameters).items()
                    if IGNORED.get(cell.scenario) != name
                ),
                row.campaign_sequence,
                row.iteration,
                row.individual,
            ),
        )
        assert found.reference is not None
        assert found.reference.evaluation == expected.id
        assert (
            sum(one.blocks for one in found.differences)
            == _blocks(cell.scenario, numbers(cell.parameters), numbers(expected.parameters))
            > 0
        )


def test_the_first_cell_of_all_finds_nothing_stored(database: Database) -> None:
    campaign = run(database, submit(database, stored_map=post_map(database, TRUE_MAP)))
    first = _explain(database, rows_of(database, campaign)[0])
    assert (first.reason, first.reference, first.stored) == ("nothing_stored", None, 0)


@pytest.mark.parametrize(
    ("changes", "with_map", "reason"),
    [
        ({"reduction": {"mode": "off"}}, True, "off"),
        ({"reduction": {"mode": "exact"}}, True, "exact_only"),
        ({}, False, "no_map"),
    ],
)
def test_where_the_campaign_allows_no_reuse_that_is_the_reason(
    database: Database, changes: dict[str, Any], with_map: bool, reason: str
) -> None:
    used = post_map(database, TRUE_MAP) if with_map else None
    campaign = run(database, submit(database, stored_map=used, **changes))
    cell = next(row for row in rows_of(database, campaign) if row.outcome is Outcome.SIMULATED and row.iteration == 1)
    assert _explain(database, cell).reason == reason


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["influence", "predicted"])
def test_a_baseline_is_simulated_as_a_given_set_where_others_are_reused(database: Database, mode: str) -> None:
    baseline = {f"P{number}": 0.5 for number in range(1, 12)}
    maps = {"stored_map": post_map(database, nothing_matters())} if mode == "influence" else {}
    run(database, submit(database, **maps))
    campaign = run(database, submit(database, baseline=baseline, reduction={"mode": mode, "certified": False}, **maps))
    given = [row for row in rows_of(database, campaign) if (row.iteration, row.individual) == (0, 0)]
    assert {(row.outcome, _explain(database, row).reason) for row in given} == {(Outcome.SIMULATED, "given")}


def test_audits_and_the_stop_by_an_earlier_release_are_explained(database: Database) -> None:
    reduction = {"audit": 0.5, "max_error": 0.02}
    campaign = submit(database, stored_map=post_map(database, nothing_matters()), reduction=reduction)
    step_until(database, campaign, 1, dispatcher(database))
    rates = {name: rate.model_copy(update={"stopped": True}) for name, rate in get(database, campaign).error_rate.items()}
    with database.transaction() as connection:
        stopped = {name: rate.model_dump(mode="json") for name, rate in rates.items()}
        connection.execute(update(campaigns).where(campaigns.c.sequence == campaign.sequence).values(error_rate=stopped))
    campaign = run(database, campaign)
    rows = {row.id: row for row in rows_of(database, campaign)}
    verdicts = set()
    for row in (row for row in rows.values() if row.audited):
        found = _explain(database, row)
        assert found.audit is not None
        donor = rows[row.reference or 0]
        assert (found.audit.score, found.audit.reference_score) == (row.score, donor.score)
        assert found.audit.agrees == (row.score == donor.score) == row.agrees
        assert found.audit.wrong == (abs((row.score or 0) - (donor.score or 0)) > 1)
        verdicts.add((found.audit.agrees, found.audit.wrong))
    assert verdicts == {(True, False), (False, False), (False, True)}
    late = [row for row in rows.values() if row.iteration == 2 and row.outcome is not Outcome.REPEATED]
    found = _explain(database, late[0])
    assert found.reason == "stopped"
    assert "audited cells were wrong" in found.sentence
    assert all(row.outcome is not Outcome.REUSED for row in late)
    assert all(rate.stopped for rate in campaign.error_rate.values())


def test_a_cell_whose_leader_has_no_result_says_so(database: Database) -> None:
    def fragile(scenario: str, cell: Cell) -> CellResult:
        if scenario == "S1" and cell.parameters["P9"] < 0.4:
            return CellResult(cell.id, None, None, {}, None, 1.0, "crash", "segmentation fault")
        return computed(scenario, cell)

    space = [EXPERT_SPACE[1], {**EXPERT_SPACE[8], "step": 0.1}]
    rest = {one["name"]: 0.5 for one in EXPERT_SPACE if one["name"] not in {"P2", "P9"}}
    changes: dict[str, Any] = {"parameters": space, "fixed": rest, "reduction": {"audit": 0.0}}
    campaign = run(
        database, submit(database, stored_map=post_map(database, TRUE_MAP), **changes), ComputedBackend(answer=fragile)
    )
    reasons = {_explain(database, row).reason for row in rows_of(database, campaign) if row.scenario == "S1"}
    assert "unanswered" in reasons
    for row in rows_of(database, campaign):
        if row.outcome is Outcome.FAILED:
            found = _explain(database, row)
            without = "Repeated without a result" if found.reason == "repeated" else "Sent to be simulated, without a result"
            assert found.sentence.startswith(without)


def test_contradictions_of_a_wrong_map_are_counted_and_those_of_a_true_one_are_none(database: Database) -> None:
    wrong = run(database, submit(database, stored_map=post_map(database, nothing_matters()), reduction={"audit": 0.5}))
    assert {name: rate.contradictions for name, rate in wrong.error_rate.items()} == {"S1": 1, "S2": 1, "S3": 1}, "one key each"
    other = {"reduction": {"audit": 0.5}, "optimizer": SMALL["optimizer"] | {"seed": 4}}
    true = run(database, submit(database, stored_map=post_map(database, TRUE_MAP), **other))
    assert [rate.contradictions for rate in true.error_rate.values()] == [0, 0, 0]
    assert any(rate.audited for rate in true.error_rate.values())


@pytest.mark.slow
def test_cells_of_an_analysis_and_those_it_answers_are_explained(database: Database) -> None:
    analysis = {"intervals": 2, "samples": 4}
    coarse = [{**one, "step": 0.1} for one in EXPERT_SPACE[:3]]
    fixed = {one["name"]: 0.5 for one in EXPERT_SPACE[3:]}
    campaign = run(database, submit(database, sensitivity=analysis, parameters=coarse, fixed=fixed))
    rows = rows_of(database, campaign)
    for row in rows:
        found = _explain(database, row)
        assert found.sentence.endswith((".", "]"))
        if row.stage is StageName.SENSITIVITY:
            assert found.reason in {"analysis", "repeated"}
