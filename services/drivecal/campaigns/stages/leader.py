"""The best set of a search and its baseline, as they are stored, with their events."""

from collections.abc import Callable
from dataclasses import replace

from sqlalchemy import Connection

from drivecal.analysis.replicates import rate_bounds
from drivecal.analysis.solutions import EvaluatedSet, Ranking
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.results.front import StoredRanking
from drivecal.contracts.campaign import Baseline, Best
from drivecal.domain.events import EventKind
from drivecal.domain.rounding import same
from drivecal.storage import campaigns, events
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets


def best_of_all(database: Database, campaign: StoredCampaign, problem: CalibrationProblem) -> Callable[[Connection], None]:
    """Returns what stores the best set of all answers of a search that ends early, with rounds that were not closed."""
    ranking = StoredRanking.of(database, campaign, watermark=0).sets  # as the search sees them
    ranking.best_first()  # reads and ranks before the transaction

    def store(connection: Connection) -> None:
        leader = Leader(campaign, problem, ranking)
        leader.describe(connection)
        search = campaign.search and campaign.search.model_copy(update={"surest": leader.surest})
        campaigns.save_progress(connection, replace(campaign, best=leader.best, baseline=leader.baseline, search=search), {})

    return store


class Leader:
    """The best set of a `ranking`, and the baseline."""

    def __init__(self, campaign: StoredCampaign, problem: CalibrationProblem, ranking: Ranking) -> None:
        self._sequence, self._problem, self._ranking = campaign.sequence, problem, ranking
        self.best, self.baseline = campaign.best, campaign.baseline
        self.surest = None if campaign.search is None else campaign.search.surest
        """See `SearchState`."""

    def describe(self, connection: Connection) -> bool:
        """Notes the best set and records its event; returns whether it is a better one than before."""
        best, is_better = self._ranking.best(), False
        if best is not None:
            solution, alternatives = best
            surest = self._ranking.surest() if solution.reused else solution
            self.surest = None if surest is None else surest.objective
            number, before, goals = solution.parameter_set, self.best, self._problem.goals
            parameters = parameter_sets.load(connection, [number])[number]
            self.best = Best.of(
                solution,
                parameters=parameters.floats,
                alternatives=alternatives,
                undecided=solution.is_undecided,
                constraints=goals.named_bounds(solution.judgement),
                failure_interval=rate_bounds(*self._ranking.failed_runs(number)) if solution.replicates > 1 else None,
                close=self._ranking.close(),
                noise=self._ranking.noise(),
            )
            changed = before is None or not same(solution.objective, before.objective, solution.span)
            if before is not None and self.best.parameters != before.parameters:
                changed |= not same(solution.violation, before.violation)
            gain = 0.0 if before is None else solution.sign * (self.best.objective - before.objective)
            # the first set that keeps all constraints may be worse than the last that does not
            if before is None or (changed and (gain > 0 or goals.bounds)):
                self.record_event(connection, solution)
                is_better = True
        unknown = self.baseline is None or self.baseline.objective is None
        self.remember_baseline(connection)
        if unknown and self.baseline is not None and self.baseline.objective is not None:
            events.add(connection, self._sequence, EventKind.BASELINE, self.baseline.model_dump())
        return is_better

    def record_event(self, connection: Connection, solution: EvaluatedSet) -> None:
        """Records that this set is the best one now."""
        best = {} if self.best is None else self.best.model_dump()
        events.add(connection, self._sequence, EventKind.BEST, best | {"iteration": solution.iteration})

    def remember_baseline(self, connection: Connection) -> None:
        """Takes the score of the baseline, if there is one, from the ranking."""
        baseline = self._problem.baseline
        if baseline is None:
            return
        (number,) = parameter_sets.ensure(connection, [baseline])
        solution = self._ranking.get(number)
        gain, is_close = self._ranking.gain_over(number, random=self._problem.bench.is_random)
        beside = None if solution is None else self._ranking.beside_best(number, solution.seeds)
        missing = {"objective": None, "scores": dict.fromkeys(self._problem.scenarios)}
        self.baseline = Baseline.of(
            solution,
            parameters=baseline.floats,
            close=is_close,
            gain=gain,
            best_objective=None if beside is None else beside[0].objective,
            best_scores={} if beside is None else dict(beside[0].scores),
            **(missing if solution is None else {"undecided": solution.is_undecided}),
        )

    def notes(self) -> list[str]:
        """Returns that the best set of a search that is over breaks constraints, if it does, or the runs that would decide its rates."""
        best = self._ranking.best()
        if self.best is None or best is None or self.best.violation <= 0:
            return []
        broken = (
            "is not known to keep the constraints"
            if self.best.undecided
            else f"breaks the constraints by {100 * self.best.violation:.1f} %"
        )
        if self.best.undecided and (seeds := self._ranking.to_show(best[0].parameter_set, ever=True)):
            runs = seeds * len(self._problem.scenarios)
            broken += f": budget or `most` is too small; {runs:,} more runs, all within limits, show it"
        others = "by its runs" if self.best.replicates > 1 else "no set keeps all constraints on results"
        return [f"{others}: the best set {broken}"]
