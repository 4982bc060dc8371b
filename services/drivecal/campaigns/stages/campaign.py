"""A whole campaign, its stages in sequence, each resumed from the database; and a single evaluation."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from drivecal.campaigns.cells.earlier import bench_of, checked_cells, earlier_versions, unclaimed
from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.cells.rerating import rate_stored_runs
from drivecal.campaigns.resolve.maps import check_basis, stored_map, warnings_of
from drivecal.campaigns.resolve.problem import CalibrationProblem, EvaluationProblem
from drivecal.campaigns.stages.cell_search import CellSearch
from drivecal.campaigns.stages.claims import ClaimCheck, checkable, compare
from drivecal.campaigns.stages.outside import OutsideSearch
from drivecal.campaigns.stages.population_search import PopulationSearch
from drivecal.campaigns.stages.prediction_validation import PredictionValidation
from drivecal.campaigns.stages.replication import SeededBenches
from drivecal.campaigns.stages.robustness import RobustnessStage
from drivecal.campaigns.stages.sensitivity import Sensitivity
from drivecal.campaigns.stages.stage import Round, Stage, Wait
from drivecal.campaigns.stages.validation import ValidationStage
from drivecal.contracts.specification import ReductionSpecification
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import InvalidInputError, NoResultError
from drivecal.domain.evaluations import Purpose, RequestedCell
from drivecal.execution.scheduling.in_flight import Completed, Work
from drivecal.optimizers.built_in import External
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps


class SingleEvaluation(Stage):
    """A parameter set in one or more scenarios, under its seeds. Answers come from equal parameter sets or a simulation, never by reuse;
    with time series or if it is to be `fresh`, always from a new simulation."""

    name = StageName.CALIBRATION
    ends_early = False
    _problem: EvaluationProblem

    def __init__(self, database: Database, campaign: StoredCampaign, problem: EvaluationProblem, view: View) -> None:
        is_new = view.traced or problem.specification.fresh
        with database.read() as connection:
            versions = () if is_new else earlier_versions(connection, problem.bench)
            cells = checked_cells(connection, problem.bench) if versions else []
        for version in versions:
            rate_stored_runs(database, replace(view, bench=bench_of(version, problem.bench)))
        compared = [(version, *compare(database, view, [version], cells)) for version in versions]
        checked = tuple(version for version, number, faults in compared if number and not faults)
        super().__init__(database, campaign, problem, replace(view, earlier=checked))
        self._unchecked = [version for version in versions if version not in checked]
        self._is_new, self._benches = is_new, SeededBenches(problem.bench)
        self._asked = False

    @property
    def _at_most(self) -> int:
        return len(self._problem.bench.scenarios) * len(self._problem.seeds)

    def _resume(self) -> list[Work]:
        for bench in () if self._view.traced else map(self._benches.of, self._problem.seeds):
            rate_stored_runs(self._database, replace(self._view, bench=bench), only=self._problem.parameter_set)
        self._rated.update(self._benches.of(seed).fingerprints for seed in self._problem.seeds)
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
        return Round(0, self._benches.with_cells(cells), ReductionSpecification(mode="off" if self._is_new else "exact"))

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


Wanted = Callable[[StoredCampaign, CalibrationProblem], bool]


def _wants_validation(problem: CalibrationProblem, *, of_predictions: bool) -> bool:
    wanted = problem.specification.validation
    return wanted is not None and (wanted.of is not None) == of_predictions


def _search(problem: CalibrationProblem) -> type[Stage] | None:
    """Returns the kind of search that a campaign wants, if it wants one."""
    if problem.optimization is None:
        return None
    if isinstance(problem.optimization.plugin, External):
        return OutsideSearch
    return PopulationSearch if problem.optimization.has_populations else CellSearch


STAGES: tuple[tuple[type[Stage], Wanted], ...] = (
    (ClaimCheck, lambda _, problem: problem.bench.bundle.manifest.claims),
    (Sensitivity, lambda campaign, problem: campaign.influence_map_id is None and problem.analysis() is not None),
    (PopulationSearch, lambda _, problem: _search(problem) is PopulationSearch),
    (CellSearch, lambda _, problem: _search(problem) is CellSearch),
    (OutsideSearch, lambda _, problem: _search(problem) is OutsideSearch),
    (RobustnessStage, lambda _, problem: problem.specification.robustness is not None),
    (ValidationStage, lambda _, problem: _wants_validation(problem, of_predictions=False)),
    (PredictionValidation, lambda _, problem: _wants_validation(problem, of_predictions=True)),
)
"""In running order, each with whether a campaign wants it and does not have its outcome already."""


class StagedCampaign:
    """The stages of a campaign, one after the other. The database holds all state after every call."""

    def __init__(self, stages: Iterator[Stage]) -> None:
        """`stages`: each is taken when the one before is complete."""
        self._stages = stages
        self.wait: Wait = "answers"
        self.stage = next(stages, None)
        """The running stage; None after the last."""

    def work(self) -> list[Work]:
        """Returns what to simulate next; `wait` says what the running stage waits for then."""
        while self.stage is not None:
            work, self.wait = self.stage.work()
            if self.wait != "nothing":
                return work
            self.stage = next(self._stages, None)
        return []

    def record(self, completed: Sequence[Completed]) -> list[Work]:
        """Stores results; returns what to simulate in their place."""
        return [] if self.stage is None else self.stage.record(completed)


def stages_of(database: Database, campaign: StoredCampaign, problem: CalibrationProblem, workers: int = 1) -> Iterator[Stage]:
    """Yields the current stage of a campaign and the later stages that it wants. A sensitivity stage ends with an influence map.

    Args:
        database: where the rows are.
        campaign: its rows at present.
        problem: what it calibrates.
        workers: their number at present.
    """
    seed = 0 if problem.optimization is None else problem.optimization.seed
    isolated = problem.specification.reduction.isolated
    scores = [value for value in problem.goals.computed.values() if value.scale is not None]
    view = View(campaign.sequence, campaign.watermark or 0, problem.bench, scores, isolated, workers=workers, seed=seed)
    rate_stored_runs(database, view)
    view, claims = _with_claims(database, view, problem)
    # what was known of the map when the campaign was submitted
    warnings = database.query(warnings_of, problem, campaign.influence_map_id, campaign.created_at)
    problem = replace(problem, notes=(*problem.notes, *claims, *warnings))
    names = [kind.name for kind, _ in STAGES]
    for kind, is_wanted in STAGES if campaign.stage is None else STAGES[names.index(campaign.stage) :]:
        campaign = database.query(campaigns.by_sequence, campaign.sequence)
        if is_wanted(campaign, problem):
            yield kind(database, campaign, problem, _with_map(database, view, campaign, problem) if kind.uses_map else view)


def _with_claims(database: Database, view: View, problem: CalibrationProblem) -> tuple[View, list[str]]:
    """Returns the view with the earlier versions whose runs answer cells, and notes on them."""
    if problem.specification.reduction.mode == "off":
        return view, []
    with database.read() as connection:
        bundle = problem.bench.bundle
        view = replace(view, earlier=earlier_versions(connection, problem.bench))
        unused = unclaimed(connection, bundle.digest, bundle.manifest)
    sampled = checkable(database, view, problem) if view.earlier else []
    used = tuple(version for version in view.earlier if any(each is version for each, *_ in sampled))
    claims = ", ".join(dict.fromkeys(claim for version in used for claim in version.claims))
    checked = f"a sample of {len(sampled)} was checked by simulation in the stage claims"
    notes = [f"stored runs of earlier versions of the problem answer cells by {claims}: {checked}"] if used else unused
    return replace(view, earlier=used), notes


def _with_map(database: Database, view: View, campaign: StoredCampaign, problem: CalibrationProblem) -> View:
    if campaign.influence_map_id is None:
        return view
    stored = database.query(influence_maps.get, campaign.influence_map_id)
    check_basis(stored, problem)
    return replace(view, influence_map=stored_map(stored), influence_map_sequence=stored.sequence)
