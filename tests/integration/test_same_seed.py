"""The same seed gives the same campaign, by whatever optimizer it searches."""

from pathlib import Path
from typing import Any

import pytest
from tests.support.databases import migrated
from tests.support.runs import everything, run, submit


@pytest.mark.slow("random", "cma_es", "optuna", "nsga2")
@pytest.mark.parametrize(
    "optimizer",
    [
        {"kind": "genetic"},
        {"kind": "surrogate"},
        {"kind": "swarm"},
        {"kind": "random"},
        {"kind": "cma_es"},
        {"kind": "optuna", "sampler": "tpe"},
        {"kind": "nsga2"},
    ],
    ids=lambda optimizer: str(optimizer["kind"]),
)
def test_the_same_seed_gives_the_same_campaign(tmp_path: Path, optimizer: dict[str, Any]) -> None:
    def searched(name: str, seed: int) -> tuple[Any, ...]:
        database = migrated(f"sqlite:///{tmp_path / name}.db")
        size = {} if optimizer["kind"] == "surrogate" else {"population": 12, "iterations": 4}
        budget = None if size else {"simulations": 60}
        chosen = submit(database, optimizer=optimizer | size | {"seed": seed}, budget=budget, reduction={"mode": "exact"})
        results = everything(database, run(database, chosen))
        database.dispose()
        return results

    first = searched("first", 3)
    assert searched("again", 3) == first
    assert searched("other", 4)[0] != first[0]
