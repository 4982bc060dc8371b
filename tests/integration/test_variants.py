"""Campaigns for several variants: shared simulations, the best set of each, and what the best common one costs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from tests.support.computed import ComputedBackend, computed
from tests.support.databases import migrated
from tests.support.deaths import killed_between_rounds
from tests.support.runs import everything, get, rows_of, submit

from drivecal.api.results.document import results_of
from drivecal.api.tables.ranking import solution_pages, variants_of
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.results.front import StoredRanking
from drivecal.contracts.work import Cell, CellResult
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

HEAVY = {"vehicle": {"parameters": {"mass": 1500.0}}}
VARIANTS = {"eu": {"scenarios": ["S1", "S2"]}, "us": {"weights": {"S3": 3.0}, **HEAVY}, "jp": {"scenarios": ["S2"], **HEAVY}}
SHARES = {"eu": {"S1": 0.5, "S2": 0.5}, "us": {"S1@us": 0.2, "S2@us": 0.2, "S3@us": 0.6}, "jp": {"S2@us": 1.0}}
SURROGATE: dict[str, Any] = {"optimizer": {"kind": "surrogate"}, "budget": {"simulations": 47}, "reduction": {"mode": "exact"}}
GENETIC: dict[str, Any] = {"optimizer": {"kind": "genetic", "population": 20, "iterations": 4}, "reduction": {"mode": "exact"}}


def by_mass(setup: Any, cell: Cell) -> CellResult:
    shift = 0.25 * (setup.varied["mass"] == 1500.0)
    return computed(setup.scenario, Cell(cell.id, {**cell.parameters, "P1": (cell.parameters["P1"] + shift) % 1.0}))


def carried_out(database: Database, workers: int = 1, deaths: Sequence[int] = (), **changes: Any) -> StoredCampaign:
    campaign = submit(database, variants=VARIANTS, likeness="a", **changes)
    killed_between_rounds(database, campaign, deaths, lambda: ComputedBackend(workers, driven=by_mass, count=workers))
    return get(database, campaign)


@pytest.mark.parametrize(("search", "common"), [(SURROGATE, "mean"), (GENETIC, "worst")], ids=["cells", "population"])
def test_each_variant_has_its_best_set(database: Database, search: dict[str, Any], common: str) -> None:
    ended = carried_out(database, common=common, **search)
    resolved = resolved_spec(ended)
    stored = StoredRanking(database, ended, resolved)
    by_set: dict[int, dict[str, float]] = {}
    assert list(resolved.weights) == ["S1", "S1@us", "S2", "S2@us", "S3@us"], "jp shares the vehicle of us"
    for row in rows_of(database, ended):
        by_set.setdefault(row.parameter_set_id, {})[row.scenario] = float(row.score or 0)
    known = {
        name: {each: sum(w * cells[s] for s, w in own.items()) for each, cells in by_set.items() if own.keys() <= cells.keys()}
        for name, own in SHARES.items()
    }
    combined = [[own[each] for own in known.values()] for each, cells in by_set.items() if len(cells) == 5]
    [asked] = [each.numbers["asked"] for each in results_of(stored).trust.verdicts if each.code == "seen"]
    assert asked == str(len(by_set))
    assert ended.best is not None
    assert ended.best.objective == pytest.approx(max(min(each) if common == "worst" else sum(each) / 3 for each in combined))
    for found in variants_of(stored):
        assert found.scenarios == pytest.approx(SHARES[found.name])
        assert found.best is not None
        assert found.best.objective == pytest.approx(max(known[found.name].values()))
        assert found.cost == pytest.approx(found.best.objective - (found.common or 0))
        assert solution_pages(StoredRanking(database, ended, resolved.of_variant(found.name))).solutions(0, 1) == [found.best]


@pytest.mark.slow
def test_variants_depend_on_no_worker_and_no_kill_and_use_the_budget_exactly(tmp_path: Path) -> None:
    outcomes = []
    for workers, deaths in ((1, ()), (8, (3,))):
        database = migrated(f"sqlite:///{tmp_path / f'{workers}.db'}")
        ended = carried_out(database, workers, deaths, **SURROGATE)
        outcomes.append(everything(database, ended))
        assert ended.cells.requested == 47
    assert outcomes[0] == outcomes[1]
