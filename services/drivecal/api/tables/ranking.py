"""Ranking of the evaluated sets of a campaign.

A score of the campaign's problem is named by its name, and a score of another push by `NAME@PUSH`, the name or digest of the push.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from threading import Lock

from sqlalchemy import Connection

from drivecal.analysis.goals import SCORE, Aggregate, CellValue, Goals, Objective, normalised, weighted_mean
from drivecal.analysis.solutions import EvaluatedSet, Ranking
from drivecal.api.responses import calibration
from drivecal.bundles.expressions import Formula
from drivecal.bundles.fingerprints import score_id
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec, specification_of
from drivecal.campaigns.resolve.workbench import find_workbench, stored_bundles
from drivecal.campaigns.results.front import StoredRanking
from drivecal.contracts.assignments import assignments
from drivecal.contracts.results import VariantResult
from drivecal.contracts.strict_json import shown
from drivecal.contracts.tables import Solution
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import Diagnostics, InvalidInputError, NotFoundError, Problem
from drivecal.domain.evaluations import CellScore
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.scales import Scale, plain
from drivecal.domain.setups import base_of
from drivecal.storage import campaigns, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets, runs

LARGEST_WEIGHT = 1e6
MOST_KEPT = 200_000
"""Cells of the largest ranking that stays in memory, some 1 kB each."""
_ranking = Lock()


@dataclass(frozen=True)
class SolutionPages:
    """The solutions of a campaign, best first; only shown ones have their values read."""

    database: Database
    ranked: Sequence[EvaluatedSet]
    scenarios: Sequence[str]
    resolved: ResolvedSpec
    ranking: Ranking
    """All sets of the search, ranked or not."""

    def __len__(self) -> int:
        return len(self.ranked)

    def solutions(self, start: int, stop: int) -> list[Solution]:
        """Returns the solutions of ranks `start` + 1 to `stop`."""
        listed = self.ranked[start:stop]
        sets = self.database.query(parameter_sets.load, [solution.parameter_set for solution in listed])
        return [
            Solution.of(
                solution,
                rank=rank,
                parameters=sets[solution.parameter_set].floats,
                undecided=solution.is_undecided,
                constraints=self.resolved.goals.named_bounds(solution.judgement),
            )
            for rank, solution in enumerate(listed, start + 1)
        ]


def ranking_of(database: Database, identifier: str, lacks: str = "") -> StoredRanking:
    """Returns the ranking of a campaign by its id. Raises NotFoundError, and ConflictError as `calibration`."""
    campaign = calibration(database.query(campaigns.get, identifier), lacks)
    if not campaign.state.ended or campaign.counts(StageName.CALIBRATION).requested > MOST_KEPT:
        return StoredRanking.of(database, campaign)
    with _ranking:  # the first look at a ranking changes it
        stored = _kept(database, campaign.id, campaign.revision, database.query(runs.largest_id))
        stored.sets.best()
    return stored


@lru_cache(maxsize=1)
def _kept(database: Database, ended: str, _revision: int, _newest_run: int) -> StoredRanking:
    """Returns the ranking of the ended campaign that was asked for last, for the next page of its tables. A newer run may change it."""
    return StoredRanking.of(database, database.query(campaigns.get, ended))


def solution_pages(stored: StoredRanking, weights: str | None = None, score: str | None = None) -> SolutionPages:
    """Returns the solutions by the campaign's first objective, or under `weights` (`S1=2,S2=1`) by its score or another one. Sets that keep
    the constraints come first. Another score is computed from the measures of runs; sets with a cell that only a reference or a prediction
    answered have none. Raises InvalidInputError for unusable weights and unknown scores."""
    resolved = stored.resolved
    used = resolved.weights if weights is None else given_weights(weights, list(resolved.weights), "scenario")
    other = None if score is None else _other_score(stored, score)
    scale = resolved.scale if other is None or other.scale is None else other.scale
    if weights is not None or score is not None:
        resolved = replace(resolved, weights=used, scale=scale, goals=_constrained(resolved.goals, used, scale, other))
    ranking = stored.under(resolved).sets if other is None else Ranking(used, resolved.goals, resolved.replicates)
    if other is not None:
        with stored.database.read() as connection:
            ranking.add(_rated(connection, stored.campaign, resolved.evaluator, other, resolved.goals))
    scenarios = [name for name, weight in used.items() if weight > 0]
    return SolutionPages(stored.database, ranking.best_first(), scenarios, resolved, ranking)


def variants_of(stored: StoredRanking) -> list[VariantResult]:
    """Returns the best set of each variant and its value under the best common set, as far as they are known. Both are compared under the
    same seeds, though the common set may have been run under more."""
    resolved, rows = stored.resolved, list[VariantResult]()
    best = stored.sets.best() if resolved.variants else None
    for name in resolved.variants:
        variant = stored.under(resolved.of_variant(name))
        own = solution_pages(variant).solutions(0, 1)
        rows.append(VariantResult(name=name, scenarios=dict(variant.resolved.weights), best=next(iter(own), None)))
        compared = None if best is None else variant.sets.beside_best(best[0].parameter_set)
        if compared is not None:
            mine, common = compared
            cost = {"cost": common.sign * (mine.objective - common.objective) + 0.0, "violation": common.violation}
            rows[-1] = rows[-1].model_copy(update=cost | {"common": common.objective + (own[0].objective - mine.objective)})
    return rows


def _constrained(goals: Goals, weights: Mapping[str, float], scale: Scale, score: CellValue | None) -> Goals:
    """Returns the weighted mean of a score, by default the campaign's, under the constraints of the goals."""
    if not goals.bounds:
        return weighted_mean(scale, weights)
    shares = normalised(weights)
    # a change needs no run, so that it is known in each of these scenarios
    bounds = tuple(bound if bound.value.change is None else replace(bound, shares=shares) for bound in goals.bounds)
    return Goals((Objective(scale.name, score or CellValue(scale), shares, Aggregate(), scale.sign),), bounds)


def _other_score(stored: StoredRanking, name: str) -> CellValue | None:
    """Returns another score for a campaign, None for its own evaluator. Raises InvalidInputError if there is none of this name."""
    values = find_workbench(specification_of(stored.campaign), stored_bundles(stored.database), Diagnostics()).known
    known = values.scores
    if "@" in name:
        return _pushed_score(stored.database, name, stored.resolved.evaluator, values.measures)
    if name not in known:
        message = f"the campaign's problem has no score {shown(name)}"
        remedy = f"one of {', '.join(known)}; drivecal rerun --evaluator rates stored runs by another evaluator"
        raise InvalidInputError(Problem("score", message, remedy))
    return None if known[name].key == SCORE else known[name]


def _pushed_score(database: Database, name: str, own: str, measures: Collection[str]) -> CellValue | None:
    """Returns the score that a push declares, if its formula is of these measures; None if it is the campaign's `own`."""
    score, _, push = name.partition("@")
    try:
        manifest = stored_bundles(database)(push).manifest
    except NotFoundError as error:
        raise InvalidInputError(Problem("score", str(error), "drivecal problem list shows what was pushed")) from error
    entry = manifest.scores.get(score)
    if entry is None:
        message = f"{manifest.problem} has no score {shown(score)}"
        raise InvalidInputError(Problem("score", message, f"one of {', '.join(manifest.scores)}"))
    if entry.formula is None:
        message = f"{score} is an evaluator's, which rates stored runs in a rerun only"
        raise InvalidInputError(Problem("score", message, "leave it out, or type: drivecal rerun --evaluator"))
    missing = sorted(Formula(entry.formula).names - set(measures))
    if missing:
        message = f"runs of the campaign have no {', '.join(missing)}"
        raise InvalidInputError(Problem("score", message, f"a score of {', '.join(measures)}"))
    # by its full name: a constraint may bound a score of the same name by the formula of the campaign's own push
    return None if score_id(score, entry) == own else CellValue(entry.scale(name), entry.formula)


def _rated(
    connection: Connection, campaign: StoredCampaign, evaluator: str, value: CellValue, goals: Goals
) -> Iterator[CellScore]:
    """Yields the answered cells with another score; without one if a reference or a prediction answered them, or a measure is missing.
    Values of `goals` may name the campaign's own score."""

    def rate(measures: Mapping[str, float | None], failure: str | None, parameters: ParameterSet) -> dict[str, float]:
        score = value.of(measures, failure, parameters)
        further = goals.values(measures, failure, parameters)
        return further if score is None else further | {value.key: score}

    bounds_own = any(bound.value.key == SCORE for bound in goals.bounds)

    for cell in results.answers(connection, campaign.sequence, StageName.CALIBRATION, corrected_by=evaluator, valued=rate):
        score = cell.values.get(value.key)
        known = score is not None  # of a run of this very cell, or of a run that it provably repeats
        own = {} if cell.score is None or not bounds_own else {SCORE: cell.score}
        yield replace(
            cell,
            score=None if score is None else plain(score),
            rating=score,
            own=known and (cell.own or not bounds_own),
            predicted=cell.predicted and not known,
            values=own | dict(cell.values),
        )


def given_weights(text: str, names: Sequence[str], kind: str) -> Mapping[str, float]:
    """Returns weights by scenario or objective in the campaign's order; names without a weight have weight 1, as in a campaign file."""
    given = assignments(text.split(","), "weights")
    problems: list[Problem] = []
    for name, weight in given.items():
        where = f"weights.{name}"
        if name not in names and name not in map(base_of, names):
            problems.append(Problem(where, f"the campaign did not examine this {kind}", f"one of {', '.join(names)}"))
        elif not 0 <= weight <= LARGEST_WEIGHT:
            problems.append(Problem(where, f"{weight:g} is not a weight", f"give a number from 0 to {LARGEST_WEIGHT:,.0f}"))
    weights = {name: given.get(name, given.get(base_of(name), 1.0)) for name in names}
    if not problems and not any(weights.values()):
        problems.append(Problem("weights", "all weights are 0", f"give at least one {kind} a positive weight"))
    if problems:
        raise InvalidInputError(*problems)
    return weights
