"""Influence maps: the ranges, by scenario and parameter, where a change can change the score (P_sens, PB_sens of the paper)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal


@dataclass(frozen=True, slots=True)
class Influence:
    """Influence of one parameter in one scenario.

    `influential` is P_sens; [`lower`, `upper`] is PB_sens, inclusive, in parameter units; None stands for the bound of the space.
    Values below `lower` form one non-influential region, values above `upper` another.
    """

    influential: bool
    lower: Decimal | None = None
    upper: Decimal | None = None


EVERYWHERE = Influence(influential=True)
"""Influence of a parameter or scenario that a map does not list: any change may matter."""


@dataclass(frozen=True, slots=True)
class InfluenceMap:
    """Influences by scenario id, then by parameter name. Unlisted parameters count as influential everywhere.

    `ranges`: lowest and highest analysed value by parameter; `choices`: the analysed texts of a choice. Outside of them any change of a
    parameter may matter. A parameter without an entry has no limits.
    """

    scenarios: Mapping[str, Mapping[str, Influence]]
    ranges: Mapping[str, tuple[Decimal, Decimal]] = field(default_factory=dict)
    choices: Mapping[str, frozenset[str]] = field(default_factory=dict)

    def influence(self, scenario: str, parameter: str) -> Influence:
        """Returns the influence of one parameter in one scenario, `EVERYWHERE` if the map does not list it."""
        return self.scenarios.get(scenario, {}).get(parameter, EVERYWHERE)
