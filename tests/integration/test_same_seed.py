"""The same seed gives the same campaign, by whatever optimizer it searches. More of searches by the cell: `test_cell_search.py`."""

from pathlib import Path
from typing import Any

import pytest
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.runs import WITH_ANALYSIS, everything, influenced, run, submit

from drivecal.domain.campaigns import StageName


@pytest.mark.slow("random", "cma_es", "swarm", "surrogate")
@pytest.mark.parametrize("kind", ["genetic", "surrogate", "swarm", "random", "cma_es"])
def test_the_same_seed_gives_the_same_campaign(tmp_path: Path, kind: str) -> None:
    def searched(name: str, seed: int) -> tuple[Any, ...]:
        database = migrated(f"sqlite:///{tmp_path / name}.db")
        size = {} if kind == "surrogate" else {"population": 12, "iterations": 4}
        budget = None if size else {"simulations": 60}
        optimizer = {"kind": kind, "seed": seed} | size
        chosen = submit(database, optimizer=optimizer, budget=budget, reduction={"mode": "exact"})
        results = everything(database, run(database, chosen))
        database.dispose()
        return results

    first = searched("first", 3)
    assert searched("again", 3) == first
    assert searched("other", 4)[0] != first[0]


@pytest.mark.slow("without lots")
@pytest.mark.parametrize("limit", [1, 0.2], ids=["without lots", "with lots"])
def test_the_same_campaign_again_simulates_nothing(tmp_path: Path, limit: float) -> None:
    database = migrated(f"sqlite:///{tmp_path / 'drivecal.db'}")
    spec = WITH_ANALYSIS | {"reduction": {"mode": "influence", "audit": 0.1, "max_error": limit}}
    first, again = (run(database, submit(database, likeness="a", **spec), ComputedBackend(answer=influenced)) for _ in range(2))
    assert first.cells.reused > 0
    assert (again.cells.runs, again.cells.simulated, again.counts(StageName.SENSITIVITY).runs) == (0, 0, 0)
    assert (again.best, again.cells.requested, again.cells.reused) == (first.best, first.cells.requested, first.cells.reused)
    database.dispose()
