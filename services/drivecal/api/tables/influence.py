"""The rows of influence maps, for a campaign's scenarios and space or as a map has them."""

from collections.abc import Mapping
from decimal import Decimal
from typing import Any

from drivecal.campaigns.resolve.maps import map_from_document
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec
from drivecal.campaigns.resolve.spaces import space_from_document
from drivecal.contracts.tables import InfluenceRow
from drivecal.domain.influence import Influence
from drivecal.domain.parameters import Parameter
from drivecal.storage.references.influence_maps import StoredInfluenceMap

MEASURES = ("s_rel_intervals", "mu", "sigma", "mu_star")
NOT_LISTED = "the map does not list it, so it counts as influential"


def campaign_rows(stored: StoredInfluenceMap, resolved: ResolvedSpec) -> list[InfluenceRow]:
    """Returns a map for a campaign: its scenarios and searched parameters, within the bounds of its search."""
    influence_map = map_from_document(stored.scenarios)
    return [
        _row(stored, scenario, parameter.name, influence_map.influence(scenario, parameter.name), parameter)
        for scenario in resolved.weights
        for parameter in resolved.space.searched
    ]


def map_rows(stored: StoredInfluenceMap) -> list[InfluenceRow]:
    """Returns the rows of a map within the bounds of its own space."""
    space = {parameter.name: parameter for parameter in space_from_document(stored.parameters)}
    return [
        _row(stored, scenario, name, influence, space.get(name))
        for scenario, listed in map_from_document(stored.scenarios).scenarios.items()
        for name, influence in listed.items()
    ]


def _row(
    stored: StoredInfluenceMap, scenario: str, name: str, influence: Influence, parameter: Parameter | None
) -> InfluenceRow:
    entry: Mapping[str, Any] | None = stored.scenarios.get(scenario, {}).get(name)
    influential, lower, upper = _bounds(influence, parameter)
    return InfluenceRow(
        scenario=scenario,
        parameter=name,
        influential=influential,
        lower=None if lower is None else float(lower),
        upper=None if upper is None else float(upper),
        **{measure: None if entry is None else entry.get(measure) for measure in MEASURES},
        unknown=entry is None or entry.get("unknown", False),
        unit=None if parameter is None else parameter.unit,
        space_lower=None if parameter is None else float(parameter.lower),
        space_upper=None if parameter is None else float(parameter.upper),
        n_values=None if parameter is None else parameter.n_values,
        **_decided(stored, entry, outside=influence.influential and not influential),
    )


def _decided(stored: StoredInfluenceMap, entry: Mapping[str, Any] | None, *, outside: bool) -> dict[str, Any]:
    """Returns what decided about a row, and the reason. `outside`: the campaign's space holds none of the influential range."""
    if entry is None:
        return {"decided_by": "unknown", "reason": NOT_LISTED}
    if outside:
        ends = ["its bound" if entry[end] is None else entry[end] for end in ("lower", "upper")]
        return {
            "decided_by": "space",
            "reason": f"the influential range, {ends[0]} to {ends[1]}, lies outside of the campaign's",
        }
    if stored.basis is None:
        return {"decided_by": "posted", "reason": "the posted map says so"}
    return {"decided_by": entry.get("decided_by"), "reason": entry.get("reason")}


def _bounds(influence: Influence, parameter: Parameter | None) -> tuple[bool, Decimal | None, Decimal | None]:
    """Returns P_sens and PB_sens within the parameter's bounds. Nothing is influential if these lie outside the influential region."""
    lower, upper = influence.lower, influence.upper
    if parameter is not None:
        lower = parameter.lower if lower is None else max(lower, parameter.lower)
        upper = parameter.upper if upper is None else min(upper, parameter.upper)
    if not influence.influential or (lower is not None and upper is not None and lower > upper):
        return False, None, None
    return True, lower, upper
