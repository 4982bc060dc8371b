"""Influence maps: per scenario and parameter, where a change can change the score (P_sens and PB_sens of the paper)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal


@dataclass(frozen=True, slots=True)
class Influence:
    """Of one parameter in one scenario.

    `influential` is P_sens; [`lower`, `upper`] is PB_sens, inclusive, in parameter units; None is the space's own bound.
    Values below `lower` form one non-influential region, values above `upper` another.
    """

    influential: bool
    lower: Decimal | None = None
    upper: Decimal | None = None


EVERYWHERE = Influence(influential=True)
"""What holds for a parameter or a scenario of which a map says nothing: any change may matter."""


@dataclass(frozen=True, slots=True)
class InfluenceMap:
    """Influences by scenario id, then by parameter name. What is not listed counts as influential everywhere.

    `ranges`: the values by parameter that the map speaks of, from lowest to highest; of values outside it says nothing, so any change
    there may matter. A parameter that is not in it has no limits.
    """

    scenarios: Mapping[str, Mapping[str, Influence]]
    ranges: Mapping[str, tuple[Decimal, Decimal]] = field(default_factory=dict)

    def influence(self, scenario: str, parameter: str) -> Influence:
        """The influence of one parameter in one scenario."""
        return self.scenarios.get(scenario, {}).get(parameter, EVERYWHERE)
