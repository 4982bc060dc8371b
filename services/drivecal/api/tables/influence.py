"""The rows of influence maps, for a campaign's scenarios and space or as a map has them."""

from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import Any

import numpy as np

from drivecal.analysis.goals import SCORE
from drivecal.analysis.importance import HELD_OUT, LEAST_SETS, TREES, Importances, importances, mean_of
from drivecal.api.http.queries import ImportanceOf
from drivecal.api.tables.ranking import solution_pages
from drivecal.campaigns.resolve.maps import map_from_document
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec
from drivecal.campaigns.resolve.spaces import space_from_document
from drivecal.campaigns.results.front import StoredRanking
from drivecal.contracts.results import CLEAR, WEAK, ImportanceAnswer, ParameterImportance
from drivecal.contracts.tables import DecidedBy, InfluenceRow
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.influence import Influence
from drivecal.domain.parameters import Parameter
from drivecal.storage.references import influence_maps, parameter_sets
from drivecal.storage.references.influence_maps import StoredInfluenceMap

MEASURES = ("s_rel_intervals", "mu", "sigma", "mu_star")


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


def _row(stored: StoredInfluenceMap, scenario: str, name: str, known: Influence, parameter: Parameter | None) -> InfluenceRow:
    entry: Mapping[str, Any] | None = stored.scenarios.get(scenario, {}).get(name)
    influential, lower, upper = _bounds(known, parameter)
    space = {} if parameter is None else {"space_lower": parameter.lower, "space_upper": parameter.upper}
    return InfluenceRow.of(
        parameter,  # its unit and number of values
        scenario=scenario,
        parameter=name,
        influential=influential,
        lower=lower,
        upper=upper,
        **{measure: None if entry is None else entry.get(measure) for measure in MEASURES},
        unknown=entry is None or entry.get("unknown", False),
        **space,
        decided_by=_decided_by(stored, entry, outside=known.influential and not influential),
    )


def _decided_by(stored: StoredInfluenceMap, entry: Mapping[str, Any] | None, *, outside: bool) -> DecidedBy | None:
    """Returns what decided about a row. `outside`: the campaign's space holds none of the influential range."""
    if entry is None:
        return "unknown"
    if outside:
        return "space"
    decided_by: DecidedBy | None = "posted" if stored.basis is None else entry.get("decided_by")
    return decided_by


def _bounds(influence: Influence, parameter: Parameter | None) -> tuple[bool, Decimal | None, Decimal | None]:
    """Returns P_sens and PB_sens within the parameter's bounds; a choice has none. Nothing is influential if both lie outside."""
    lower, upper = influence.lower, influence.upper
    if parameter is not None and not parameter.choices:
        lower = parameter.lower if lower is None else max(lower, parameter.lower)
        upper = parameter.upper if upper is None else min(upper, parameter.upper)
    if not influence.influential or (lower is not None and upper is not None and lower > upper):
        return False, None, None
    return True, lower, upper


NEAR = (
    "the order of the parameters holds near the sets of the search only: one that explains little of how they differ may matter"
    " elsewhere, however narrow its interval; a sensitivity analysis or a random search shows whether it does"
)
METHOD = f"permutation: half the loss of R² on a held-out {100 * HELD_OUT:.0f} %, by {TREES} extremely randomised trees"


def importance(stored: StoredRanking, query: ImportanceOf) -> ImportanceAnswer:
    """Returns the importance of each searched parameter. Raises InvalidInputError for an unknown scenario, and what `ranking` raises.

    Counts sets whose values are their own, by a simulation of that very set. In a scenario, given-up sets count as well. With too
    few complete sets, the importance for a weighted score is the mean of the scenarios', each by its share in the variation.
    """
    scenario = query.scenario
    ranked = solution_pages(stored, query.weights, query.score)
    if scenario is not None and scenario not in ranked.scenarios:
        problem = Problem("scenario", f"the campaign has no scenario {scenario!r}", f"one of {', '.join(ranked.scenarios)}")
        raise InvalidInputError(problem)
    searched, known = stored.resolved.space.searched, dict[str, Importances]()

    def of(values: Mapping[int, float]) -> Importances | None:
        sets = stored.database.query(parameter_sets.load, list(values))
        rows = [[parameter.nearest(sets[number].floats[parameter.name]) for parameter in searched] for number in values]
        features = np.array(rows, dtype=np.float64).reshape(len(values), len(searched))
        shares = features / [parameter.n_values - 1 for parameter in searched]
        return importances(shares, np.array(list(values.values())))

    if scenario is not None:
        own = ranked.ranking.own_scores(scenario)
    else:
        whole = sorted(ranked.ranked, key=lambda entry: (entry.iteration, entry.individual))
        own = {entry.parameter_set: entry.objective for entry in whole if not entry.reused}
    result, goal = of(own), ranked.resolved.goals.objectives[0]
    is_weighted = goal.value.key == SCORE and goal.aggregate.kind == "mean" and not goal.variants
    if result is None and len(own) < LEAST_SETS and scenario is None and is_weighted:
        scores = {name: ranked.ranking.own_scores(name) for name in goal.shares}
        known = {name: found for name, values in scores.items() if (found := of(values)) is not None}
        variations = [goal.shares[name] ** 2 * float(np.var(list(scores[name].values()))) for name in known]
        result = mean_of(list(zip(variations, known.values(), strict=True))) if sum(variations) > 0.0 else None
    if result is None or result.r2 <= 0.0:
        note = "the sets that were learned from tell nothing of the values of the others"
        if result is None:
            few = f"{len(own)} sets have values of their own, and {LEAST_SETS} are needed"
            note = few if len(own) < LEAST_SETS else "the values of nearly all sets are the same"
        return ImportanceAnswer(scenario=scenario, method=METHOD, sets=len(own), notes=[note])
    figures = (each.tolist() for each in (result.mean, result.lower, result.upper, result.spread))
    items = [
        ParameterImportance(parameter=parameter.name, importance=mean, lower=lower, upper=upper, covered=spread)
        for parameter, mean, lower, upper, spread in zip(searched, *figures, strict=True)
    ]
    items.sort(key=lambda item: -item.importance)
    return ImportanceAnswer.of(
        result,
        scenario=scenario,
        method=METHOD,
        scenarios=list(known),
        covered=result.spread.mean(),
        notes=_notes(stored, scenario, items, result.r2),
        items=items,
    )


def _notes(stored: StoredRanking, scenario: str | None, items: Sequence[ParameterImportance], r2: float) -> list[str]:
    """Returns sentences about a weak fit, about the sets of a search, and about parameters on which importance and influence map
    disagree."""
    campaign, notes = stored.campaign, list[str]()
    if r2 < WEAK:
        notes.append(f"the forest explains {100 * max(0.0, r2):.0f} % of the held-out sets' variation: importances mean little")
    if (campaign.spec.get("optimizer") or {}).get("kind") != "random":
        notes.append(NEAR)
    if campaign.influence_map_id is None:
        return notes
    rows = campaign_rows(stored.database.query(influence_maps.get, campaign.influence_map_id), stored.resolved)
    matters = {row.parameter for row in rows if row.influential and scenario in {None, row.scenario}}
    notes += [
        f"{item.parameter} matters among the sets of this search (importance {item.lower:.2g} or more), and the influence map calls it"
        " non-influential"
        for item in items
        if item.lower >= CLEAR and item.parameter not in matters
    ]
    return notes
