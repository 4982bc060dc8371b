"""A whole campaign, its stages in sequence, each resumed from the database; and a single evaluation."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from drivecal.campaigns.cells.earlier import bench_of, checked_cells, earlier_versions, unclaimed
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.cells.rerating import rate_stored_runs
from drivecal.campaigns.job import Job
from drivecal.campaigns.resolve.maps import check_basis, stored_map, warnings_of
from drivecal.campaigns.resolve.problem import CalibrationProblem, EvaluationProblem
from drivecal.campaigns.stages.calibration import Calibration
from drivecal.campaigns.stages.claims import ClaimCheck, checkable, compare
from drivecal.campaigns.stages.outside import OutsideSearch
from drivecal.campaigns.stages.prediction_validation import PredictionValidation
from drivecal.campaigns.stages.replication import SeededBenches
from drivecal.campaigns.stages.robustness import RobustnessStage
from drivecal.campaigns.stages.sensitivity import Sensitivity
from drivecal.campaigns.stages.stage import Round, Stage
from drivecal.campaigns.stages.validation import ValidationStage
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import InvalidInputError, NoResultError
from drivecal.domain.evaluations import Purpose, RequestedCell
from drivecal.execution.scheduling.in_flight import Completed, Work
from drivecal.reduction.assignment import Policy
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps


class SingleEvaluation(Stage):
    """A parameter set in one or more scenarios, under its seeds. Answers come from equal parameter sets or a simulation, never by reuse;
    with time series or if it is to be `fresh`, always from a new simulation."""

    name = StageName.CALIBRATION
    ends_early = False

    def __init__(self, database: Database, campaign: StoredCampaign, problem: EvaluationProblem, view: View) -> None:
        is_new = view.traced or problem.specification.fresh
        with database.read() as connection:
            versions = () if is_new else earlier_versions(connection, problem.bench)
            cells = checked_cells(connection, problem.bench) if versions else []
        for version in versions:
            rate_stored_runs(database, replace(view, bench=bench_of(version, problem.bench)))
        compared = [(version, *compare(database, view, [version], cells)) for version in versions]
        checked = tuple(version for version, number, faults in compared if number and not faults)
        super().__init__(database, campaign, replace(view, earlier=checked))
        self._unchecked = [version for version in versions if version not in checked]
        self._problem, self._is_new, self._benches = problem, is_new, SeededBenches(problem.bench)
        self._asked = False

    @property
    def _at_most(self) -> int:
        return len(self._problem.bench.scenarios) * len(self._problem.seeds)

    def _resume(self) -> list[Work]:
        for bench in () if self._view.traced else map(self._benches.of, self._problem.seeds):
            rate_stored_runs(self._database, replace(self._view, bench=bench), only=self._problem.parameter_set)
        return []

    def _ask(self) -> Round | None:
        if self._asked:
            return None
        self._asked = True
        bench, parameters = self._problem.bench, self._problem.parameter_set
        cells = [
            RequestedCell(0, scenario, parameters, purpose=Purpose.EVALUATION, seed=seed)
            for scenario in bench.scenarios
            for seed in self._problem.seeds
        ]
        return Round(0, self._benches.with_cells(cells), Policy("off" if self._is_new else "exact"))

    def _tell(self, asked: Round) -> None:
        """Ends the evaluation. Raises NoResultError if a cell has no result; the rows hold the answers of the others. Raises
        InvalidInputError if runs of earlier versions differ from these, although claims that no campaign has checked make them equal."""
        del asked
        cells = [(scenario, self._problem.parameter_set) for scenario in self._problem.bench.scenarios]
        _, faults = compare(self._database, self._view, self._unchecked, cells)
        if faults:
            raise InvalidInputError(*faults)
        if failed := self._tracker.counts["failed"]:
            raise NoResultError(f"{failed:,} of the {self._at_most:,} cells gave no result{self._causes()}")


StageKind = (
    type[ClaimCheck]
    | type[Sensitivity]
    | type[Calibration]
    | type[OutsideSearch]
    | type[RobustnessStage]
    | type[ValidationStage]
    | type[PredictionValidation]
)
Wanted = Callable[[StoredCampaign, CalibrationProblem], bool]


def _wants_validation(problem: CalibrationProblem, *, of_predictions: bool) -> bool:
    wanted = problem.specification.validation
    return wanted is not None and (wanted.of is not None) == of_predictions


STAGES: tuple[tuple[StageKind, Wanted], ...] = (
    (ClaimCheck, lambda _, problem: problem.bench.bundle.manifest.claims),
    (Sensitivity, lambda campaign, problem: campaign.influence_map_id is None and problem.analysis() is not None),
    (Calibration, lambda _, problem: problem.optimization is not None and not problem.optimization.is_external),
    (OutsideSearch, lambda _, problem: problem.optimization is not None and problem.optimization.is_external),
    (RobustnessStage, lambda _, problem: problem.specification.robustness is not None),
    (ValidationStage, lambda _, problem: _wants_validation(problem, of_predictions=False)),
    (PredictionValidation, lambda _, problem: _wants_validation(problem, of_predictions=True)),
)
"""In running order, each with whether a campaign wants it and does not have its outcome already."""


class StagedCampaign(Job):
    """Delegates work and results to its stages, in order. The sensitivity stage ends when the campaign has an influence map."""

    def __init__(self, database: Database, campaign: StoredCampaign, problem: CalibrationProblem, workers: int = 1) -> None:
        """`workers`: their number at present."""
        self._database = database
        self._problem = problem
        self._view = View(campaign.sequence, campaign.watermark or 0, problem.bench, workers=workers)
        self._begun = False
        self._sequence = campaign.sequence
        names = [kind.name for kind, _ in STAGES]
        self._ahead = list(STAGES if campaign.stage is None else STAGES[names.index(campaign.stage) :])
        self.stage = campaign.stage
        """The current stage; None before the first."""
        self._stage: Stage | None = None

    def work(self) -> list[Work]:
        """Returns what to simulate next; empty while answers are awaited, and when the campaign is `finished`."""
        if not self._begun:
            self._begin()
        while self._stage is not None:
            work = self._stage.work()
            self.goes_on, self.asks_ahead, self.budget = self._stage.goes_on, self._stage.asks_ahead, self._stage.budget
            self.awaited, self.write_seconds = self._stage.awaited, self._stage.write_seconds
            if work or not self._stage.finished:
                return work
            self._stage = self._next(self._campaign())
        self.finished = True
        return []

    def _begin(self) -> None:
        rate_stored_runs(self._database, self._view)
        claims = self._take_claims()
        campaign = self._campaign()
        with self._database.read() as connection:  # what was known of the map when the campaign was submitted
            warnings = warnings_of(connection, self._problem, campaign.influence_map_id, campaign.created_at)
        notes = [*claims, *warnings]
        if notes:
            self._problem = replace(self._problem, notes=(*self._problem.notes, *notes))
        self._stage = self._next(campaign)
        self._begun = True

    def _take_claims(self) -> list[str]:
        """Takes the earlier versions whose runs answer cells into the view; returns notes on them."""
        if self._problem.specification.reduction.mode == "off":
            return []
        with self._database.read() as connection:
            bundle = self._problem.bench.bundle
            view = replace(self._view, earlier=earlier_versions(connection, self._problem.bench))
            unused = unclaimed(connection, bundle.digest, bundle.manifest)
        sampled = checkable(self._database, view, self._problem) if view.earlier else []
        used = tuple(version for version in view.earlier if any(each is version for each, *_ in sampled))
        self._view = replace(view, earlier=used)
        claims = ", ".join(dict.fromkeys(claim for version in used for claim in version.claims))
        checked = f"a sample of {len(sampled)} was checked by simulation in the stage claims"
        return [f"stored runs of earlier versions of the problem answer cells by {claims}: {checked}"] if used else unused

    def _campaign(self) -> StoredCampaign:
        with self._database.read() as connection:
            return campaigns.by_sequence(connection, self._sequence)

    def record(self, completed: Sequence[Completed]) -> list[Work]:
        """Stores results; returns what to simulate in their place."""
        return [] if self._stage is None else self._stage.record(completed)

    def _next(self, campaign: StoredCampaign) -> Stage | None:
        """Returns the next stage that the campaign wants; None when all are over."""
        while self._ahead:
            (kind, is_wanted), *self._ahead = self._ahead
            if is_wanted(campaign, self._problem):
                view = self._with_map(campaign) if kind.uses_map else self._view
                self.stage = kind.name
                return kind(self._database, campaign, self._problem, view)
        return None

    def _with_map(self, campaign: StoredCampaign) -> View:
        if campaign.influence_map_id is None:
            return self._view
        with self._database.read() as connection:
            stored = influence_maps.get(connection, campaign.influence_map_id)
        check_basis(stored, self._problem)
        return replace(self._view, influence_map=stored_map(stored), influence_map_sequence=stored.sequence)
