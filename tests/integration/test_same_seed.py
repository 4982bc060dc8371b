"""The same campaign again, with its sensitivity analysis and reuse by references."""

from pathlib import Path

import pytest
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.runs import WITH_ANALYSIS, influenced, run, submit

from drivecal.domain.campaigns import StageName


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
