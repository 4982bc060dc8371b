"""Reads the results of a comparison's runs: the rows of Table 5, of Figures 7 and 8, and of the pairs."""

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import Connection

from drivecal.analysis import comparison as analysis
from drivecal.analysis.comparison import Course, Pair
from drivecal.campaigns.comparisons.resolve import Run, reduction_label, runs_of
from drivecal.campaigns.resolve.resolved_spec import resolved_spec, stored_document
from drivecal.contracts.campaign import CellCounts
from drivecal.contracts.comparison import ComparedGroup, ComparedPair, ComparedRun, ComparisonSpecification, ReductionEffect
from drivecal.contracts.input_errors import validated
from drivecal.contracts.specification import ReductionSpecification
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.scales import COMFORT, Scale
from drivecal.storage import campaigns, generations, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.generations import Figures

MOST_GENERATIONS = 10_000
MOST_REMEMBERED = 100_000
"""Ended runs whose best objective is cached."""


@dataclass(frozen=True, slots=True)
class ComparisonResults:
    """The runs of a comparison with their courses, in order."""

    campaigns: Sequence[StoredCampaign]
    courses: Sequence[Course]
    sign: int = 1
    """-1 if lower objectives are better."""

    def runs(self) -> list[ComparedRun]:
        """Returns a row per run."""
        best = analysis.best_of_all(self.courses, self.sign)
        return [
            _run(campaign, course, success=analysis.succeeds(course, best, self.sign))
            for campaign, course in zip(self.campaigns, self.courses, strict=True)
        ]

    def groups(self) -> list[ComparedGroup]:
        """Returns a row per optimizer, population and reduction."""
        return analysis.groups(self.courses, self.sign)

    def pairs(self) -> list[ComparedPair]:
        """Returns a row per pair of runs that differ only in the reduction."""
        ids = {course.conditions: campaign.id for campaign, course in zip(self.campaigns, self.courses, strict=True)}
        return [pair_row(pair, ids[pair.run.conditions], ids[pair.base.conditions]) for pair in analysis.pairs(self.courses)]

    def effects(self) -> list[ReductionEffect]:
        """The effects over all pairs."""
        return analysis.effects(analysis.pairs(self.courses), self.sign)


def compared(connection: Connection, comparison: StoredCampaign) -> ComparisonResults:
    """The results of a comparison so far."""
    stored = campaigns.runs_of(connection, comparison.sequence)
    wanted = runs_of(validated(ComparisonSpecification, comparison.spec))
    courses = [_course(connection, campaign, _carried_out(campaign, run)) for campaign, run in zip(stored, wanted, strict=True)]
    return ComparisonResults(stored, courses, _scale(stored).sign)


def _carried_out(campaign: StoredCampaign, run: Run) -> analysis.Conditions:
    """Returns the conditions of a run with the reduction of its stored campaign: another release confirmed another number of sets unless
    `confirm` was given."""
    reduction = validated(ReductionSpecification, stored_document(campaign.spec)["reduction"])
    return run.conditions._replace(reduction=reduction_label(reduction))


def _scale(runs: Sequence[StoredCampaign]) -> Scale:
    """Returns the scale of a comparison's runs, which differ in optimizer and reduction alone."""
    return next((resolved_spec(run).scale for run in runs if run.resolution is not None), COMFORT)


def _course(connection: Connection, run: StoredCampaign, conditions: analysis.Conditions) -> Course:
    page, _ = generations.page(connection, run.sequence, limit=MOST_GENERATIONS)
    figures = [figures for _, figures in page]
    reused = any(figure.reused or figure.predicted for figure in figures)
    return Course(
        conditions=conditions,
        best=[figure.best for figure in figures],
        ratings=[figure.rating for figure in figures],
        alternatives=[figure.alternatives for figure in figures],
        means=[figure.mean for figure in figures],
        simulations=[_needed(figure) for figure in figures],
        ended=run.state is CampaignState.SUCCEEDED,
        reused=reused,
        simulated_best=_best_simulated(connection, run) if reused else None,
        confirmations=_needed(run.cells) - sum(map(_needed, figures)) if len(figures) == _iterations(run) else 0,
    )


def _iterations(run: StoredCampaign) -> int:
    """The iterations of the search; later iterations confirm the best set."""
    wanted: int = run.spec["optimizer"]["iterations"]
    return wanted


def _best_simulated(connection: Connection, run: StoredCampaign) -> float | None:
    """See `results.best_simulated`. Looks up an ended run only once: clients that follow a comparison ask every few seconds."""
    if run.id in _ended:
        return _ended[run.id]
    resolved = resolved_spec(run)
    best = results.best_simulated(connection, run.sequence, resolved.weights, resolved.scale.sign)
    if run.state.ended:
        _ended[run.id] = best
        if len(_ended) > MOST_REMEMBERED:
            _ended.clear()
    return best


_ended: dict[str, float | None] = {}
"""Best objectives of ended runs, by the run's unique id."""


def _needed(figures: Figures | CellCounts) -> int:
    """Requested cells without an answer from the campaign's own: simulated, by this or another campaign, or failed."""
    return figures.requested - figures.repeated - figures.reused - figures.predicted


def _run(campaign: StoredCampaign, course: Course, *, success: bool) -> ComparedRun:
    analysed = campaign.counts(StageName.SENSITIVITY)
    return ComparedRun(
        run=campaign.id,
        **course.conditions._asdict(),
        state=campaign.state,
        iterations=len(course.best),
        requested=campaign.cells.requested,
        simulations=course.simulated,
        confirmations=course.confirmations,
        analysis=analysed.requested - analysed.repeated,
        best=course.best[-1] if course.best else None,
        simulated_best=course.optimum,
        rating=course.ratings[-1] if course.ratings else None,
        alternatives=course.alternatives[-1] if course.alternatives else 0,
        mean=course.means[-1] if course.means else None,
        converged_at=course.converged_at,
        simulations_to_converge=course.simulations_to_converge,
        alternatives_converged_at=course.alternatives_converged_at,
        success=success,
    )


def pair_row(pair: Pair, run: str, base_run: str) -> ComparedPair:
    """A pair's row in the response; `run` and `base_run` are the ids of its runs."""
    conditions = pair.run.conditions
    return ComparedPair(
        optimizer=conditions.optimizer,
        population=conditions.population,
        seed=conditions.seed,
        reduction=conditions.reduction,
        base=pair.base.conditions.reduction,
        run=run,
        base_run=base_run,
        best=pair.run.optimum or 0.0,
        base_best=pair.base.optimum or 0.0,
        difference=pair.difference,
        simulations=pair.run.simulated,
        base_simulations=pair.base.simulated,
        saved=pair.saved,
    )
