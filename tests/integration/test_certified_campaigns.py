"""Certificates in whole campaigns: counted apart, checked, and without any influence on what is found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import Connection
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.runs import SMALL, WITH_ANALYSIS, finish, get, influenced, nothing_matters, post_map, run, step_until, submit
from tests.support.runs import dispatcher as dispatching

from drivecal.analysis.solutions import Ranking
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.results.explanation import explain
from drivecal.campaigns.results.verification import verify
from drivecal.campaigns.stages.population import PopulationAnswers
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.evaluations import Outcome
from drivecal.storage import audits, evaluations, generations, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import runs
from drivecal.storage.references.withdrawal import WITHDRAWN, withdraw_certified


def alike(scenario: str, cell: Cell) -> object:
    """What `influenced` looks at."""
    p = cell.parameters
    return (p["P1"], min(p["P2"], 0.5)) if scenario == "S1" else max(p["P3"] - 0.4, 0)


def certifying(**fields: Any) -> ComputedBackend:
    return ComputedBackend(answer=influenced, class_of=alike, **fields)


def found(database: Database, campaign: StoredCampaign) -> list[tuple[object, ...]]:
    with database.read() as connection:
        rows = list(results.stream(connection, campaign.sequence))
    return [
        (row.stage, row.iteration, row.individual, row.scenario, row.score, row.rating, row.failure, row.audited)
        for row in rows
    ]


def simple(**changes: Any) -> dict[str, Any]:
    return {"catalogue": ["S1", "S2"], "reduction": {"mode": "exact", "audit": 0.0}} | changes


def test_cells_that_provably_repeat_a_run_are_certified_and_name_it(database: Database) -> None:
    ended = run(database, submit(database, **simple()), certifying())
    assert ended.cells.certified > ended.cells.simulated > 0
    assert ended.cells.requested == ended.cells.repeated + ended.cells.certified + ended.cells.simulated
    assert ended.cells.checked == 0
    with database.read() as connection:
        rows = {row.id: row for row in results.stream(connection, ended.sequence)}
        figures, _ = generations.page(connection, ended.sequence, limit=100)
    certified = [row for row in rows.values() if row.outcome is Outcome.CERTIFIED]
    assert len(certified) == ended.cells.certified == sum(one.certified for _, one in figures)
    for row in certified:
        proof = rows[row.reference or 0]
        assert proof.outcome is Outcome.SIMULATED
        assert (proof.scenario, proof.setup_id, proof.score, proof.rating) == (
            row.scenario,
            row.setup_id,
            row.score,
            row.rating,
        )
        assert row.parameter_set_id != proof.parameter_set_id


def test_what_certificates_take_is_no_part_of_the_price_and_is_summed_apart(database: Database) -> None:
    backend = certifying()

    def timed(scenario: str, cell: Cell) -> CellResult:
        return replace(influenced(scenario, cell), milliseconds=9.0, certifying=2.0 if cell.certify else 0.0)

    backend.answer = timed
    ended = run(database, submit(database, **simple()), backend)
    again = run(database, submit(database, **simple(reduction={"mode": "exact", "certified": False})), backend)
    with database.read() as connection:
        rows = evaluations.costs_by_outcome(connection, ended.sequence)
        copied = evaluations.costs_by_outcome(connection, again.sequence)
    simulated, certified = (
        [row for row in rows if row.outcome is outcome] for outcome in (Outcome.SIMULATED, Outcome.CERTIFIED)
    )
    assert simulated
    assert certified
    for row in simulated:
        assert row.runs == row.cells
        assert row.seconds == pytest.approx(0.009 * row.cells)
        assert row.run_seconds == pytest.approx(0.007 * row.cells)
        assert row.certifying_seconds == pytest.approx(0.002 * row.cells)
    for row in certified:
        assert (row.runs, row.run_seconds) == (0, 0.0)
        assert row.certifying_seconds == row.seconds == pytest.approx(0.009 * row.cells)
    assert {row.outcome for row in copied} == {Outcome.REPEATED}
    assert sum(row.runs for row in copied) == sum(row.runs for row in rows) < sum(row.cells for row in rows)
    for row in copied:
        assert row.run_seconds == pytest.approx(0.007 * row.runs)
        assert row.certifying_seconds == 0


def test_a_certified_cell_is_explained_by_the_run_that_it_repeats(database: Database) -> None:
    ended = run(database, submit(database, **simple()), certifying())
    with database.read() as connection:
        rows = list(results.stream(connection, ended.sequence))
        certified = next(row for row in rows if row.outcome is Outcome.CERTIFIED)
        explained = explain(connection, certified.id)
    assert explained.reason == "reused"
    assert explained.reference is not None
    assert explained.reference.evaluation == certified.reference
    assert {one.parameter for one in explained.differences} <= {f"P{i}" for i in range(1, 12)}
    assert f"evaluation {certified.reference}" in explained.sentence


def test_certified_results_are_references_like_simulated_ones(database: Database) -> None:
    first = run(database, submit(database, **simple()), certifying())
    with database.read() as connection:
        assert runs.largest_id(connection) >= first.cells.simulated + first.cells.certified
    second = run(database, submit(database, **simple()), certifying())
    assert second.cells.repeated == second.cells.requested
    assert [row[:-1] for row in found(database, second)] == [row[:-1] for row in found(database, first)]


@pytest.mark.slow("off-1", "influence-2", "influence-3", "exact-1")
@pytest.mark.parametrize(("mode", "seed"), [("off", 1), ("exact", 1), ("influence", 1), ("influence", 2), ("influence", 3)])
def test_no_result_changes_by_a_bit_when_certification_is_switched_on_or_off(tmp_path: Path, mode: str, seed: int) -> None:
    seen, certified_cells = [], []
    for certified in (True, False):
        database = migrated(f"sqlite:///{tmp_path / str(certified)}.db")
        scenarios = nothing_matters()
        scenarios["S1"]["P1"] = scenarios["S2"]["P3"] = {"influential": True}
        campaign = submit(
            database,
            stored_map=post_map(database, scenarios),
            catalogue=["S1", "S2"],
            optimizer=SMALL["optimizer"] | {"seed": seed},
            reduction={"mode": mode, "audit": 0.3, "certified": certified},
        )
        ended = run(database, campaign, certifying(seed=seed))
        with database.read() as connection:
            told = [
                (row.iteration, row.individual, row.scenario, row.score, row.rating, row.failure, row.audited, row.agrees)
                for row in results.stream(connection, ended.sequence)
            ]
        answered = ended.cells.repeated, ended.cells.reused, ended.cells.simulated + ended.cells.certified, ended.cells.audited
        seen.append((told, answered, ended.best, ended.error_rate))
        certified_cells.append(ended.cells.certified)
        database.dispose()
    assert seen[0] == seen[1]
    assert certified_cells[0] > 0
    assert certified_cells[1] == 0


def test_in_the_sensitivity_stage_most_runs_are_certified(database: Database) -> None:
    ended = run(database, submit(database, **WITH_ANALYSIS), certifying())
    cells = ended.counts(StageName.SENSITIVITY)
    assert cells.requested == cells.repeated + cells.certified + cells.simulated
    assert cells.certified > cells.simulated
    assert ended.influence_map_id is not None


def test_a_share_of_certified_cells_is_simulated_all_the_same_and_counted(database: Database) -> None:
    ended = run(database, submit(database, **simple(reduction={"mode": "exact", "audit": 0.3})), certifying())
    assert ended.cells.checked > 0
    assert 0.15 < ended.cells.checked / (ended.cells.checked + ended.cells.certified) < 0.45
    assert ended.state is CampaignState.SUCCEEDED
    assert [one for one in verify(database, full=True) if one.problems] == []


def test_one_certificate_that_a_simulation_contradicts_ends_the_campaign(database: Database) -> None:
    campaign = submit(database, **simple(reduction={"mode": "exact", "audit": 0.3}))
    ended = finish(database, campaign, dispatching(database, certifying(proofs_hold=False)))
    assert ended.state is CampaignState.FAILED
    assert "reduction.certified" in (ended.error or "")


def failed(database: Database, backend: ComputedBackend, **changes: Any) -> StoredCampaign:
    """Runs a campaign that a contradicted certificate ends."""
    campaign = submit(database, **simple(reduction={"mode": "exact", "audit": 0.05}, **changes))
    ended = finish(database, campaign, dispatching(database, backend))
    assert ended.state is CampaignState.FAILED
    return ended


@pytest.mark.slow("1", "2")
@pytest.mark.parametrize("seed", range(4))
def test_a_refuted_certificate_leaves_no_certified_answer_of_its_setup_among_the_references(
    database: Database, seed: int
) -> None:
    ended = failed(database, ComputedBackend(answer=influenced, class_of=lambda scenario, _: scenario, seed=seed))
    with database.read() as connection:
        rows = list(results.stream(connection, ended.sequence))
    refuted = {row.scenario for row in rows if row.proof_agrees is False}
    certified = [row for row in rows if row.outcome is Outcome.CERTIFIED and row.scenario in refuted]
    assert refuted
    assert all(row.run_id is None for row in certified)
    assert {row.detail for row in certified} <= {WITHDRAWN}
    assert [check for check in verify(database, full=True) if check.problems] == []


def test_a_campaign_after_a_refuted_certificate_finds_what_it_finds_on_a_new_database(
    database: Database, tmp_path: Path
) -> None:
    failed(database, ComputedBackend(answer=influenced, class_of=lambda scenario, _: scenario), catalogue=["S2"])
    changes = simple(catalogue=["S2"], reduction={"mode": "exact", "audit": 0.0, "certified": False})
    after = run(database, submit(database, **changes), ComputedBackend(answer=influenced))
    new = migrated(f"sqlite:///{tmp_path / 'new.db'}")
    truth = run(new, submit(new, **changes), ComputedBackend(answer=influenced))
    assert found(database, after) == found(new, truth)
    new.dispose()


def test_a_search_whose_certificates_another_campaign_contradicts_confirms_its_best_set(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    ranked = []

    def ranks(answers: PopulationAnswers, connection: Connection, number: int) -> Ranking:
        ranked.append(number)
        return rank_again(answers, connection, number)

    rank_again = PopulationAnswers.rank_again
    monkeypatch.setattr(PopulationAnswers, "rank_again", ranks)
    backend = certifying()
    campaign, working = submit(database, **simple()), dispatching(database, backend)
    step_until(database, campaign, 5, working)
    backend.class_of = None
    with database.transaction() as connection:
        stored = list(results.stream(connection, campaign.sequence))
        withdraw_certified(connection, {row.setup_id for row in stored})
    for _ in range(200):
        working.step()
        if get(database, campaign).state.ended:
            break
    ended = get(database, campaign)
    assert ended.state is CampaignState.SUCCEEDED
    assert ended.best is not None
    ranking = Ranking(resolved_spec(ended).weights)
    with database.read() as connection:
        ranking.add(results.answers(connection, campaign.sequence, StageName.CALIBRATION))
        assert results.withdrawn(connection, campaign.sequence) > 0
        added = [row for row in results.stream(connection, campaign.sequence) if row.iteration >= 6]
        reasons = [explain(connection, row.id).reason for row in added]
    best = ranking.best()
    assert best is not None
    assert best[0].reused == ()
    assert ended.confirmation is not None
    assert ended.confirmation.state == "confirmed"
    assert added
    assert ranked == [campaign.sequence], "once, however many rounds confirm"
    assert {row.outcome for row in added} == {Outcome.SIMULATED}
    assert set(reasons) == {"confirmation"}
    assert [check for check in verify(database, full=True) if check.problems] == []


@pytest.mark.slow("False")
@pytest.mark.parametrize("certified", [True, False])
def test_what_parallel_campaigns_count_as_simulated_a_worker_has_simulated(database: Database, *, certified: bool) -> None:
    both = [submit(database, **simple(reduction={"mode": "exact", "certified": each})) for each in (True, certified)]
    working = dispatching(database, certifying())
    while not all(get(database, each).state.ended for each in both):
        working.step()
    with database.read() as connection:
        rows = [row for each in both for row in results.stream(connection, each.sequence)]
    simulated = [row for row in rows if row.outcome is Outcome.SIMULATED]
    by_workers = {(row.setup_id, row.parameter_set_id) for row in simulated if row.worker is not None}
    assert {(row.setup_id, row.parameter_set_id) for row in simulated} == by_workers
    shared = {row.outcome for row in rows if row.worker is None}
    assert (Outcome.CERTIFIED in shared) == certified, "it names its proof, whichever campaign asked for it"
    assert all(row.reference is not None for row in rows if row.outcome is Outcome.CERTIFIED)
    assert [problem for check in verify(database, full=True) for problem in check.problems] == []


def test_who_does_not_want_certificates_gets_none(database: Database) -> None:
    ended = run(database, submit(database, **simple(reduction={"mode": "exact", "certified": False})), certifying())
    assert ended.cells.certified == ended.cells.checked == 0
    assert ended.cells.simulated > 0


@pytest.mark.slow("False")
@pytest.mark.parametrize("right", [True, False])
def test_certificates_say_of_reused_cells_whether_the_reference_was_right(database: Database, *, right: bool) -> None:
    scenarios = nothing_matters()
    scenarios["S1"] |= {"P1": {"influential": True}} | ({"P2": {"influential": True, "upper": 0.5}} if right else {})
    scenarios["S2"]["P3"] = {"influential": True}
    changes = {"catalogue": ["S1", "S2"], "reduction": {"mode": "influence", "audit": 0.4, "max_error": 0.9}}
    ended = run(database, submit(database, stored_map=post_map(database, scenarios), **changes), certifying())
    with database.read() as connection:
        found = {one.scenario: one for one in audits.proofs(connection, ended.sequence, resolved_spec(ended).evaluator)}
        rows = [row for row in results.stream(connection, ended.sequence) if row.outcome is Outcome.REUSED]
    assert 0 < sum(one.audited for one in found.values()) <= len(rows) == ended.cells.reused
    assert bool(found["S1"].different) is not right
    assert found["S2"].different == 0
