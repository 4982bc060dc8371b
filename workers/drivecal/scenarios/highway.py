"""The built-in catalogue: `HIGHWAY` = S1..S6 with their networks. Light: the coordinator loads it too."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from importlib import resources
from types import MappingProxyType

from drivecal.domain.scenarios import Scenario
from drivecal.scenarios.definitions import DEFINITIONS


def network_name(scenario: Scenario) -> str:
    """The file name of a built-in scenario's network."""
    return f"{scenario.id}.net.xml"


class HighwayCatalogue:
    """S1..S6, each with the network file that is part of the installation (`ports.Catalogue`)."""

    name = "highway"

    @cached_property
    def scenarios(self) -> Mapping[str, Scenario]:
        """By id, in the order of the paper's Section IV-A."""
        networks = resources.files("drivecal.scenarios") / "networks"
        return MappingProxyType(
            {
                scenario.id: replace(scenario, network=(networks / network_name(scenario)).read_bytes())
                for scenario in DEFINITIONS
            }
        )


HIGHWAY = HighwayCatalogue()
