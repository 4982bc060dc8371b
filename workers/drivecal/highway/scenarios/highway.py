"""Plug-in of the built-in catalogue, S1..S6 with their networks. Light enough for the coordinator."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from importlib import resources
from types import MappingProxyType

from drivecal.domain.scenarios import Scenario
from drivecal.highway.scenarios.definitions import DEFINITIONS


def network_name(scenario: Scenario) -> str:
    """Returns the file name of a built-in scenario's network."""
    return f"{scenario.id}.net.xml"


class HighwayCatalogue:
    """The scenarios S1..S6, each with its installed network file (`ports.Catalogue`)."""

    name = "highway"

    @cached_property
    def scenarios(self) -> Mapping[str, Scenario]:
        """Scenarios by id, in the order of the paper's Section IV-A."""
        networks = resources.files("drivecal.highway.scenarios") / "networks"
        return MappingProxyType(
            {
                scenario.id: replace(scenario, network=(networks / network_name(scenario)).read_bytes())
                for scenario in DEFINITIONS
            }
        )


HIGHWAY = HighwayCatalogue()
