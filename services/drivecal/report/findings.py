"""Everything a report is made of, asked of the server."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from drivecal.client.client import Client
from drivecal.contracts.accounting import Accounting
from drivecal.contracts.campaign import Campaign, Generation, Solution
from drivecal.contracts.inventory import InfluenceRow

SOLUTIONS = 20
"""The best sets that are shown; all of them are in the table."""


@dataclass(frozen=True, slots=True)
class Findings:
    """A campaign with what it found. `basis`: what its influence map rests on, None where it has none or a user posted it; `accounting`:
    None before the first answered cell; `titles`: of scenarios, by id."""

    campaign: Campaign
    generations: Sequence[Generation]
    solutions: Sequence[Solution]
    influence: Sequence[InfluenceRow]
    basis: Mapping[str, Any] | None
    titles: Mapping[str, str]
    accounting: Accounting | None


def collect(client: Client, identifier: str) -> Findings:
    """Asks for it. Raises NotFoundError for an unknown campaign, and whatever else the client raises."""
    campaign = client.campaign(identifier)
    used = client.map_of(campaign)
    answered = campaign.cells.requested or campaign.sensitivity_cells.requested
    return Findings(
        campaign=campaign,
        generations=[Generation.model_validate(row) for row in client.rows(identifier, "generations")],
        solutions=client.solutions(identifier, limit=SOLUTIONS).items,
        influence=client.influence(identifier),
        basis=None if used is None else used.basis,
        titles={scenario.id: scenario.title for scenario in client.scenarios().items},
        accounting=client.accounting(identifier) if answered else None,
    )
