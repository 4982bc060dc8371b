"""The robustness stage: simulates the best sets with other vehicles (Section IV-D of the paper) and ranks them by their tolerance."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from sqlalchemy import Connection

from drivecal.analysis.optima import one_per_region_first
from drivecal.analysis.robustness import Robustness, RobustnessStudy, failing_at_most, key_of
from drivecal.analysis.solutions import EvaluatedSet, Ranking
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.results.front import MOST_BEST, StoredRanking, regions_of
from drivecal.campaigns.stages.replication import SeededBenches
from drivecal.campaigns.stages.stage import Round, StudyStage, ended_source, exact_policy
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.evaluations import CellScore, RequestedCell
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.rounding import levels
from drivecal.domain.scales import plain
from drivecal.plugins.ports import Floats
from drivecal.storage import campaigns, results, studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets


@dataclass(frozen=True, slots=True)
class Examined:
    """An examined set, and its region among the examined sets."""

    parameters: ParameterSet
    region: int


def check_source(connection: Connection, problem: CalibrationProblem) -> None:
    """Raises InvalidInputError if the campaign with the sets to examine is missing, has not ended, or is of another kind or problem."""
    wanted, function = problem.specification.robustness, problem.specification.driving_function
    if wanted is None or wanted.of is None:
        return
    field = "robustness.of"
    source = ended_source(connection, wanted.of, field)
    if source.cells.requested == 0:
        message = f"campaign {wanted.of} has no solutions: it searched nothing, or ended before it had found any"
        raise InvalidInputError(Problem(field, message, "name one that has searched"))
    theirs = resolved_spec(source)
    if set(theirs.space.names) != set(problem.space.names):
        message = f"its sets have the parameters {', '.join(theirs.space.names)}"
        raise InvalidInputError(Problem(field, message, f"name a campaign that searched {', '.join(problem.space.names)}"))
    if source.spec["driving_function"] != function:
        message = f"its solutions are of the driving function {source.spec['driving_function'] or 'of its problem'}"
        raise InvalidInputError(Problem(field, message, f"name a campaign of {function or problem.bench.function}"))
    if missing := [name for name in problem.weights if name not in theirs.weights]:
        message = f"its sets have no scores in {', '.join(missing)}"
        raise InvalidInputError(Problem(field, message, f"give a catalogue of {', '.join(theirs.weights)}"))


class RobustnessStage(StudyStage):
    """Round 0 simulates the sets with the nominal vehicle if their scores are references' or unknown; round k simulates box k.

    Each vehicle of a box has a seed if the simulator is random, the same for all sets. It is compared with the nominal one under that seed.
    """

    name = StageName.ROBUSTNESS

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, view: View) -> None:
        super().__init__(database, campaign, problem, view)
        self._goals, self._valued = problem.goals, problem.goals.valued
        wanted = problem.specification.robustness
        if wanted is None:
            raise ValueError("the campaign has no robustness stage")
        self._wanted = wanted
        self._examined = self._requested() or self._choose()
        self._seeds = list(dict.fromkeys(map(problem.bench.seed_of, range(wanted.samples))))
        self._benches = SeededBenches(problem.bench)
        self._scores = np.full((len(self._examined), len(self._seeds), len(problem.scenarios)), np.nan)
        self._nominal_ranking = Ranking(problem.weights, self._goals, problem.specification.replicates)
        self._nominal: list[EvaluatedSet | None] = [None] * len(self._examined)
        """The examined sets with the nominal vehicle, over their seeds."""
        self._study: RobustnessStudy | None = None

    def _requested(self) -> list[Examined]:
        """The sets of the stored round 0, to which the numbers of all cells refer; none before. A resumed study must not choose again: what
        others simulate in the meantime changes the choice."""
        with self._database.read() as connection:
            sets = results.sets_at(connection, self._campaign.sequence, self.name, 0)
            document = studies.get(connection, self._campaign.sequence, self.name) or {"items": []}
        regions = {key_of(row["parameters"]): row["region"] for row in document["items"]}
        return [Examined(sets[number], regions.get(key_of(sets[number].floats), 0)) for number in sorted(sets)]

    def _choose(self) -> list[Examined]:
        """The named sets, then the best sets of the calibration, or its front, one of each region first. Simulations that this campaign
        sees correct copied scores of another campaign, as in that one's ranking."""
        of = self._wanted.of
        with self._database.read() as connection:
            source = self._campaign if of is None else campaigns.get(connection, of)
        resolved = replace(resolved_spec(source), weights=self._problem.weights, goals=self._goals)
        stored = StoredRanking(self._database, source, resolved, 0 if of is None else self._view.watermark)
        best = [solution.parameter_set for solution in self._best(stored.sets)]
        sets = self._database.query(parameter_sets.load, best)
        named = list(self._problem.robust_sets)
        listed = named + [sets[number] for number in best if sets[number] not in named]
        regions = regions_of(self._problem.space, listed) if listed else []
        chosen = one_per_region_first(regions[len(named) :], self._wanted.solutions)
        places = (*range(len(named)), *(len(named) + place for place in chosen))
        return [Examined(listed[place], regions[place]) for place in places]

    def _best(self, ranking: Ranking) -> list[EvaluatedSet]:
        """The sets of the front, or with one objective the sets that count as the best or cannot be told from it, which break constraints
        no more than the best set."""
        if len(self._goals.objectives) > 1:
            return [member.solution for member in ranking.front()][:MOST_BEST]
        ranked = ranking.best_first()
        return [each for each in ranked if _is_as_good(each, ranked[0])][:MOST_BEST]

    @property
    def _at_most(self) -> int:
        settings = self._wanted
        return len(self._examined) * len(self._problem.scenarios) * (len(self._seeds) + settings.steps * settings.samples)

    def _ask(self) -> Round | None:
        bench, scenarios = self._problem.bench, self._problem.scenarios
        if self._study is None:
            cells = [
                RequestedCell(index, scenario, examined.parameters, seed=seed)
                for index, examined in enumerate(self._examined)
                for scenario in scenarios
                for seed in self._seeds
            ]
            return Round(0, self._benches.with_cells(cells), exact_policy(self._problem)) if cells else None
        box = self._study.ask()
        if box is None:
            return None
        samples = self._wanted.samples
        by_vehicle: dict[tuple[int, tuple[tuple[str, float], ...]], list[RequestedCell]] = {}
        for solution in box.solutions:
            for sample, vehicle in enumerate(box.vehicles):
                cells = by_vehicle.setdefault((bench.seed_of(sample), tuple(vehicle.items())), [])
                cells += [
                    RequestedCell(solution * samples + sample, scenario, self._examined[solution].parameters)
                    for scenario in scenarios
                ]
        asked = [
            (replace(bench, values={**bench.values, **dict(values)}, seed=seed), cells)
            for (seed, values), cells in by_vehicle.items()
        ]
        return Round(box.number, asked, exact_policy(self._problem))

    def _take(self, number: int, answers: Sequence[CellScore]) -> None:
        columns = {scenario: column for column, scenario in enumerate(self._problem.scenarios)}
        if number == 0:
            for answer in answers:
                place = answer.individual, self._seeds.index(answer.seed), columns[answer.scenario]
                self._scores[place] = np.nan if answer.score is None else answer.score
            self._nominal_ranking.add(answers)
            numbers = {answer.individual: answer.parameter_set for answer in answers}
            self._nominal = [self._nominal_ranking.get(numbers[place]) for place in range(len(self._examined))]
            bench = self._problem.bench
            self._study = RobustnessStudy(
                self._scores, self._problem.scenarios, bench.varied, bench.values, self._wanted, bench.scale.tolerance
            )
            return
        box = None if self._study is None else self._study.ask()
        if self._study is None or box is None:
            raise RuntimeError(f"round {number} was not asked for")
        samples = self._wanted.samples
        scores = {solution: np.full((samples, len(columns)), np.nan) for solution in box.solutions}
        for answer in answers:
            solution, sample = divmod(answer.individual, samples)
            scores[solution][sample, columns[answer.scenario]] = np.nan if answer.score is None else answer.score
        self._study.tell(scores)

    def _outcome(self) -> dict[str, Any]:
        """The examined sets, most robust first."""
        known = self._study.result() if self._study is not None else [Robustness(0, False, 0.0, ())] * len(self._examined)
        objectives, ratings = (
            np.array([np.nan if each is None else getattr(each, name) for each in self._nominal], dtype=np.float64)
            for name in ("objective", "rating")
        )
        violations = [0.0 if each is None else each.violation for each in self._nominal]
        sign, span = next(((each.sign, each.span) for each in self._nominal if each is not None), (1, 0.0))
        worse = levels(np.where(np.isnan(objectives), np.inf, -sign * objectives), span).tolist()
        rated = np.where(np.isnan(ratings), -np.inf, sign * ratings).tolist()
        order = sorted(
            range(len(known)),
            key=lambda number: (
                -known[number].degree,
                violations[number],
                worse[number],
                -known[number].radius,
                -rated[number],
                number,
            ),
        )
        recommended = self._recommend(objectives, sign * ratings, known)
        rows = [
            self._row(rank, number, float(objectives[number]), float(ratings[number]), known[number], recommended)
            for rank, number in enumerate(order, start=1)
        ]
        return {"items": rows, "settings": self._wanted.model_dump(mode="json", exclude={"sets"})}

    def _recommend(self, objectives: Floats, ratings: Floats, known: Sequence[Robustness]) -> tuple[int, str] | None:
        """Returns the most robust of the sets with the best objective or on the front, and the reason. Higher `ratings` are better."""
        usable = [number for number in range(len(known)) if not np.isnan(objectives[number])]
        if not usable or not any(each.trials for each in known):  # nothing is known before the first box
            return None
        best = self._best_of(usable)
        chosen = max(best, key=lambda number: (known[number].degree, known[number].radius, ratings[number], -number))
        degree = f"the largest degree of robustness ({known[chosen].degree}{' or more' if known[chosen].at_least else ''})"
        if len(self._goals.objectives) > 1:
            return chosen, f"of {len(best)} sets that no other examined set dominates, {degree}"
        best_one = "the best objective" if len(self._seeds) == 1 else "an objective that cannot be told from the best one"
        return chosen, f"{best_one} ({objectives[chosen]:.4g}, {len(best)} sets), and of these {degree}"

    def _best_of(self, usable: Sequence[int]) -> list[int]:
        """Returns the sets that cannot be told from the best one, with other goals than the weighted score the non-dominated sets."""
        known = [each for number in usable if (each := self._nominal[number]) is not None]
        first, best = min(known, key=self._nominal_ranking.order), np.zeros(len(known), dtype=np.bool_)
        if not self._goals.is_weighted_score:
            points = self._goals.signed(each.choice.judgement for each in known)
            best = self._goals.leading(points, np.array([each.choice.violation for each in known], dtype=np.float64))
        if len(self._goals.objectives) == 1:
            best |= [_is_as_good(each, first) for each in known]
        return [usable[place] for place in np.flatnonzero(best).tolist()]

    def _row(
        self, rank: int, solution: int, objective: float, rating: float, known: Robustness, recommended: tuple[int, str] | None
    ) -> dict[str, Any]:
        scenarios, examined, nominal = self._problem.scenarios, self._examined[solution], self._nominal[solution]
        is_recommended = recommended is not None and recommended[0] == solution
        means = dict(zip(scenarios, self._scores[solution].mean(axis=0).tolist(), strict=True))
        reported = {} if nominal is None or len(self._seeds) < 2 else nominal.scores
        return {
            "rank": rank,
            "objective": None if np.isnan(objective) else objective,
            "rating": None if np.isnan(rating) else rating,
            "replicates": len(self._seeds),
            **{name: getattr(nominal, name, None) for name in ("lower", "upper")},
            "parameters": examined.parameters.floats,
            "scores": {name: reported.get(name, None if np.isnan(score) else plain(score)) for name, score in means.items()},
            "region": examined.region,
            "degree": known.degree,
            "at_least": known.at_least,
            "radius": known.radius,
            "failing_at_most": failing_at_most(known, self._wanted, len(self._examined)),
            "recommended": is_recommended,
            "reason": recommended[1] if recommended is not None and is_recommended else None,
            "trials": [trial.model_dump() for trial in known.trials],
        }


def _is_as_good(each: EvaluatedSet, best: EvaluatedSet) -> bool:
    """Returns whether a set counts as the best one, or cannot be told from it and breaks constraints no more."""
    return best.equals(each) or (each.is_close and each.choice.violation <= best.choice.violation)
