"""The built-in motorway as a problem, and its scenarios S1..S6 as a catalogue. Light enough for the coordinator."""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

from drivecal.bundles.highway import Scenario, TaskScenario
from drivecal.bundles.installed import installed_problems
from drivecal.plugins import registry

FOLDER = Path(__file__).with_name("problem")
"""The problem `highway` as `drivecal problem push` takes problems: `problem.yaml` and the networks of its scenarios."""
RANDOM_FOLDER = FOLDER.with_name("random_problem")
"""The problem `highway-random`: the same scenarios with random traffic, S1r..S6r."""


def scenario_of(scenario: str, data: Mapping[str, Any], folder: Path) -> Scenario:
    """Returns a scenario: of an installed catalogue, or of the problem's own data and files.

    Args:
        scenario: its id.
        data: its data.
        folder: the problem's files.

    Raises:
        InvalidInputError: its catalogue is not installed.
    """
    if "catalogue" in data:
        return registry.catalogue(data["catalogue"]).scenarios[scenario]
    declared = TaskScenario.model_validate(data)
    network = (folder / declared.network).read_bytes()
    same = {field: getattr(declared, field) for field in ("title", "rated_as", "duration", "step", "ego", "task", "seed")}
    return Scenario(id=scenario, network=network, route=tuple(declared.route), traffic=tuple(declared.traffic), **same)


class HighwayCatalogue:
    """The scenarios S1..S6, each with its installed network file (`ports.Catalogue`)."""

    name = "highway"

    @cached_property
    def scenarios(self) -> Mapping[str, Scenario]:
        """Scenarios by id, in the order of the paper's Section IV-A."""
        declared = installed_problems()[self.name].manifest.scenarios
        return MappingProxyType({name: scenario_of(name, data, FOLDER) for name, data in declared.items()})


HIGHWAY = HighwayCatalogue()
