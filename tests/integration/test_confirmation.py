"""A search with reused scores ends with a simulated best set."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.problems import scored, store, submit_checked
from tests.support.runs import post_map, rows_of, run, submit, told_of
from tests.support.values import present

from drivecal.analysis.verdicts import confirmation_verdict
from drivecal.api.results.document import results_of
from drivecal.campaigns.results.explanation import explain
from drivecal.campaigns.results.front import StoredRanking
from drivecal.contracts.campaign import Best
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.evaluations import Outcome
from drivecal.storage import generations, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance.consistency import verify

ITERATIONS = 4
MATTERS = {"S1": "P1", "S2": "P3"}
BLIND_MAP = {
    scenario: {f"P{i}": {"influential": False} for i in range(1, 12) if f"P{i}" != name} for scenario, name in MATTERS.items()
}
"""A map that calls the parameter that spoils S1 and helps S2 irrelevant."""


def spoiled(scenario: str, cell: Cell) -> CellResult:
    p = cell.parameters
    good, bad = (p["P1"], p["P3"]) if scenario == "S1" else (p["P3"], p["P1"])
    rating = 2 + 4 * good - 2 * bad + 0.01 * p["P2"]
    return CellResult(cell.id, rating, round(rating), {"rating": rating}, None, 7.0)


def unreliable(scenario: str, cell: Cell) -> CellResult:
    """The sets that seem to be the best cannot be simulated."""
    if cell.parameters["P1"] == cell.parameters["P3"] == 1.0:
        return CellResult(cell.id, None, None, {}, None, 1.0, "crash", "segmentation fault")
    return spoiled(scenario, cell)


def ask(database: Database, confirm: int, seed: int = 3, population: int = 16) -> StoredCampaign:
    return submit(
        database,
        stored_map=post_map(database, BLIND_MAP),
        catalogue=["S1", "S2"],
        optimizer={"kind": "genetic", "population": population, "iterations": ITERATIONS, "seed": seed},
        reduction={"audit": 0.1, "max_error": 1.0, "confirm": confirm},
    )


@pytest.fixture(scope="module")
def confirmed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Database, StoredCampaign, StoredCampaign]]:
    """Two campaigns with the same search: only the first confirms its best set."""
    opened = [migrated(f"sqlite:///{tmp_path_factory.mktemp('confirmed') / str(confirm)}.db") for confirm in (50, 0)]
    one, plain = (
        run(database, ask(database, confirm), ComputedBackend(answer=spoiled))
        for database, confirm in zip(opened, (50, 0), strict=True)
    )
    with opened[0].read() as with_it, opened[1].read() as without:
        figures = [generations.page(reading, campaign.sequence)[0] for reading, campaign in ((with_it, one), (without, plain))]
    assert figures[0] == figures[1], "the search itself is the same"
    yield opened[0], one, plain
    for database in opened:
        database.dispose()


def test_the_best_set_is_simulated_and_ranked_anew(confirmed: tuple[Database, StoredCampaign, StoredCampaign]) -> None:
    database, campaign, plain = confirmed
    assert campaign.best is not None
    assert plain.best is not None
    assert campaign.best.objective < plain.best.objective
    cells = {name: spoiled(name, Cell(1, campaign.best.parameters)).score for name in campaign.best.scores}
    assert campaign.best.scores == cells
    known = present(campaign.confirmation)
    assert (known.state, known.objective, known.believed) == ("confirmed", campaign.best.objective, plain.best.objective)
    told = told_of(database, campaign)
    notes, best = ([event.data for event in told if event.kind == kind] for kind in ("note", "best"))
    assert notes[-1]["text"] == confirmation_verdict(known).text
    assert plain.best.objective in {item["objective"] for item in best}
    assert Best.model_validate(best[-1]) == campaign.best, "whoever follows the events knows it as well"
    assert (plain.notes, plain.confirmation) == ((), None)
    stored = StoredRanking.of(database, campaign)
    first = stored.sets.best_first()[0]
    assert results_of(stored, place=(first.iteration, first.individual)).trust == results_of(stored).trust


def test_a_confirming_cell_is_explained_and_ranks(confirmed: tuple[Database, StoredCampaign, StoredCampaign]) -> None:
    database, campaign, _ = confirmed
    rows = rows_of(database, campaign)
    by_number = {row.id: row for row in rows}
    own = next(row for row in rows if row.iteration == ITERATIONS)
    copy = next(
        row
        for row in rows
        if (row.outcome, row.parameter_set_id, row.scenario) == (Outcome.REUSED, own.parameter_set_id, own.scenario)
    )
    with database.read() as connection:
        result = explain(connection, own.id)
        ranked_by = results.cells_at(connection, campaign.sequence, copy.iteration, copy.individual, copy.scenario)
        other = next(row for row in rows if row.iteration == 0)
        assert results.cells_at(connection, campaign.sequence, 0, other.individual, other.scenario) == {0: other.id}
    assert result.reason == "checked"
    assert present(result.reference).evaluation == copy.reference
    assert (result.score, present(result.check).expected) == (own.score, by_number[copy.reference or 0].score)
    assert ranked_by == {0: own.id}


@pytest.mark.slow
def test_no_more_sets_are_tried_than_asked_for_and_failing_ones_once(database: Database) -> None:
    cut = run(database, ask(database, 1), ComputedBackend(answer=spoiled))
    assert {row.iteration for row in rows_of(database, cut) if row.iteration >= ITERATIONS} == {ITERATIONS}
    assert present(cut.confirmation).tried == 1
    failing = run(database, ask(database, 50, seed=5), ComputedBackend(answer=unreliable))
    tried = [row for row in rows_of(database, failing) if row.iteration >= ITERATIONS]
    assert Outcome.FAILED in {row.outcome for row in tried}
    assert len({(row.parameter_set_id, row.scenario) for row in tried}) == len(tried)
    assert present(failing.confirmation).failed
    assert [check for check in verify(database) if check.problems] == []


@pytest.mark.slow
def test_runs_under_further_seeds_and_sets_to_confirm_have_rounds_of_their_own(database: Database) -> None:
    generator = np.random.default_rng(2)

    def unsaid(_: Any, cell: Cell) -> CellResult:
        value = 2 + 3 * abs(cell.parameters["a"] - 0.3) + float(cell.parameters["c"]) + generator.normal(0, 0.6)
        return CellResult(cell.id, None, None, {"y": value}, None, 7.0, repeats=False if cell.check else None)

    simulator = {"kind": "process", "command": ["mysim"], "deterministic": False}
    store(database, scored("unsaid", {name: {"lower": 0, "upper": 1, "step": 0.1} for name in "abc"}, simulator=simulator))
    blind = {scenario: {"c": {"influential": False}} for scenario in ("city", "road")}
    spec: dict[str, Any] = {"problem": "unsaid", "reduction": {"max_error": 1, "confirm": 20, "repeat": 0.2}}
    optimizer = {"kind": "genetic", "population": 40, "iterations": 4, "seed": 2}
    spec |= {"optimizer": optimizer, "sensitivity": {"map": post_map(database, blind, problem="unsaid")}}
    ended = run(database, submit_checked(database, spec), ComputedBackend(2, driven=unsaid))
    rounds = [{row.seed > 1 for row in rows_of(database, ended) if row.iteration == number} for number in range(4, 17)]
    assert {False} in rounds[rounds.index({True}) :], "a set to confirm after further seeds"
    assert {False, True} not in rounds
    assert not present(ended.confirmation).copied
