"""Answers by references in whole campaigns: inspected in lots, as predictions are."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.runs import dispatcher, finish, influenced, lots_of, post_map, rows_of, run, submit

from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.evaluations import Outcome
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.lots import LotVerdict
from drivecal.storage.maintenance.consistency import verify
from drivecal.storage.results import StoredEvaluation

ITERATIONS = 4
REST = {f"P{i}": 0.5 for i in range(5, 12)}
NOWHERE = {"S1": ("P3", "P4"), "S2": ("P1", "P2", "P4")}


def nearly(scenario: str, cell: Cell) -> CellResult:
    """Contradicts the map for one set in 25 in S1, and agrees elsewhere."""
    told, p = influenced(scenario, cell), cell.parameters
    if scenario == "S1" and (p["P3"], p["P4"]) == (0.25, 0.75) and told.rating is not None:
        return replace(told, rating=told.rating + 3.0, score=round(told.rating + 3.0))
    return replace(told, milliseconds=500.0)


def breaking(scenario: str, cell: Cell) -> CellResult:
    """Some of the sets that are to answer others have no result."""
    if scenario == "S2" and cell.parameters["P3"] == 0.5 and cell.parameters["P1"] < 0.5:
        return CellResult(cell.id, None, None, {}, None, 1.0, "crash", "segmentation fault")
    return nearly(scenario, cell)


def ask(
    database: Database, *, population: int = 100, step: float = 0.25, likeness: str | None = None, **changes: Any
) -> StoredCampaign:
    known = {scenario: {name: {"influential": False} for name in names} for scenario, names in NOWHERE.items()}
    return submit(
        database,
        stored_map=post_map(database, known),
        likeness=likeness,
        parameters=[{"name": f"P{i}", "lower": 0, "upper": 1, "step": step} for i in range(1, 5)],
        fixed=REST,
        catalogue=["S1", "S2"],
        optimizer={"kind": "genetic", "population": population, "iterations": ITERATIONS, "seed": 3},
        reduction={"audit": 0.0, "max_error": 0.05, "confirm": 0} | changes,
    )


@pytest.mark.slow
@pytest.mark.parametrize(("isolated", "counted"), [(True, False), (False, True)])
def test_equal_campaigns_have_references_in_common_unless_one_is_isolated(
    tmp_path: Path, *, isolated: bool, counted: bool
) -> None:
    database = migrated(f"sqlite:///{tmp_path / '1.db'}")
    for _ in range(2):
        ended = run(database, ask(database, likeness="equal", isolated=isolated), ComputedBackend(answer=nearly))
    own = {row.id for row in rows_of(database, ended)}
    reused = [row.reference for row in rows_of(database, ended) if row.outcome is Outcome.REUSED]
    assert len(reused) > 50
    assert any(reference not in own for reference in reused) == counted
    database.dispose()


@pytest.mark.slow
@pytest.mark.parametrize("steps", [3, 8])
def test_an_equal_campaign_beside_one_that_runs_simulates_nothing(tmp_path: Path, steps: int) -> None:
    database = migrated(f"sqlite:///{tmp_path / '1.db'}")
    first, working = ask(database, likeness="equal"), dispatcher(database, ComputedBackend(answer=nearly))
    for _ in range(steps):
        working.step()
    second = ask(database, likeness="equal")
    ended = [finish(database, each, working) for each in (first, second)]
    rows = [
        sorted((row.scenario, row.iteration, row.individual, row.score) for row in rows_of(database, each)) for each in ended
    ]
    assert (rows[0], ended[1].cells.runs) == (rows[1], 0)
    database.dispose()


@pytest.fixture(scope="module")
def inspected(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Database, StoredCampaign]]:
    database = migrated(f"sqlite:///{tmp_path_factory.mktemp('inspected') / '1.db'}")
    yield database, run(database, ask(database, population=300), ComputedBackend(answer=nearly))
    database.dispose()


def test_counts_of_lots_cells_and_campaign_agree(inspected: tuple[Database, StoredCampaign]) -> None:
    database, campaign = inspected
    rows, stored = rows_of(database, campaign), lots_of(database, campaign, Outcome.REUSED)
    outcomes = Counter(row.outcome for row in rows)
    assert campaign.cells.reused == outcomes[Outcome.REUSED] > 0
    released = {lot.id for lot in stored if lot.verdict is LotVerdict.RELEASED}
    drawn_twice = sum(row.lot in released and row.purpose != "audit" and row.outcome is Outcome.SIMULATED for row in rows)
    assert sum(lot.released for lot in stored) == campaign.cells.reused + drawn_twice
    assert campaign.cells.audited == sum(row.purpose == "audit" for row in rows) == sum(lot.sample for lot in stored)
    assert campaign.cells.sampled == 0, "these are drawn predictions"
    assert {lot.verdict for lot in stored} == {LotVerdict.RELEASED, LotVerdict.REJECTED}
    for scenario, rate in campaign.error_rate.items():
        here = [lot for lot in stored if lot.scenario == scenario]
        assert (rate.lots, rate.inspected) == (len(here), sum(lot.size for lot in here))
        assert rate.sampled == rate.audited
        assert rate.rejected == sum(lot.verdict is LotVerdict.REJECTED for lot in here)
        assert rate.audited == sum(lot.sample for lot in here)
        assert rate.wrong == sum(lot.errors or 0 for lot in here)
        assert rate.upper_95 is not None
        wrong = sum(
            row.score != nearly(scenario, Cell(0, row.parameters.floats)).score
            for row in rows
            if row.outcome is Outcome.REUSED and row.scenario == scenario
        )
        count = sum(row.outcome is Outcome.REUSED and row.scenario == scenario for row in rows)
        assert wrong / count <= rate.upper_95 <= 1
    assert campaign.released == {}
    assert campaign.error_rate["S2"].rejected == 0
    assert campaign.error_rate["S1"].rejected > 0
    assert [check for check in verify(database) if check.problems] == []


def test_a_lot_of_references_is_released_or_simulated_whole(inspected: tuple[Database, StoredCampaign]) -> None:
    database, campaign = inspected
    rows = rows_of(database, campaign)
    by_id = {row.id: row for row in rows}
    twins_of_all: list[tuple[StoredEvaluation, StoredEvaluation]] = []
    for lot in lots_of(database, campaign, Outcome.REUSED):
        members = [row for row in rows if row.lot == lot.id]
        sample = [row for row in members if row.purpose == "audit"]
        assert (len(members), len(sample)) == (lot.size, lot.sample)
        differences = [abs((row.score or 0) - (by_id[row.reference or 0].score or 0)) for row in sample]
        assert lot.errors == sum(difference > lot.tolerance for difference in differences)
        rest = [row for row in members if row.purpose != "audit"]
        if lot.verdict is LotVerdict.RELEASED:
            known = {row.parameter_set_id: row for row in sample}
            twins = [row for row in rest if row.parameter_set_id in known]
            twins_of_all += [(row, known[row.parameter_set_id]) for row in twins]
            released = [row for row in rest if row not in twins]
            assert {row.outcome for row in released} <= {Outcome.REUSED}
            assert all(row.score == by_id[row.reference or 0].score for row in released)
        else:
            assert {row.outcome for row in rest} <= {Outcome.SIMULATED}
            assert all(row.reference is None for row in rest)
            assert (lot.errors or 0) > lot.acceptance
    assert twins_of_all, "individuals with the same set"
    for row, drawn in twins_of_all:
        assert (row.outcome, row.score, row.run_id) == (Outcome.SIMULATED, drawn.score, drawn.run_id)
        assert (row.attempts, row.reference) == (0, None), "the sample's run"
    in_lots = {row.id for row in rows if row.lot is not None}
    assert all(row.id in in_lots for row in rows if row.outcome is Outcome.REUSED)


def test_without_a_limit_there_are_no_lots_and_audits_stay(database: Database) -> None:
    campaign = run(database, ask(database, max_error=1, audit=0.2), ComputedBackend(answer=nearly))
    assert lots_of(database, campaign) == []
    assert campaign.cells.reused > campaign.cells.audited > 0


def test_a_reference_without_a_result_answers_no_cell_of_its_lot(database: Database) -> None:
    campaign = run(database, ask(database), ComputedBackend(answer=breaking))
    rows = rows_of(database, campaign)
    assert campaign.cells.failed > 0
    by_id = {row.id: row for row in rows}
    for row in rows:
        if row.outcome is Outcome.REUSED:
            assert by_id[row.reference or 0].outcome is Outcome.SIMULATED
    assert [check for check in verify(database) if check.problems] == []
