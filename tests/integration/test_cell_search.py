"""Searches by the cell: what they ask for, how they end, and what a budget counts."""

from __future__ import annotations

import random
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.cell_search import CellSearchPlugin
from tests.support.changes import install
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.deaths import killed_between_rounds
from tests.support.problems import scored, store, submit_checked
from tests.support.runs import dispatcher, everything, get, rows_of, run, submit
from tests.support.values import present

from drivecal.campaigns.resolve import resolvers
from drivecal.campaigns.stages import cell_search
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.constraints import Constraint, Constraints
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

WITH_SIX: dict[str, Any] = {"catalogue": ["S1", "S2", "S3"], "reduction": {"mode": "exact"}}
BY_CELL: dict[str, Any] = {"optimizer": {"kind": "cell_search"}} | WITH_SIX


@pytest.fixture(autouse=True)
def _plugin(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, "optimizer", CellSearchPlugin())


def carried_out(database: Database, seed: int = 0, **changes: Any) -> StoredCampaign:
    return run(database, submit(database, **changes), ComputedBackend(seed))


@pytest.mark.parametrize(("budget", "sets"), [(4, 2), (5, 2), (6, 3)])
def test_a_budget_of_whole_sets_completes_them(tmp_path: Path, budget: int, sets: int) -> None:
    database = migrated(f"sqlite:///{tmp_path / 'drivecal.db'}")
    space = {name: {"lower": 0, "upper": 1} for name in ("x", "z")}
    store(database, scored("unsaid", space, simulator={"kind": "process", "command": ["mysim"]}))
    asked = {"problem": "unsaid", "optimizer": {"kind": "surrogate"}, "budget": {"simulations": budget}}

    def driven(_: object, cell: Cell) -> CellResult:
        return CellResult(cell.id, None, None, {"y": float(cell.parameters["x"])}, None, 7.0)

    ended = run(database, submit_checked(database, asked), ComputedBackend(driven=driven))
    counts = Counter(row.parameters for row in rows_of(database, ended) if row.outcome == "simulated")
    assert sum(count == 2 for count in counts.values()) == sets
    assert ended.cells.runs <= budget


def test_a_budget_is_used_up_exactly_and_cells_of_sets_that_cannot_win_are_in_no_sum(database: Database) -> None:
    ended = carried_out(database, budget={"simulations": 53}, **BY_CELL)
    assert (ended.state, ended.cells.runs, ended.cells.simulated) == (CampaignState.SUCCEEDED, 53, 53)
    assert present(ended.search).ended_by == "budget"
    assert ended.cells.discarded > 0
    assert ended.cells.proposed == ended.cells.requested == 53
    best = present(ended.best).parameters
    rows = [row for row in rows_of(database, ended) if row.parameters.floats == best]
    assert {row.scenario for row in rows} == {"S1", "S2", "S3"}


@pytest.mark.parametrize("mode", ["exact", "predicted"])
def test_a_generational_search_ends_within_its_budget(database: Database, mode: str) -> None:
    optimizer = {"kind": "genetic", "population": 12, "seed": 3}
    ended = carried_out(database, optimizer=optimizer, budget={"simulations": 100}, **WITH_SIX | {"reduction": {"mode": mode}})
    assert 90 <= ended.cells.runs <= 100
    assert present(ended.search).ended_by == "budget"


@pytest.mark.slow
def test_a_search_that_stands_still_ends(database: Database) -> None:
    ended = carried_out(database, budget={"simulations": 3_000, "stagnation": 60}, **BY_CELL)
    assert present(ended.search).ended_by == "stagnation"
    assert ended.cells.runs < 3_000
    assert present(ended.search).stood_still_at is not None
    assert ended.progress.done == ended.progress.total


def test_the_same_search_again_simulates_nothing_and_another_begins_with_what_is_stored(database: Database) -> None:
    spec: dict[str, Any] = {"optimizer": {"kind": "surrogate"}, "budget": {"simulations": 30}} | WITH_SIX
    first = carried_out(database, likeness="a", **spec)
    again = carried_out(database, likeness="a", **spec)
    other = carried_out(database, likeness="b", weights={"S1": 3.0}, **spec)
    assert (again.cells.runs, again.cells.repeated, again.best == first.best) == (0, 30, True)
    assert other.cells.repeated >= 9  # the three best stored sets
    assert 30 - 2 <= other.cells.runs + other.cells.repeated <= 30, "no further set fits"
    further = carried_out(database, likeness="c", **spec | {"catalogue": ["S1", "S2", "S3", "S4"]})
    begun = rows_of(database, further)[0].parameters.floats
    assert begun == present(first.best).parameters, "no stored set has S4, where all count alike"


@pytest.mark.parametrize("kills", [False, True])
def test_a_search_waits_for_its_answers_before_it_has_nothing_to_ask_for(tmp_path: Path, kills: bool) -> None:
    """All sets of a small space are asked for, or stored, and a set gets further seeds once its first one is answered."""
    database = migrated(f"sqlite:///{tmp_path / 'drivecal.db'}")
    store(database, scored("small", {"x": {"lower": 0, "upper": 3, "step": 1}}, simulator=RANDOM))
    asked = {"problem": "small", "optimizer": {"kind": "surrogate"}, "budget": {"simulations": 60}}
    ended = [run(database, submit_checked(database, asked), ComputedBackend(driven=lucky))]
    campaign, working = submit_checked(database, asked | {"name": "again"}), dispatcher(database, ComputedBackend(driven=lucky))
    for _ in range(2_000):
        working.step()
        if get(database, campaign).state.ended:
            break
        if kills:
            working = dispatcher(database, ComputedBackend(driven=lucky))
    ended.append(get(database, campaign))
    assert [each.cells.requested for each in ended] == [4 * 8] * 2, "each set has all seeds that search"


RANDOM = {"kind": "process", "command": ["mysim"], "random": True}


def lucky(setup: Any, cell: Cell) -> CellResult:
    luck = random.Random(f"{setup.seed} {cell.parameters}").gauss(0, 1)
    return CellResult(cell.id, None, None, {"y": 5.0 + float(cell.parameters["x"]) + luck}, None, 7.0)


def costly(_: Any, cell: Cell) -> CellResult:
    return CellResult(cell.id, None, None, {"y": 5.0 * float(cell.parameters["x"])}, None, 7.0)


def test_a_generational_search_keeps_nothing_for_a_check_of_copies_that_it_has_not(database: Database) -> None:
    store(database, scored("plain", {"x": {"lower": 0, "upper": 1}}))
    optimizer = {"kind": "genetic", "population": 10}
    campaign = submit_checked(database, {"problem": "plain", "budget": {"simulations": 50}, "optimizer": optimizer})
    assert run(database, campaign, ComputedBackend(driven=costly)).cells.simulated == 50


def test_a_search_begins_with_the_best_stored_set_however_old(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cell_search, "MOST_KNOWN", 3)
    store(database, scored("old", {"x": {"lower": 0, "upper": 1, "step": 0.05}}))
    filling = {"kind": "random", "population": 15, "iterations": 1, "start_sets": [{"x": 0.0}]}
    run(database, submit_checked(database, {"problem": "old", "optimizer": filling}), ComputedBackend(driven=costly))
    campaign = submit_checked(database, {"problem": "old", "budget": {"simulations": 3}, "optimizer": {"kind": "surrogate"}})
    run(database, campaign, ComputedBackend(driven=costly))
    assert rows_of(database, campaign)[0].parameters.floats == {"x": 0.0}


@pytest.mark.parametrize("is_random", [False, True])
def test_a_budget_of_one_set_suffices_if_runs_may_differ(database: Database, is_random: bool) -> None:
    simulator = {"kind": "process", "command": ["./run"], "random": is_random}
    store(database, scored("one", {"x": {"lower": 0, "upper": 1}}, simulator=simulator, scenarios={"a": {}, "b": {}}))
    campaign = submit_checked(database, {"problem": "one", "budget": {"simulations": 2}})
    ended = run(database, campaign, ComputedBackend(driven=costly))
    assert (ended.state, ended.cells.runs) == (CampaignState.SUCCEEDED, 2)


def test_a_stored_set_that_a_new_constraint_forbids_is_not_the_best(database: Database) -> None:
    problem = scored("narrowed", {"x": {"lower": 0, "upper": 1, "step": 0.05}})
    for constraints, best in (([], 0.0), (["x >= 0.4"], 2.0)):
        store(database, problem | {"constraints": constraints})
        campaign = submit_checked(database, {"problem": "narrowed", "budget": {"simulations": 20}})
        assert present(run(database, campaign, ComputedBackend(driven=costly)).best).objective == pytest.approx(best)


@pytest.mark.slow
def test_a_repaired_set_that_was_asked_before_is_no_requested_cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few: dict[str, Constraint] = {"few sets": lambda values: np.sum(list(values.values()), axis=0) <= 0.5}
    monkeypatch.setattr(resolvers, "Constraints", lambda space, _: Constraints(space, few))
    spec = WITH_SIX | {"optimizer": {"kind": "random", "population": 12, "iterations": 5}}
    outcomes = []
    for deaths in (0, 2):
        database = migrated(f"sqlite:///{tmp_path / f'{deaths}.db'}")
        campaign = submit(database, **spec)
        killed_between_rounds(database, campaign, range(1, deaths + 1))
        outcomes.append(everything(database, campaign))
        cells, search = get(database, campaign).cells, get(database, campaign).search
        assert present(search).repaired.proposed > 5
        assert (cells.simulated, cells.proposed) == (6 * 3, 12 * 5 * 3)
        assert cells.requested == (12 + present(search).repaired.distinct) * 3, "only the first population is requested whole"
    assert outcomes[0] == outcomes[1]


@pytest.mark.parametrize("optimizer", [{"kind": "cell_search"}, {"kind": "genetic", "population": 12}], ids=["cells", "sets"])
def test_a_search_resumes_between_a_closed_round_and_the_next_one(tmp_path: Path, optimizer: dict[str, Any]) -> None:
    result = []
    for deaths in (0, 2):
        database = migrated(f"sqlite:///{tmp_path / f'{deaths}.db'}")
        campaign = submit(database, optimizer=optimizer, budget={"simulations": 60}, **WITH_SIX)
        killed_between_rounds(database, campaign, range(1, deaths + 1))
        result.append((everything(database, campaign)[0], get(database, campaign).cells))
    (whole, undisturbed), (cells, killed) = result
    assert cells == whole
    assert (undisturbed.runs, undisturbed.lost) == (undisturbed.requested, 0)
    assert killed.runs == killed.requested + killed.lost
    assert (killed.lost > 0) == (optimizer["kind"] == "cell_search")  # nothing is at a worker between two populations
