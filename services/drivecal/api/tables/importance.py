"""Importance of the parameters of a search, for its objective or the score of a scenario."""

import numpy as np

from drivecal.analysis.importance import HELD_OUT, TREES, importances
from drivecal.api.http.queries import ImportanceOf
from drivecal.api.tables.ranking import ranking
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec
from drivecal.contracts.results import ImportanceAnswer, ParameterImportance
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.parameters import Parameter
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets

METHOD = f"permutation importance: loss of R² on a held-out share of {HELD_OUT:.0%}, by a forest of {TREES} extremely randomised trees"


def importance(database: Database, campaign: StoredCampaign, resolved: ResolvedSpec, query: ImportanceOf) -> ImportanceAnswer:
    """Returns the importance of each searched parameter. Raises InvalidInputError for an unknown scenario, and what `ranking` raises.

    Counts sets whose values are their own, by a simulation of that very set.
    """
    scenario = query.scenario
    ranked = ranking(database, campaign, resolved, query.weights, query.score)
    if scenario is not None and scenario not in ranked.scenarios:
        problem = Problem("scenario", f"the campaign has no scenario {scenario!r}", f"one of {', '.join(ranked.scenarios)}")
        raise InvalidInputError(problem)
    own = [entry for entry in ranked.ranked if not (entry.reused if scenario is None else scenario in entry.reused)]
    own.sort(key=lambda entry: (entry.iteration, entry.individual))
    with database.read() as connection:
        sets = parameter_sets.load(connection, [entry.parameter_set for entry in own])
    searched = resolved.space.searched
    rows = [[_position(parameter, sets[entry.parameter_set].floats[parameter.name]) for parameter in searched] for entry in own]
    values = np.array([entry.objective if scenario is None else entry.scores[scenario] for entry in own], dtype=np.float64)
    result = importances(np.array(rows, dtype=np.float64).reshape(len(own), len(searched)), values)
    if result is None:
        return ImportanceAnswer(scenario=scenario, method=METHOD, sets=len(own))
    items = [
        ParameterImportance(parameter=parameter.name, importance=float(mean), deviation=float(deviation))
        for parameter, mean, deviation in zip(searched, result.mean, result.deviation, strict=True)
    ]
    items.sort(key=lambda item: -item.importance)
    return ImportanceAnswer(
        scenario=scenario, method=METHOD, sets=result.sets, held_out=result.held_out, r2=result.r2, items=items
    )


def _position(parameter: Parameter, value: float | str) -> float:
    """Returns a value as a number, the place of a choice among its texts."""
    return float(parameter.choices.index(value)) if isinstance(value, str) else float(value)
