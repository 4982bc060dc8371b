"""Descriptions of a campaign's parameters and scenarios: of a bundle as its manifest says, else as the plug-ins do."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import Connection

from drivecal.bundles.manifest import Manifest
from drivecal.campaigns.resolve import resolvers
from drivecal.campaigns.resolve.diagnostics import Diagnostics
from drivecal.contracts.specification import HIGHWAY
from drivecal.domain.errors import InvalidInputError, NotFoundError
from drivecal.plugins import registry
from drivecal.storage import bundles


@dataclass(frozen=True)
class Meanings:
    """Descriptions of parameters and titles of scenarios, by name, if there are any."""

    parameters: Mapping[str, str] = field(default_factory=dict)
    scenarios: Mapping[str, str] = field(default_factory=dict)


def meanings(connection: Connection, spec: Mapping[str, Any]) -> Meanings:
    """Returns the meanings for a stored specification. A plug-in or bundle that is gone leaves no words, and no error."""
    if spec.get("problem", HIGHWAY) == HIGHWAY:
        return Meanings(_of_function(spec.get("driving_function")), _titles(spec.get("catalogue")))
    try:
        manifest = Manifest.model_validate(bundles.named(connection, spec["problem"]).manifest)
    except NotFoundError:
        return Meanings()
    return Meanings({name: entry.description for name, entry in manifest.parameters.items()})


def _of_function(name: str | None) -> dict[str, str]:
    try:
        spaces = {} if name is None else registry.driving_function(name).spaces
    except InvalidInputError:
        return {}
    return {parameter.name: parameter.description for space in spaces.values() for parameter in space}


def _titles(catalogue: str | list[str] | None) -> dict[str, str]:
    scenarios = {} if catalogue is None else resolvers.find_scenarios(catalogue, Diagnostics())
    return {name: scenario.title for name, (_, scenario) in scenarios.items()}
