"""Comparisons as the tests submit them."""

from __future__ import annotations

from typing import Any

from tests.support.runs import EXPERT_SPACE

from drivecal.campaigns.comparisons.resolve import queue, resolve_comparison
from drivecal.contracts.comparison import ComparisonSpecification
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

TWO_OPTIMIZERS: dict[str, Any] = {
    "parameters": EXPERT_SPACE,
    "catalogue": ["S1", "S2"],
    "optimizers": [{"kind": "genetic", "mutation": 0.2}, {"kind": "swarm"}],
    "populations": [6, 9],
    "seeds": [1, 2, 3],
    "iterations": 3,
}


def submit_comparison(database: Database, stored_map: str | None = None, **changes: Any) -> StoredCampaign:
    """Queues `TWO_OPTIMIZERS` with changes, on a stored map where one is given."""
    document = TWO_OPTIMIZERS | changes
    if stored_map is not None:
        document["sensitivity"] = {"map": stored_map}
    problem = resolve_comparison(ComparisonSpecification.model_validate(document))
    with database.transaction() as connection:
        return queue(connection, problem, stored_map)


def runs_of(database: Database, comparison: StoredCampaign) -> list[StoredCampaign]:
    """The runs of a comparison as they are now."""
    with database.read() as connection:
        return campaigns.runs_of(connection, comparison.sequence)
