"""Influence maps, posted or made by an analysis: checked, stored with their space, and read back."""

from collections.abc import Mapping
from datetime import datetime
from functools import partial
from typing import Any

from pydantic import TypeAdapter
from sqlalchemy import Connection

from drivecal.analysis.replicates import rate_bounds
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.spaces import (
    covers,
    fixed_from_document,
    fixed_to_document,
    search_parameters,
    space_from_document,
    space_to_document,
)
from drivecal.campaigns.resolve.workbench import BundleSource, find_workbench, installed_bundles
from drivecal.contracts.specification import (
    InfluenceMapSpecification,
    InfluenceSpecification,
    MapReference,
    ProblemSpecification,
    ReductionSpecification,
)
from drivecal.domain.errors import Diagnostics, InvalidInputError, Problem
from drivecal.domain.influence import Influence, InfluenceMap
from drivecal.domain.parameters import Parameter
from drivecal.domain.scales import Scale
from drivecal.domain.values import decimal, shown, text
from drivecal.sensitivity.scenario import ScenarioInfluence, decided_by
from drivecal.storage.engine.types import finite
from drivecal.storage.references.influence_maps import StoredInfluenceMap
from drivecal.storage.studies import MapError, errors_of_map

EXPERT = "expert"
"""The source of the maps that users post."""


def resolve_map(specification: InfluenceMapSpecification, bundles: BundleSource = installed_bundles) -> dict[str, Any]:
    """Returns what `influence_maps.insert` stores of a map from expert knowledge.

    Raises InvalidInputError for every scenario, parameter and bound that does not fit.
    """
    diagnostics = Diagnostics()
    wanted = ProblemSpecification.model_validate(specification.model_dump(include={"problem", "catalogue", "driving_function"}))
    workbench = find_workbench(wanted, bundles, diagnostics)
    function, scenarios = diagnostics.found(workbench.function), workbench.scenarios
    space = search_parameters(specification.parameters, function)
    parameters = {parameter.name: parameter for parameter in space}
    influences: dict[str, dict[str, Influence]] = {}
    for scenario, listed in specification.scenarios.items():
        if scenario not in scenarios:
            diagnostics.add(f"scenarios.{scenario}", "there is no such scenario", f"one of {', '.join(scenarios)}")
            continue
        influences[scenario] = {}
        for name, given in listed.items():
            where = f"scenarios.{scenario}.{name}"
            if name not in parameters:
                diagnostics.add(where, "there is no such parameter", f"one of {', '.join(parameters)}")
            elif (influence := diagnostics.attempt(partial(_influence, given, parameters[name], where))) is not None:
                influences[scenario][name] = influence
    diagnostics.raise_if_any()
    about = {"name": specification.name, "source": EXPERT, "driving_function": function.name}
    return about | {"parameters": space_to_document(space), "scenarios": map_to_document(InfluenceMap(influences))}


def _influence(given: InfluenceSpecification, parameter: Parameter, where: str) -> Influence:
    if not given.influential:
        if given.lower is not None or given.upper is not None:
            raise InvalidInputError(Problem(where, "bounds need an influential parameter", "leave lower and upper out"))
        return Influence(influential=False)
    if parameter.choices and not given.lower is given.upper is None:
        raise InvalidInputError(Problem(where, "a choice has no bounds", "leave lower and upper out"))
    lower = None if given.lower is None else decimal(given.lower)
    upper = None if given.upper is None else decimal(given.upper)
    diagnostics = Diagnostics()
    for attribute, value in (("lower", lower), ("upper", upper)):
        if value is not None:
            diagnostics.attempt(partial(parameter.index, value, f"{where}.{attribute}"))
    if not diagnostics.problems and lower is not None and upper is not None and lower > upper:
        diagnostics.add(f"{where}.lower", f"{text(lower)} lies above upper {text(upper)}", "exchange them")
    diagnostics.raise_if_any()
    return Influence(influential=True, lower=lower, upper=upper)


def basis_of(problem: CalibrationProblem) -> dict[str, Any]:
    """Returns the conditions of a campaign's own map, so that other campaigns cannot misuse it."""
    return {
        "sensitivity": problem.specification.model_dump(mode="json")["sensitivity"],
        "fixed": fixed_to_document(problem.space.fixed),
        "setups": {scenario: setup.fingerprint for scenario, setup in problem.bench.setups.items()},
        "evaluator": problem.bench.evaluator_id,
        "scale": measure(problem.bench.scale),
        "constraints": sorted(problem.constraints.listed),
    }


def measure(scale: Scale) -> dict[str, float]:
    """Returns the part of a scale that analyses depend on: s_rel are shares of the span, `auto` tolerates changes by the tolerance."""
    return {"tolerance": scale.tolerance, "span": scale.span}


def is_outdated(stored: StoredInfluenceMap, problem: CalibrationProblem) -> bool:
    """Returns whether a map was made from other runs, ratings or measures than a campaign has, or under constraints that it lacks. False
    for posted maps."""
    return stored.basis is not None and bool(_differences(stored.basis, problem))


def _differences(basis: Mapping[str, Any], problem: CalibrationProblem) -> list[str]:
    bench = problem.bench
    reasons: list[str] = []
    fingerprints = {scenario: setup.fingerprint for scenario, setup in bench.setups.items()}
    other = [scenario for scenario, own in fingerprints.items() if basis["setups"].get(scenario, own) != own]
    if other and bench.to_probe is None:  # else it is known only when the campaign starts
        reasons.append(f"it was made with another setup (version, vehicle or simulator) of {', '.join(other)}")
    if basis["evaluator"] != bench.evaluator_id:
        reasons.append(f"it was made for the evaluator {basis['evaluator']}, not {bench.evaluator_id}")
    made, own = basis["scale"], measure(bench.scale)
    reasons += [f"it was made for a {name} of {made[name]:g}, not {own[name]:g}" for name in own if made[name] != own[name]]
    # an analysis knows nothing of the sets that its constraints forbade
    lacking = [text for text in basis["constraints"] if text not in problem.constraints.listed]
    return reasons + [f"it was made under the constraint {text}, which is missing here" for text in lacking]


def check_basis(stored: StoredInfluenceMap, problem: CalibrationProblem) -> None:
    """Raises InvalidInputError if an analysis's map is invalid for a campaign: another setup, evaluator, scale or space, or a constraint
    less.

    Posted maps rest on expert knowledge and are not checked here.
    """
    basis = stored.basis
    if basis is None:
        return
    reasons = _differences(basis, problem)
    for name, value in fixed_from_document(basis["fixed"]).items():
        if problem.space.fixed.get(name) != value:
            reasons.append(f"it was made with {name} held at {shown(value)}")
    covered = {parameter.name: parameter for parameter in space_from_document(stored.parameters)}
    reasons += [
        f"it covers {parameter.name} {covered[parameter.name].extent} only"
        for parameter in problem.space.searched
        if parameter.name in covered and not covers(covered[parameter.name], parameter)
    ]
    if reasons:
        remedy = "name another map, or leave `map` out to have one made"
        raise InvalidInputError(*(Problem("sensitivity.map", f"it does not hold here: {reason}", remedy) for reason in reasons))


def warnings_of(
    connection: Connection, problem: CalibrationProblem, influence_map_id: str | None, before: datetime
) -> list[str]:
    """Returns the `doubts` about the map that a campaign names and uses; none for a map of its own analysis."""
    reduction = problem.specification.reduction
    given = isinstance(problem.specification.sensitivity, MapReference)
    if influence_map_id is None or not given or not reduction.uses_map:
        return []
    return doubts(connection, influence_map_id, reduction.max_error, before)


def doubts(connection: Connection, influence_map_id: str, largest_error: float, before: datetime) -> list[str]:
    """Returns a warning for every scenario whose map is wrong: a validation found more than the share `largest_error` of wrong answers, or
    audits show a larger share at 95 % confidence. Counts campaigns that ended `before`. A `largest_error` of 1 turns inspection off, so the
    default replaces it, as in the light of a campaign."""
    largest_error = largest_error if largest_error < 1 else ReductionSpecification().max_error
    worst: dict[str, MapError] = {}
    for error in errors_of_map(connection, influence_map_id, before):
        surely, _ = rate_bounds(error.wrong, error.compared)
        exceeds = surely > largest_error if error.audited else error.wrong > largest_error * error.compared
        if exceeds:
            known = worst.get(error.scenario)
            if known is None or error.wrong * known.compared > known.wrong * error.compared:
                worst[error.scenario] = error
    return [_doubt(error) for _, error in sorted(worst.items())]


def _doubt(error: MapError) -> str:
    measured = "by audits" if error.audited else "its validation compared"
    return (
        f"the influence map is known to be wrong in {error.scenario}: {error.wrong:,} of {error.compared:,} answers were wrong "
        f"({measured}, campaign {error.campaign}). Correct it, or analyse again with more samples; or use reduction.mode "
        "predicted; and confirm the best sets (reduction.confirm)"
    )


_INFLUENCES = TypeAdapter(Mapping[str, Mapping[str, Influence]])


def map_to_document(influence_map: InfluenceMap) -> Any:
    """JSON-ready and exact: bounds as decimal texts."""
    return _INFLUENCES.dump_python(influence_map.scenarios, mode="json")


def analysis_to_document(analysis: Mapping[str, ScenarioInfluence]) -> dict[str, Any]:
    """Returns an analysis's result in the form of `map_to_document`, with each parameter's measures added to its bounds."""
    influences = {scenario: {name: each.influence for name, each in of.parameters.items()} for scenario, of in analysis.items()}
    bounds: dict[str, Any] = map_to_document(InfluenceMap(influences))
    for scenario, listed in analysis.items():
        for name, parameter in listed.parameters.items():
            overall = None if parameter.overall is None else parameter.overall.measures
            bounds[scenario][name] |= {
                "unknown": listed.unknown,
                "s_rel_intervals": [finite(value) for value in parameter.s_rel_intervals],
                **{name: finite(getattr(overall, name, None)) for name in ("mu", "sigma", "mu_star")},
                "decided_by": decided_by(parameter, unknown=listed.unknown),
            }
    return bounds


def smallest_s_rel(analysis: Mapping[str, ScenarioInfluence]) -> dict[str, dict[str, float | None]]:
    """The smallest nonzero s_rel by scenario, of its intervals and of its global analysis; None if all are 0. A threshold
    below it counts every change."""
    return {
        scenario: {"intervals": result.smallest_interval_s_rel, "overall": result.smallest_overall_s_rel}
        for scenario, result in analysis.items()
    }


def stored_map(stored: StoredInfluenceMap) -> InfluenceMap:
    """A stored map with the ranges that it was made in or checked against."""
    space = space_from_document(stored.parameters)
    ranges = {parameter.name: (parameter.lower, parameter.upper) for parameter in space if not parameter.choices}
    choices = {parameter.name: frozenset(parameter.choices) for parameter in space if parameter.choices}
    for name, value in fixed_from_document({} if stored.basis is None else stored.basis["fixed"]).items():
        if isinstance(value, str):
            choices[name] = frozenset({value})
        else:
            ranges[name] = value, value
    return InfluenceMap(map_from_document(stored.scenarios).scenarios, ranges, choices)


def map_from_document(document: Mapping[str, Any]) -> InfluenceMap:
    """The inverse of `map_to_document`."""
    return InfluenceMap(_INFLUENCES.validate_python(document))
