"""Influence maps from expert knowledge: checked against the grid of the parameters they speak of, and written back for storage."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from math import isfinite
from typing import Any

from drivecal.campaigns.problem import CalibrationProblem, catalogue_scenarios
from drivecal.campaigns.spaces import search_parameters
from drivecal.contracts.specification import InfluenceMapSpecification, InfluenceSpecification, ParameterSpecification
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.influence import Influence, InfluenceMap
from drivecal.domain.parameters import Parameter, decimal, text
from drivecal.plugins import registry
from drivecal.sensitivity.scenario import ScenarioInfluence
from drivecal.storage.influence_maps import StoredInfluenceMap


def resolve_map(specification: InfluenceMapSpecification) -> InfluenceMap:
    """The map that a user posted. Raises InvalidInputError naming every scenario, parameter and bound that does not fit."""
    function = registry.driving_function(specification.driving_function)
    scenarios = catalogue_scenarios(specification.catalogue)
    parameters = {parameter.name: parameter for parameter in search_parameters(specification.parameters, function)}
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
    return InfluenceMap(found)


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


def check_basis(basis: Mapping[str, Any] | None, problem: CalibrationProblem) -> None:
    """Raises InvalidInputError where a map that an analysis made does not hold for a campaign: of another setup, evaluator or space.

    Maps that users post rest on what they know, and are not checked here.
    """
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
    ranges = {one["name"]: (Decimal(one["lower"]), Decimal(one["upper"])) for one in basis["space"]}
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
                "s_rel_intervals": [_finite(value) for value in one.s_rel_intervals],
                "mu": None if overall is None else _finite(overall.mu),
                "sigma": None if overall is None else _finite(overall.sigma),
                "mu_star": None if overall is None else _finite(overall.mu_star),
            }
    return bounds


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None


def stored_map(stored: StoredInfluenceMap) -> InfluenceMap:
    """A map as it was stored, with the ranges that it speaks of: those it was made in, or checked against.

    Raises InvalidInputError where the space that a posted map names is not installed any more.
    """
    found = map_from_document(stored.scenarios)
    if stored.basis is not None:
        ranges = {one["name"]: (Decimal(one["lower"]), Decimal(one["upper"])) for one in stored.basis["space"]}
        ranges |= {name: (Decimal(value), Decimal(value)) for name, value in stored.basis["fixed"].items()}
        return InfluenceMap(found.scenarios, ranges)
    listed = stored.parameters
    if not isinstance(listed, str):
        listed = [ParameterSpecification.model_validate(one) for one in listed]
    space = search_parameters(listed, registry.driving_function(stored.driving_function))
    return InfluenceMap(found.scenarios, {one.name: (one.lower, one.upper) for one in space})


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
