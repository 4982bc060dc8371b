"""Influence maps, posted or found by an analysis: checked, stored with the space that they speak of, and read back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

from sqlalchemy import Connection

from drivecal.campaigns.resolve.problem import CalibrationProblem, catalogue_scenarios
from drivecal.campaigns.resolve.spaces import search_parameters, space_from_document, space_to_document
from drivecal.contracts.specification import InfluenceMapSpecification, InfluenceSpecification
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.influence import Influence, InfluenceMap
from drivecal.domain.parameters import Parameter, decimal, text
from drivecal.plugins import registry
from drivecal.sensitivity.scenario import ScenarioInfluence
from drivecal.storage.engine.types import finite
from drivecal.storage.references import influence_maps
from drivecal.storage.references.influence_maps import StoredInfluenceMap

EXPERT = "expert"
"""The source of the maps that users post."""


@dataclass(frozen=True, slots=True)
class PostedMap:
    """A map from expert knowledge that was found to be right."""

    specification: InfluenceMapSpecification
    influence_map: InfluenceMap
    space: tuple[Parameter, ...]
    """What its bounds were checked against."""


def resolve_map(specification: InfluenceMapSpecification) -> PostedMap:
    """The map that a user posted. Raises InvalidInputError naming every scenario, parameter and bound that does not fit."""
    function = registry.driving_function(specification.driving_function)
    scenarios = catalogue_scenarios(specification.catalogue)
    space = search_parameters(specification.parameters, function)
    parameters = {parameter.name: parameter for parameter in space}
    problems: list[Problem] = []
    found: dict[str, dict[str, Influence]] = {}
    for scenario, listed in specification.scenarios.items():
        if scenario not in scenarios:
            problems.append(Problem(f"scenarios.{scenario}", "there is no such scenario", f"one of {', '.join(scenarios)}"))
            continue
        found[scenario] = {}
        for name, given in listed.items():
            where = f"scenarios.{scenario}.{name}"
            if name not in parameters:
                problems.append(Problem(where, "there is no such parameter", f"one of {', '.join(parameters)}"))
                continue
            try:
                found[scenario][name] = _influence(given, parameters[name], where)
            except InvalidInputError as error:
                problems.extend(error.problems)
    if problems:
        raise InvalidInputError(*problems)
    return PostedMap(specification, InfluenceMap(found), space)


def store_posted_map(connection: Connection, posted: PostedMap) -> StoredInfluenceMap:
    """Stores a map from expert knowledge."""
    return influence_maps.insert(
        connection,
        name=posted.specification.name,
        source=EXPERT,
        driving_function=posted.specification.driving_function,
        parameters=space_to_document(posted.space),
        scenarios=map_to_document(posted.influence_map),
    )


def _influence(given: InfluenceSpecification, parameter: Parameter, where: str) -> Influence:
    if not given.influential:
        if given.lower is not None or given.upper is not None:
            raise InvalidInputError(
                Problem(where, "bounds make no sense where nothing is influential", "leave lower and upper out")
            )
        return Influence(influential=False)
    lower = None if given.lower is None else decimal(given.lower)
    upper = None if given.upper is None else decimal(given.upper)
    problems: list[Problem] = []
    for attribute, value in (("lower", lower), ("upper", upper)):
        if value is not None:
            try:
                parameter.index(value, f"{where}.{attribute}")
            except InvalidInputError as error:
                problems.extend(error.problems)
    if not problems and lower is not None and upper is not None and lower > upper:
        problems.append(Problem(f"{where}.lower", f"{text(lower)} lies above upper {text(upper)}", "exchange them"))
    if problems:
        raise InvalidInputError(*problems)
    return Influence(influential=True, lower=lower, upper=upper)


def check_basis(stored: StoredInfluenceMap, problem: CalibrationProblem) -> None:
    """Raises InvalidInputError where a map that an analysis made does not hold for a campaign: of another setup, evaluator or space.

    Maps that users post rest on what they know, and are not checked here.
    """
    basis = stored.basis
    if basis is None:
        return
    found: list[str] = []
    fingerprints = {scenario: setup.fingerprint for scenario, setup in problem.bench.setups.items()}
    other = [one for one, fingerprint in fingerprints.items() if basis["setups"].get(one, fingerprint) != fingerprint]
    if other:
        found.append(f"it was made with another setup (version, vehicle or simulator) of {', '.join(other)}")
    if basis["evaluator"] != problem.bench.evaluator_id:
        found.append(f"it was made for the evaluator {basis['evaluator']}, not {problem.bench.evaluator_id}")
    for name, value in basis["fixed"].items():
        if name not in problem.space.fixed or text(problem.space.fixed[name]) != value:
            found.append(f"it was made with {name} held at {value}")
    ranges = _ranges(stored)
    for parameter in problem.space.searched:
        lower, upper = ranges.get(parameter.name, (parameter.lower, parameter.upper))
        if parameter.lower < lower or parameter.upper > upper:
            found.append(f"it covers {parameter.name} from {text(lower)} to {text(upper)} only")
    if found:
        remedy = "name another map, or leave `map` out to have one made"
        raise InvalidInputError(*(Problem("sensitivity.map", f"the map does not hold here: {one}", remedy) for one in found))


def map_to_document(influence_map: InfluenceMap) -> dict[str, Any]:
    """JSON-ready and exact: bounds as decimal texts."""
    return {
        scenario: {
            name: {
                "influential": influence.influential,
                "lower": None if influence.lower is None else text(influence.lower),
                "upper": None if influence.upper is None else text(influence.upper),
            }
            for name, influence in listed.items()
        }
        for scenario, listed in influence_map.scenarios.items()
    }


def analysis_to_document(found: Mapping[str, ScenarioInfluence]) -> dict[str, Any]:
    """What an analysis found, as `map_to_document` writes it, with the measures of each parameter beside its bounds."""
    bounds = map_to_document(
        InfluenceMap(
            {scenario: {name: one.influence for name, one in found[scenario].parameters.items()} for scenario in found}
        )
    )
    for scenario, listed in found.items():
        for name, one in listed.parameters.items():
            overall = None if one.overall is None else one.overall.measures
            bounds[scenario][name] |= {
                "unknown": listed.unknown,
                "s_rel_intervals": [finite(value) for value in one.s_rel_intervals],
                "mu": None if overall is None else finite(overall.mu),
                "sigma": None if overall is None else finite(overall.sigma),
                "mu_star": None if overall is None else finite(overall.mu_star),
            }
    return bounds


def smallest_s_rel(found: Mapping[str, ScenarioInfluence]) -> dict[str, dict[str, float | None]]:
    """By scenario, of its intervals and of its global analysis: the smallest s_rel that is not 0, below which a threshold means any
    change at all; None where all are 0."""
    return {
        scenario: {"intervals": one.smallest_interval_s_rel, "overall": one.smallest_overall_s_rel}
        for scenario, one in found.items()
    }


def stored_map(stored: StoredInfluenceMap) -> InfluenceMap:
    """A map as it was stored, with the ranges that it speaks of: those it was made in, or checked against."""
    held = {} if stored.basis is None else stored.basis["fixed"]
    ranges = _ranges(stored) | {name: (Decimal(value), Decimal(value)) for name, value in held.items()}
    return InfluenceMap(map_from_document(stored.scenarios).scenarios, ranges)


def _ranges(stored: StoredInfluenceMap) -> dict[str, tuple[Decimal, Decimal]]:
    return {parameter.name: (parameter.lower, parameter.upper) for parameter in space_from_document(stored.parameters)}


def map_from_document(document: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> InfluenceMap:
    """The inverse of `map_to_document`."""

    def bound(value: str | None) -> Decimal | None:
        return None if value is None else Decimal(value)

    return InfluenceMap(
        {
            scenario: {
                name: Influence(one["influential"], bound(one["lower"]), bound(one["upper"])) for name, one in listed.items()
            }
            for scenario, listed in document.items()
        }
    )
