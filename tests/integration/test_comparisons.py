"""Comparisons through database and dispatcher, with formulas in the place of the simulation."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import update
from tests.support.comparisons import runs_of, submit_comparison
from tests.support.computed import ComputedBackend, computed
from tests.support.databases import migrated
from tests.support.runs import dispatcher, everything, finish, get, nothing_matters, post_map, run, submit

from drivecal.campaigns.comparisons.resolve import CONFIRMED
from drivecal.campaigns.comparisons.results import compared as read_compared
from drivecal.campaigns.results.verification import verify
from drivecal.campaigns.stages.campaign import StagedCampaign
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import CampaignState
from drivecal.execution.scheduling.dispatches import Completed
from drivecal.execution.scheduling.in_flight import Work
from drivecal.storage import campaigns, generations, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine import tables
from drivecal.storage.engine.database import Database


def cells_of(database: Database, one: StoredCampaign, iteration: int = 0) -> list[tuple[Any, ...]]:
    """What a run asked for in an iteration."""
    with database.read() as connection:
        return [
            (row.scenario, *row.parameters.floats.values())
            for row in results.stream(connection, one.sequence)
            if row.iteration == iteration
        ]


def found_by(database: Database, comparison: StoredCampaign) -> list[tuple[Any, ...]]:
    """All that the runs of a comparison found, and the comparison itself."""
    ended = get(database, comparison)
    own = ended.state, ended.cells, ended.best, ended.progress.done
    return [own, *((one.name, everything(database, one)) for one in runs_of(database, comparison))]


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Database, StoredCampaign, ComputedBackend]]:
    """A comparison on an empty database, carried out to its end."""
    opened = migrated(f"sqlite:///{tmp_path_factory.mktemp('compared') / 'drivecal.db'}")
    backend = ComputedBackend()
    yield opened, run(opened, submit_comparison(opened), backend), backend
    opened.dispose()


@pytest.mark.slow
def test_every_optimizer_population_and_seed_is_a_run(compared: tuple[Database, StoredCampaign, ComputedBackend]) -> None:
    database, comparison, _ = compared
    runs = runs_of(database, comparison)
    assert comparison.state is CampaignState.SUCCEEDED
    assert len(runs) == 2 * 2 * 3
    assert [one for one in verify(database, full=True) if one.problems] == []
    assert {one.state for one in runs} == {CampaignState.SUCCEEDED}
    assert [one.name for one in runs[:4]] == [
        *(f"genetic, population 6, seed {seed}" for seed in (1, 2, 3)),
        "genetic, population 9, seed 1",
    ]
    assert comparison.cells.requested == sum(one.cells.requested for one in runs) == comparison.progress.done
    assert comparison.best is not None
    assert comparison.best.objective == max(one.best.objective for one in runs if one.best)
    with database.read() as connection:
        assert campaigns.page(connection)[0] == [comparison], "its runs are not listed"
    assert [verdict for verdict in verify(database, full=True) if verdict.problems] == []


def test_runs_of_one_population_size_start_alike_whatever_their_optimizer_and_seed(
    compared: tuple[Database, StoredCampaign, ComputedBackend],
) -> None:
    database, comparison, _ = compared
    for population in (6, 9):
        starts = {
            tuple(cells_of(database, one))
            for one in runs_of(database, comparison)
            if one.spec["optimizer"]["population"] == population
        }
        assert len(starts) == 1
    second = {tuple(cells_of(database, one, 1)) for one in runs_of(database, comparison)}
    assert len(second) == 12, "and then each goes its own way"


def test_what_runs_have_in_common_is_simulated_once_and_counted_by_each(
    compared: tuple[Database, StoredCampaign, ComputedBackend],
) -> None:
    database, comparison, backend = compared
    runs = runs_of(database, comparison)
    assert len(backend.sent) == len(set(backend.sent))
    assert len(backend.sent) < sum(one.cells.simulated for one in runs)
    for one in runs:
        with database.read() as connection:
            rows = list(results.stream(connection, one.sequence))
        distinct = {(row.scenario, *row.parameters.floats.values()) for row in rows}
        assert one.cells.simulated == len(distinct), "what it would have taken alone"
        assert one.cells.repeated == len(rows) - len(distinct)


@pytest.mark.slow
def test_runs_count_alike_whatever_was_stored_before_and_whichever_others_there_are(
    compared: tuple[Database, StoredCampaign, ComputedBackend], database: Database
) -> None:
    before, comparison, _ = compared
    run(database, submit(database, catalogue=["S1", "S2"]))
    alone = run(database, submit_comparison(database, optimizers=[{"kind": "swarm"}], at_a_time=1))
    swarms = [everything(before, one) for one in runs_of(before, comparison)[6:]]
    assert [everything(database, one) for one in runs_of(database, alone)] == swarms


@pytest.mark.slow
def test_a_killed_comparison_ends_bit_for_bit_like_one_that_was_not(
    compared: tuple[Database, StoredCampaign, ComputedBackend], tmp_path: Path
) -> None:
    draw = random.Random(1)
    opened = migrated(f"sqlite:///{tmp_path / 'killed'}.db")
    comparison = submit_comparison(opened)
    kills = 0
    while not get(opened, comparison).state.ended:
        working, kills = dispatcher(opened, ComputedBackend(draw.randrange(99))), kills + 1
        for _ in range(draw.randrange(1, 12)):
            working.step()
    assert kills > 5
    assert found_by(opened, comparison) == found_by(compared[0], compared[1])
    opened.dispose()


def test_a_comparison_rests_goes_on_and_ends_with_its_runs(database: Database) -> None:
    comparison = submit_comparison(database)
    working = dispatcher(database)

    def step_until(state: CampaignState) -> dict[CampaignState, int]:
        for _ in range(500):
            working.step()
            if get(database, comparison).state is state:
                break
        states = [one.state for one in runs_of(database, comparison)]
        return {one: states.count(one) for one in dict.fromkeys(states)}

    while sum(one.state.ended for one in runs_of(database, comparison)) < 2:
        working.step()
    with database.transaction() as connection:
        campaigns.request_action(connection, comparison.id, "pause")
    resting = step_until(CampaignState.PAUSED)
    assert CampaignState.RUNNING not in resting
    assert resting[CampaignState.PAUSED] > 0
    assert get(database, comparison).cells.requested == sum(one.cells.requested for one in runs_of(database, comparison)) > 0
    with database.transaction() as connection:
        campaigns.request_action(connection, comparison.id, "resume")
    going = step_until(CampaignState.RUNNING)
    assert CampaignState.PAUSED not in going
    with database.transaction() as connection:
        campaigns.request_action(connection, comparison.id, "cancel")
    ended = step_until(CampaignState.CANCELLED)
    assert set(ended) == {CampaignState.SUCCEEDED, CampaignState.CANCELLED}
    assert get(database, comparison).cells.requested == sum(one.cells.requested for one in runs_of(database, comparison))
    assert [verdict for verdict in verify(database, full=True) if verdict.problems] == []


@pytest.mark.slow
def test_a_run_that_fails_costs_no_other_one_and_is_named_at_the_end(database: Database) -> None:
    def broken(scenario: str, cell: Cell) -> CellResult:
        if scenario == "S1":
            return CellResult(cell.id, None, None, {}, None, 5.0, "error", "it tipped over")
        return computed(scenario, cell)

    comparison = submit_comparison(database, populations=[6], optimizers=[{"kind": "random"}])
    ended = finish(database, comparison, dispatcher(database, ComputedBackend(answer=broken)))
    assert ended.state is CampaignState.FAILED
    assert ended.error is not None
    assert ended.error.startswith("3 of 3 runs failed: random, population 6, seed 1: no parameter set has a result")


def test_the_waiting_cells_of_a_failed_run_are_not_simulated(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    comparison = submit_comparison(
        database, populations=[500], optimizers=[{"kind": "random"}], reductions=["off"], iterations=1
    )

    def fail(_: StagedCampaign, completed: Sequence[Completed]) -> list[Work]:
        raise ValueError(f"a mistake after {len(completed)} cells")

    monkeypatch.setattr(StagedCampaign, "record", fail)
    backend = ComputedBackend()
    finish(database, comparison, dispatcher(database, backend))
    failed = runs_of(database, comparison)
    assert [run.state for run in failed] == [CampaignState.FAILED] * 3
    assert len(backend.sent) < 1500
    assert [verdict for verdict in verify(database, full=True) if verdict.problems] == []


def test_a_run_that_fails_while_its_cells_are_at_workers_leaves_nothing_behind(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    comparison = submit_comparison(
        database, populations=[60], optimizers=[{"kind": "random"}], reductions=["off"], iterations=1
    )
    record = StagedCampaign.record

    def fail(job: StagedCampaign, completed: Sequence[Completed]) -> list[Work]:
        if completed[0].result.id <= 120:  # of the first run
            raise ValueError("a mistake")
        return record(job, completed)

    monkeypatch.setattr(StagedCampaign, "record", fail)
    finish(database, comparison, dispatcher(database))
    assert [one.state.value for one in runs_of(database, comparison)] == ["failed", "succeeded", "succeeded"]
    assert [verdict for verdict in verify(database, full=True) if verdict.problems] == []


WITHOUT_LOTS = {"mode": "influence", "audit": 0.4, "max_error": 1}


@pytest.mark.slow
def test_a_reduction_is_compared_seed_by_seed(database: Database) -> None:
    stored_map = post_map(database, nothing_matters())
    comparison = submit_comparison(
        database,
        stored_map,
        optimizers=[{"kind": "genetic"}],
        populations=[9],
        reductions=["exact", WITHOUT_LOTS, {"mode": "influence", "audit": 0.0}],
    )
    ended = run(database, comparison)
    runs = runs_of(database, ended)
    labels = ["exact", "influence audit=0.4 max_error=1.0", "influence audit=0.0"]
    assert [one.name.rpartition(", ")[2] for one in runs[:3]] == labels
    assert [one.influence_map_id for one in runs[:3]] == [None, stored_map, stored_map]
    exact, reduced, inspected = runs[0::3], runs[1::3], runs[2::3]
    assert all(one.cells.reused > 0 for one in reduced)
    assert all(two.cells.simulated < one.cells.simulated for one, two in zip(exact, reduced, strict=True))
    rate = ended.error_rate["S1"]
    for name in ("audited", "wrong", "lots", "rejected"):
        counted = [sum(getattr(one.error_rate["S1"], name) for one in group) for group in (reduced, inspected)]
        assert getattr(rate, name) == sum(counted) > 0
    assert rate.lots == sum(one.error_rate["S1"].lots for one in inspected)
    assert rate.upper_95 is None, "every run has its own"
    assert not rate.stopped
    assert len(ended.notes) == sum("lots of reused answers" in note for one in inspected for note in one.notes) > 0
    assert all(note.startswith("genetic, population 9, seed ") for note in ended.notes)
    with database.read() as connection:
        figures, _ = generations.page(connection, exact[0].sequence, limit=10)
    assert all(one.rating is not None and one.best is not None for _, one in figures)


@pytest.mark.slow
def test_what_a_search_believed_of_references_is_confirmed_after_it(database: Database) -> None:
    stored_map = post_map(database, nothing_matters() | {"S1": {"P1": {"influential": True}}})
    reductions = ["exact", WITHOUT_LOTS]
    weights = {"S1": 3.0, "S2": 1.0}
    given = {"optimizers": [{"kind": "genetic"}], "populations": [9], "reductions": reductions, "weights": weights}
    ended = run(database, submit_comparison(database, stored_map, **given))
    with database.read() as connection:
        found = read_compared(connection, ended)
        rows = {two.id: list(results.stream(connection, two.sequence)) for two in found.campaigns}
    for one, campaign in zip(found.runs(), found.campaigns, strict=True):
        own: dict[int, dict[str, float]] = {}
        for row in rows[one.run]:
            if row.outcome != "reused" and row.score is not None:
                own.setdefault(row.parameter_set_id, {})[row.scenario] = row.score
        known = [
            sum(weights[name] * score for name, score in scores.items()) / 4 for scores in own.values() if len(scores) == 2
        ]
        assert campaign.best is not None
        assert one.simulated_best == pytest.approx(max(known)) == pytest.approx(campaign.best.objective)
        after = [row for row in rows[one.run] if row.iteration >= 3]
        assert one.confirmations == len(after)
        assert one.simulations == sum(row.outcome not in {"repeated", "reused"} for row in rows[one.run])
        assert campaign.spec["reduction"]["confirm"] == (20 if one.reduction == "exact" else CONFIRMED)
    assert sum(one.confirmations for one in found.runs()) > 0
    believed = [one for one in found.runs() if one.best != one.simulated_best]
    assert {one.reduction for one in believed} == {"influence audit=0.4 max_error=1.0"}
    assert not any("confirmed" in note for note in ended.notes), "the tables tell"
    assert [one.difference for one in found.pairs()] == [
        pytest.approx((two.simulated_best or 0) - (one.simulated_best or 0))
        for one, two in zip(found.runs()[0::2], found.runs()[1::2], strict=True)
    ]
    assert [one.saved for one in found.pairs()] == [
        one.simulations - two.simulations for one, two in zip(found.runs()[0::2], found.runs()[1::2], strict=True)
    ]


def test_runs_of_an_earlier_release_have_the_best_of_what_they_simulated(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivecal.campaigns.comparisons.resolve.CONFIRMED", 0)
    stored_map = post_map(database, nothing_matters() | {"S1": {"P1": {"influential": True}}})
    given = {"optimizers": [{"kind": "genetic"}], "populations": [9], "reductions": [WITHOUT_LOTS]}
    ended = run(database, submit_comparison(database, stored_map, **given))
    with database.read() as connection:
        found = read_compared(connection, ended).runs()
    assert [one.confirmations for one in found] == [0, 0, 0]
    assert any(one.best != one.simulated_best for one in found)


def test_predicted_cells_are_no_simulations_of_a_run(database: Database) -> None:
    ended = run(database, submit_comparison(database, optimizers=[{"kind": "genetic"}], populations=[6]))
    with database.transaction() as connection:
        before = read_compared(connection, ended).runs()
        pages = [generations.page(connection, one.sequence)[0] for one in runs_of(database, ended)]
        columns = tables.generations.c
        later = update(tables.generations).where(columns.iteration > 0)
        connection.execute(later.values(predicted=columns.simulated, simulated=0, best=columns.best - 1))
        after = read_compared(connection, ended).runs()
    predicted = [sum(figures.simulated for iteration, figures in page if iteration) for page in pages]
    searched = [one.simulations - one.confirmations for one in before]
    assert [one.simulations - one.confirmations for one in after] == [
        count - answered for count, answered in zip(searched, predicted, strict=True)
    ]
    assert min(predicted) > 0
    assert [run.simulated_best for run in after] == [run.simulated_best for run in before], "confirmed sets count"


def test_a_comparison_of_results_that_are_all_there_leaves_time_for_others(database: Database) -> None:
    small: dict[str, Any] = {"optimizers": [{"kind": "swarm"}], "populations": [6]}
    run(database, submit_comparison(database, **small))
    again = submit_comparison(database, **small)
    backend = ComputedBackend()
    working = dispatcher(database, backend)
    ended = []
    while not get(database, again).state.ended:
        working.step()
        ended.append(sum(one.state.ended for one in runs_of(database, again)))
    assert backend.sent == []
    assert max(after - before for before, after in pairwise(ended)) == 1
    assert get(database, again).cells.simulated > 0, "counted as needed all the same"


def test_a_run_is_named_by_the_reduction_that_it_was_stored_with(database: Database) -> None:
    given: dict[str, Any] = {"optimizers": [{"kind": "genetic"}], "populations": [6], "reductions": ["exact", "predicted"]}
    comparison = submit_comparison(database, **given)
    with database.transaction() as connection:
        for stored in runs_of(database, comparison):
            earlier = {**stored.spec, "reduction": {**stored.spec["reduction"], "confirm": 20}}
            here = tables.campaigns.c.sequence == stored.sequence
            connection.execute(update(tables.campaigns).where(here).values(spec=earlier))
        compared = read_compared(connection, comparison).runs()
    assert {run.reduction for run in compared} == {"exact", "predicted confirm=20"}
