"""Comparisons as the tests submit them."""

from typing import Any
from uuid import uuid4

from tests.support.computed import ComputedBackend
from tests.support.problems import LIMITS
from tests.support.runs import EXPERT_SPACE, dispatcher

from drivecal.api import submission
from drivecal.campaigns.comparison import compared
from drivecal.contracts.comparison import Comparison, ComparisonSpecification
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


def submit_comparison(database: Database, stored_map: str | None = None, **changes: Any) -> str:
    """Queues `TWO_OPTIMIZERS` with changes, on a stored map if one is given; returns the tag."""
    document = TWO_OPTIMIZERS | changes
    if stored_map is not None:
        document["sensitivity"] = {"map": stored_map}
    return submission.compare(database, LIMITS, ComparisonSpecification.model_validate(document), uuid4().hex)


def runs_of(database: Database, tag: str) -> list[StoredCampaign]:
    """The campaigns of a comparison as they are now, in order."""
    with database.read() as connection:
        return campaigns.page(connection, limit=1000, conditions=campaigns.having([tag]))[0][::-1]


def read_comparison(database: Database, tag: str) -> Comparison:
    """The analysis of the campaigns as they are now."""
    with database.read() as connection:
        return compared(connection, tag)


def finish_comparison(database: Database, tag: str, backend: ComputedBackend | None = None) -> Comparison:
    """Works until all campaigns of a comparison have ended, successfully or not."""
    working = dispatcher(database, backend or ComputedBackend())
    while not all(campaign.state.ended for campaign in runs_of(database, tag)):
        working.step()
    return read_comparison(database, tag)
