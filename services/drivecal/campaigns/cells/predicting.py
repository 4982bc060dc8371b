"""Predicts the cells of a calibration batch by batch, and accepts predictions in lots.

A batch is a slice of the start population or a later generation. Its predictors learn from all earlier
answers that were simulated, so lots depend on stored rows, never on the order of answers. The stored times of simulations decide whether
predictions pay: they begin when their expected saving to the end of the search exceeds their cost.
"""

import math
import os
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from itertools import groupby
from statistics import fmean

import numpy as np
from sqlalchemy import Connection

from drivecal.campaigns.cells import earlier
from drivecal.campaigns.cells.planning import View
from drivecal.contracts.campaign import Released
from drivecal.contracts.specification import ReductionSpecification
from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import INSPECTED, CellScore, Donor, Outcome, RequestedCell
from drivecal.domain.parameters import ParameterSet, ParameterSpace
from drivecal.domain.scales import Scale, plain
from drivecal.reduction.assignment import LIKELY
from drivecal.reduction.lots import SamplingPlan, most_released
from drivecal.reduction.prediction import (
    FEWEST_KNOWN,
    MOST_KNOWN,
    REFIT,
    FeatureSpace,
    Floats,
    Lot,
    Predictions,
    Predictor,
    ScenarioLearner,
    choose_lot,
)
from drivecal.storage import evaluations, lots
from drivecal.storage.engine.types import ORDER
from drivecal.storage.lots import KnownAnswer, LotVerdict, NewLot, StoredLot
from drivecal.storage.references import parameter_sets, runs, setups

SMALLEST_SLICE, LARGEST_SLICE, SLICES = FEWEST_KNOWN, 250, 4
"""Fewest and most sets, and wanted number of slices, of a start population that is learned from slice by slice. After a smaller slice too
little would be known for a prediction, and the workers would have waited for its last cell in vain."""
REACH = 2.0
"""Standard deviations on the better side of its believed objective at which a set is within reach of the best one."""


def slice_size(population: int) -> int:
    """Sets of the start population in one batch."""
    return max(SMALLEST_SLICE, min(LARGEST_SLICE, -(-population // SLICES)))


BatchPlace = tuple[int, int, int]


def batch_of(stage: StageName, iteration: int, individual: int, size: int) -> BatchPlace:
    """Returns the batch of a cell, comparable with others: stage, iteration, slice of `size` sets in the start population."""
    return ORDER[stage], iteration, individual // size if iteration == 0 else 0


@dataclass(frozen=True, slots=True)
class _Forecast:
    """Predictions of a scenario for every set of a batch; rows follow the batch."""

    predictions: Predictions
    error_rates: Floats
    known: int
    seconds: float


_LOADING = threading.Thread(target=import_module, args=("drivecal.reduction.forest",), name="predictors", daemon=True)
"""Loads the default predictors: scikit-learn takes seconds, which other campaigns do not wait for."""


def _predictor(scale: Scale, tolerance: float) -> Predictor:
    """Returns an untrained predictor."""
    from drivecal.reduction.forest import predictor_on

    return predictor_on(scale, tolerance)()


class LotPlanner:
    """The predictors of one calibration."""

    def __init__(
        self,
        view: View,
        space: ParameterSpace,
        reduction: ReductionSpecification,
        weights: Mapping[str, float],
        population: int,
    ) -> None:
        self._view = view
        self._reduction = reduction
        self._weights = weights
        self._population, self._slice = population, slice_size(population)
        self._features = FeatureSpace(space, view.names)
        self._tolerance = reduction.tolerance_on(view.bench.scale)
        kind = partial(_predictor, view.bench.scale, self._tolerance)
        self._learners = {scenario: ScenarioLearner(kind, self._tolerance + view.bench.scale.grain) for scenario in weights}
        self._lots_so_far: Sequence[StoredLot] = ()
        self._occupied: dict[str, tuple[int, int]] = {}
        """Cells that runs answered, and the microseconds for which these runs occupied workers, by scenario."""
        self._counted = 0
        """Id of the newest of these cells."""
        self._newest: int | None = None
        self._parts: list[KnownAnswer] = []
        """Answers of a batch with cells that are not asked yet."""
        self._recent_seconds = 0.0
        self._rows: dict[int, int] = {}
        self._forecasts: dict[str, _Forecast] = {}
        self._chosen: set[str] = set()
        """Scenarios whose predictions pay."""
        self.off: str | None = None
        """The reason why predictions are off; None while too little is known, and once they have begun."""

    def learn(self, connection: Connection, still_asked: tuple[int, int] | None = None) -> None:
        """Reads the answers and lots since the last call. No cell of the campaign may wait for its answer.

        `still_asked`: iteration and individual of the next cell. If the budget cut its batch, the answers of the first part are learned
        together with the rest, as a process that takes over learns them.
        """
        self._lots_so_far = lots.of_campaign(connection, self._view.campaign, Outcome.PREDICTED)
        occupied, self._counted = evaluations.occupied(connection, self._view.campaign, self._counted)
        for scenario, (cells, microseconds) in occupied.items():
            before = self._occupied.get(scenario, (0, 0))
            self._occupied[scenario] = before[0] + cells, before[1] + microseconds
        fingerprints = sorted(self._view.bench.fingerprints)
        if self._newest is None:
            self._newest = 0
            self._recent_seconds = (runs.recent_milliseconds(connection, fingerprints) or 0.0) / 1000
            for scenario, learner in self._learners.items():
                view = self._view
                rated = earlier.rated(connection, view.bench, view.earlier, scenario, view.watermark, MOST_KNOWN)
                known = [run for run in rated if self._features.holds(run.parameters)]
                if known:
                    self._learn(learner, known)
        setup_ids = setups.ids(connection, fingerprints).values()
        answers, self._newest = lots.known_answers(connection, self._view.campaign, setup_ids, self._newest)
        by_scenario: dict[str, list[KnownAnswer]] = defaultdict(list)
        for answer in (*self._parts, *answers):
            by_scenario[answer.scenario].append(answer)
        self._parts = []
        following = None if still_asked is None else batch_of(StageName.CALIBRATION, *still_asked, self._slice)
        for scenario, listed in by_scenario.items():
            for at, batch in groupby(listed, lambda each: batch_of(each.stage, each.iteration, each.individual, self._slice)):
                if at == following:
                    self._parts += batch
                else:
                    self._take(self._learners[scenario], list(batch))

    def is_ready(self, sets: float, batches: float) -> bool:
        """Chooses the scenarios whose predictions pay. Returns whether the library of predictors is loaded. Call it after `learn`.

        Args:
            sets: number of sets that the search will probably still request.
            batches: number of their batches.
        """
        known = {scenario: learner.known for scenario, learner in self._learners.items() if learner.trained_on}
        served = {scenario: [lot for lot in self._lots_so_far if lot.scenario == scenario] for scenario in known}
        expected = {
            name: expected_saving(served[name], count, (sets, batches), len(self._view.names), self._cell_seconds(name))
            for name, count in known.items()
        }
        paying = {name for name, (saved, cost) in expected.items() if saved > cost}
        loading = 0.0 if self._lots_so_far else LOADING_SECONDS
        pay = sum(saved - cost for saved, cost in map(expected.__getitem__, paying)) > loading
        self._chosen = paying if pay else set()
        if batches > 1.0 or not self._lots_so_far:
            self.off = self._reason({name: pair for name, pair in expected.items() if name not in self._chosen}, loading)
        if not self._chosen:
            return True
        if _LOADING.ident is None:
            _LOADING.start()
            self._view.reuse_time.seconds += LOADING_SECONDS
        return not _LOADING.is_alive()

    def _reason(self, left_out: Mapping[str, tuple[float, float]], loading: float) -> str | None:
        """Returns why predictions are off in scenarios with these savings and costs; None without such a scenario."""
        saved, cost = (sum(pair[part] for pair in left_out.values()) for part in (0, 1))
        words = f"they would probably save {saved:,.2g} s of simulations, and take {cost + loading:,.2g} s of CPU time"
        return f"predictions are off in {', '.join(left_out)}: {words}" if left_out else None

    def _cell_seconds(self, scenario: str) -> float:
        """Returns the mean time for which runs of a scenario's cells occupied workers; before the first, that of the newest stored runs."""
        cells, microseconds = self._occupied.get(scenario, (0, 0))
        return microseconds / cells / 1e6 if cells else self._recent_seconds

    def _learn(self, learner: ScenarioLearner, answers: Sequence[KnownAnswer | runs.RatedRun]) -> Floats:
        """Returns the scores of the answers, shape (n,)."""
        scores: Floats = np.array([each.score for each in answers], dtype=np.float64)
        ratings = np.array([each.rating for each in answers], dtype=np.float64)
        learner.learn(self._features([each.parameters for each in answers]), scores, ratings)
        return scores

    def _take(self, learner: ScenarioLearner, batch: Sequence[KnownAnswer]) -> None:
        scores = self._learn(learner, batch)
        asked = [place for place, answer in enumerate(batch) if answer.predicted_score is not None]
        if asked:
            predicted = np.array([batch[place].predicted_score for place in asked], dtype=np.float64)
            confidence = np.array([batch[place].confidence for place in asked], dtype=np.float64)
            weight = np.array([batch[place].stands_for for place in asked], dtype=np.float64)
            learner.observe(predicted, confidence, scores[asked], weight)

    def predict(self, sets: Mapping[int, ParameterSet]) -> None:
        """Predicts a batch, by individual, in scenarios whose predictions pay. It takes seconds: call it outside of any transaction, once
        `is_ready`."""
        self._predict(sets, sorted(self._chosen))

    def _predict(self, sets: Mapping[int, ParameterSet], asked: Sequence[str]) -> None:
        self._rows, self._forecasts = {number: row for row, number in enumerate(sets)}, {}
        if not sets:
            return
        features = self._features(list(sets.values()))

        def forecast(scenario: str) -> _Forecast | None:
            began = time.thread_time()
            learner = self._learners[scenario]
            predicted = learner.predict(features)
            return None if predicted is None else _Forecast(*predicted, learner.trained_on, time.thread_time() - began)

        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            forecasts = dict(zip(asked, pool.map(forecast, asked), strict=True))
        self._forecasts = {scenario: each for scenario, each in forecasts.items() if each is not None}

    def worth_a_look(
        self,
        connection: Connection,
        dismissed: Mapping[int, Mapping[str, CellScore]],
        best: float | None,
        reaches: Callable[[Mapping[str, CellScore]], bool] | None = None,
    ) -> list[int]:
        """Returns the ids of the sets that the predictors, with all answers, believe within reach of the best one, in their order.

        Args:
            connection: no cell of the campaign waits for its answer.
            dismissed: answers by scenario of sets with predicted scores, by their ids.
            best: see `plan`.
            reaches: see `plan`.
        """
        self.learn(connection)
        parameters = parameter_sets.load(connection, list(dismissed))
        self._predict({number: parameters[number] for number in dismissed}, list(self._learners))
        self._view.reuse_time.seconds += sum(forecast.seconds for forecast in self._forecasts.values())
        cells = [
            RequestedCell(
                number,
                scenario,
                parameters[number],
                donor=None if answer.predicted else Donor(0, 0, answer.score or 0.0, 0.0, None),
            )
            for number, answers in dismissed.items()
            for scenario, answer in answers.items()
        ]
        reaching = self._promoted(cells, best) if reaches is None or best is None else self._reaching(cells, reaches)
        return [number for number in dismissed if number in reaching]

    def released(self, connection: Connection) -> dict[str, Released]:
        """Sums up the lots with a verdict, by scenario."""
        stored = lots.of_campaign(connection, self._view.campaign, Outcome.PREDICTED)
        sizes = lots.error_sizes(connection, self._view.campaign)
        return released_by_scenario(stored, self._learners, self._reduction.limit, sizes)

    def plan(
        self,
        connection: Connection,
        cells: Sequence[RequestedCell],
        best: float | None,
        whole: Collection[int],
        reaches: Callable[[Mapping[str, CellScore]], bool] | None = None,
    ) -> list[RequestedCell]:
        """Stores the batch's lots, and returns its cells with accepted predictions in the place of simulations.

        All cells of the individuals in `whole` are simulated, and of sets that may reach the `best` simulated objective, or with `reaches`
        the front. Audited cells are simulated as well, and cells that answer others.
        """
        if not self._forecasts or not cells:
            return list(cells)
        reaching = self._promoted(cells, best) if reaches is None or best is None else self._reaching(cells, reaches)
        promoted = {*whole, *reaching}
        leading = {cell.leader for cell in cells if cell.leader is not None}
        planned = list(cells)
        accepted: dict[str, Lot | None] = {}
        members: dict[str, list[int]] = {}
        for scenario, forecast in self._forecasts.items():
            here = [
                place
                for place, cell in enumerate(cells)
                if cell.scenario == scenario
                and cell.plan is Outcome.SIMULATED
                and cell.purpose not in INSPECTED
                and cell.individual in self._rows
            ]
            for place in here:
                row = self._rows[cells[place].individual]
                planned[place] = replace(
                    cells[place],
                    predicted_score=plain(forecast.predictions.scores[row]),
                    predicted_rating=float(forecast.predictions.ratings[row]),
                    confidence=float(forecast.predictions.confidence[row]),
                )
            candidates = [place for place in here if place not in leading and cells[place].individual not in promoted]
            rows = [self._rows[cells[place].individual] for place in candidates]
            if not rows:  # every answer is known: that is no failure of the predictor, and no empty lot may say so
                self._view.reuse_time.seconds += forecast.seconds
                continue
            lot = choose_lot(forecast.error_rates[rows], self._reduction.limit)
            accepted[scenario] = lot
            members[scenario] = [] if lot is None else [candidates[position] for position in lot.members]
        stored = lots.insert(connection, self._view.campaign, [self._new(cells[0], *pair) for pair in accepted.items()])
        for places, number in zip(members.values(), stored, strict=True):
            for place in places:
                planned[place] = replace(planned[place], plan=Outcome.PREDICTED, lot=number)
        return planned

    def _new(self, first: RequestedCell, scenario: str, lot: Lot | None) -> NewLot:
        plan = SamplingPlan(0, 0, 0) if lot is None else lot.plan
        forecast = self._forecasts[scenario]
        promised = plan.size, plan.sample, plan.acceptance, self._tolerance, self._reduction.limit
        cost = forecast.known, forecast.seconds
        return NewLot(first.iteration, first.individual, scenario, *promised, *cost, Outcome.PREDICTED)

    def _promoted(self, cells: Sequence[RequestedCell], best: float | None) -> set[int]:
        """Individuals whose predicted objective reaches the best simulated one, or whose mean one is less than `REACH` standard deviations
        worse; without a simulated one, the individual that is believed to be the best. Without a prediction, the newest known scores of
        the scenario give mean and deviation."""
        sign = self._view.bench.scale.sign
        predicted: dict[int, float] = defaultdict(float)
        means: dict[int, float] = defaultdict(float)
        variances: dict[int, float] = defaultdict(float)
        for cell, score, mean, variance in self._believed(cells):
            predicted[cell.individual] += self._weights[cell.scenario] * score
            means[cell.individual] += self._weights[cell.scenario] * mean
            variances[cell.individual] += self._weights[cell.scenario] ** 2 * variance
        hoped = {
            individual: max(sign * predicted[individual], sign * mean + REACH * math.sqrt(variances[individual]))
            for individual, mean in means.items()
        }
        if best is None:  # nothing to compare with would ever be simulated whole
            return {max(hoped, key=lambda individual: hoped[individual])}
        return {individual for individual, hope in hoped.items() if hope >= sign * best - self._view.bench.scale.grain}

    def _believed(self, cells: Sequence[RequestedCell]) -> Iterator[tuple[RequestedCell, float, float, float]]:
        """Yields each cell with its believed score, the mean and the variance."""
        prior = {scenario: learner.newest() for scenario, learner in self._learners.items() if scenario not in self._forecasts}
        for cell in cells:
            if cell.donor is not None and cell.purpose not in INSPECTED:
                yield cell, float(cell.donor.score), float(cell.donor.score), 0.0
            elif cell.scenario in prior:
                mean, variance = prior[cell.scenario]
                yield cell, mean, mean, variance
            else:
                predictions, row = self._forecasts[cell.scenario].predictions, self._rows[cell.individual]
                yield cell, float(predictions.scores[row]), float(predictions.mean[row]), float(predictions.variance[row])

    def _reaching(self, cells: Sequence[RequestedCell], reaches: Callable[[Mapping[str, CellScore]], bool]) -> set[int]:
        """Individuals that reach the front with the better of their believed scores and `REACH` standard deviations beyond their means."""
        sign = self._view.bench.scale.sign
        hoped: dict[int, dict[str, CellScore]] = defaultdict(dict)
        for cell, score, mean, variance in self._believed(cells):
            value = sign * max(sign * score, sign * mean + REACH * math.sqrt(variance))
            hoped[cell.individual][cell.scenario] = CellScore(
                cell.parameter_set_id, cell.scenario, value, value, own=False, iteration=0, individual=cell.individual
            )
        return {individual for individual, scores in hoped.items() if reaches(scores)}


CHANGED = 0.3
"""Share of a population that a generation requests, if unknown: the share of the paper's genetic algorithm at most."""
RECENT_LOTS = 6
"""Number of a scenario's last lots that, together with LIKELY, predict the saving of the next lots."""
LOADING_SECONDS = 2.0
"""CPU time of loading the predictors. Each campaign counts it, so that its decision is the same in every process."""


TRAINING_SECONDS, SECONDS_PER_ANSWER, SECONDS_PER_VALUE = 0.015, 20e-6, 4e-6
"""CPU time of a training: in any case, for each known answer, and for each of its parameters. Usual times replace measured ones: a killed
dispatcher trains once more, and measured times would give its campaign other lots."""
ASKING_SECONDS = 0.01
"""CPU time of a batch's predictions."""


def expected_saving(
    served: Sequence[StoredLot], known: int, ahead: tuple[float, float], parameters: int, cell_seconds: float
) -> tuple[float, float]:
    """Returns the seconds of simulations that predictions of a scenario would probably save, and the CPU seconds that they would take, to
    the end of the search.

    Args:
        served: lots so far. The last ones tell how much the next ones save.
        known: answers, at least 1.
        ahead: sets that the search will probably still request, and the number of their batches.
        parameters: their number.
        cell_seconds: time of a simulation.
    """
    sets, batches = ahead[0], max(ahead[1], 1.0)
    saved = min(fmean([LIKELY * sets / batches, *(lot.released for lot in served[-RECENT_LOTS:])]) * batches, sets)
    is_due = not served or known >= REFIT * served[-1].known
    end = known + (sets - saved) * (1.0 - 1.0 / batches)  # nothing is trained after the last batch
    trainings = min(batches, is_due + math.log(end / known, REFIT))
    return saved * cell_seconds, trainings * training_seconds((known + round(end)) // 2, parameters) + ASKING_SECONDS * batches


def training_seconds(known: int, parameters: int) -> float:
    """Returns the usual CPU time of a training on `known` answers."""
    return TRAINING_SECONDS + min(known, MOST_KNOWN) * (SECONDS_PER_ANSWER + SECONDS_PER_VALUE * parameters)


def released_by_scenario(
    stored: Sequence[StoredLot], scenarios: Iterable[str], limit: float, sizes: Mapping[str, tuple[float, float]]
) -> dict[str, Released]:
    """Sums up lots with a verdict; `sizes`: mean and largest errors by scenario, see `lots.error_sizes`."""
    of = {name: [lot for lot in stored if lot.scenario == name] for name in scenarios}
    return {name: _released(lots, limit, *sizes.get(name, (None, None))) for name, lots in of.items()}


def _released(stored: Sequence[StoredLot], limit: float, mean_error: float | None, largest_error: float | None) -> Released:
    inspected = [lot for lot in stored if lot.verdict is not None]
    released = sum(lot.released for lot in inspected)
    plans = [(SamplingPlan(lot.size, lot.sample, lot.acceptance), lot.errors or 0) for lot in inspected]
    return Released(
        asked=len(stored),
        inspected=sum(lot.size for lot in inspected),
        lots=len(inspected),
        rejected=sum(lot.verdict is LotVerdict.REJECTED for lot in inspected),
        predicted=released,
        sampled=sum(lot.sample for lot in inspected),
        different=sum(lot.errors or 0 for lot in inspected),
        mean_error=mean_error,
        largest_error=largest_error,
        limit=limit,
        upper_95=most_released(plans) / released if released else None,
        seconds=sum(lot.seconds for lot in stored),
    )
