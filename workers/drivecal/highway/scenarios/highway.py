"""Plug-in of the built-in catalogue, S1..S6 with their networks. Light enough for the coordinator."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from importlib import resources
from types import MappingProxyType

from drivecal.domain.scenarios import Scenario
from drivecal.highway.scenarios.definitions import DEFINITIONS


class HighwayCatalogue:
    """The scenarios S1..S6, each with its installed network file (`ports.Catalogue`)."""

    name = "highway"

    @cached_property
    def scenarios(self) -> Mapping[str, Scenario]:
        """Scenarios by id, in the order of the paper's Section IV-A."""
        return MappingProxyType({scenario.id: _on_its_road(scenario) for scenario in DEFINITIONS})


def _on_its_road(scenario: Scenario) -> Scenario:
    from drivecal.roads.carriageway import carriageway  # scipy is not for those who only name the catalogue

    name = f"{scenario.id}.net.xml"
    network = (resources.files("drivecal.highway.scenarios") / "networks" / name).read_bytes()
    return replace(scenario, network=network, road=carriageway(network, scenario.route, name))


HIGHWAY = HighwayCatalogue()
