"""The built-in motorway as a problem, and its scenarios S1..S6 as a catalogue. Light enough for the coordinator."""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

from drivecal.bundles.highway import TaskScenario
from drivecal.bundles.installed import installed_problems
from drivecal.domain.scenarios import Scenario

FOLDER = Path(__file__).parents[1] / "problem"
"""The problem `highway` as `drivecal problem push` takes problems: `problem.yaml` and the networks of its scenarios."""
RANDOM_FOLDER = FOLDER.with_name("random_problem")
"""The problem `highway-random`: the same scenarios with random traffic, S1r..S6r."""


class HighwayCatalogue:
    """The scenarios S1..S6, each with its installed network file (`ports.Catalogue`)."""

    name = "highway"

    @cached_property
    def scenarios(self) -> Mapping[str, Scenario]:
        """Scenarios by id, in the order of the paper's Section IV-A."""
        declared = installed_problems()[self.name].manifest.scenarios
        scenarios = {name: TaskScenario.model_validate(data) for name, data in declared.items()}
        networks = {name: (FOLDER / scenario.network).read_bytes() for name, scenario in scenarios.items()}
        return MappingProxyType({name: scenario.on(name, networks[name]) for name, scenario in scenarios.items()})


HIGHWAY = HighwayCatalogue()
