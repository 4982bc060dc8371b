"""The way of one parameter set through this process: resolved as by the server, simulated as by a worker."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from threading import Lock

from drivecal.campaigns.resolve.problem import resolve_evaluation
from drivecal.contracts.input_errors import validated
from drivecal.contracts.specification import EvaluationSpecification
from drivecal.contracts.work import Batch, Cell
from drivecal.domain.errors import UnavailableError
from drivecal.runtime.compilation import prepare_cache
from drivecal.runtime.worker import Worker

_SIMULATION = Lock()
"""A process can hold a single SUMO simulation."""


@dataclass(frozen=True, slots=True)
class SimulatedCell:
    """The result in one scenario. `score`, `rating` and `metrics` are those of the server's answer.

    `failure` names why a run scores 0. If the run broke down, `score` and `rating` are None and `error` says why.
    """

    scenario: str
    score: float | None
    rating: float | None
    metrics: Mapping[str, float]
    """Measured metrics, with units in their names."""
    failure: str | None
    error: str | None
    milliseconds: float
    """CPU time."""


@dataclass(frozen=True, slots=True)
class LocalEvaluation:
    """The results of one parameter set, by scenario in the order of the catalogue."""

    parameters: Mapping[str, float]
    cells: Mapping[str, SimulatedCell]

    @property
    def scores(self) -> dict[str, float | None]:
        """The score in each scenario."""
        return {scenario: cell.score for scenario, cell in self.cells.items()}

    @property
    def objective(self) -> float | None:
        """The mean score over the scenarios; None if a scenario has no score."""
        scores = [cell.score for cell in self.cells.values() if cell.score is not None]
        return sum(scores) / len(scores) if len(scores) == len(self.cells) else None


def evaluate(
    parameters: Mapping[str, float],
    scenarios: str | Sequence[str] | None = None,
    *,
    catalogue: str = "highway",
    driving_function: str = "frenet",
    vehicle: str | Mapping[str, object] = "single_track",
    evaluator: str = "reference",
) -> LocalEvaluation:
    """Simulates a parameter set in the given scenarios, or in all of the catalogue.

    `vehicle` is a model's name or the `vehicle` section of a campaign file. The first call compiles, which takes some seconds.

    Raises InvalidInputError with everything that is wrong with the arguments, and UnavailableError if this installation cannot simulate.
    """
    document = {
        "parameters": dict(parameters),
        "catalogue": catalogue,
        "driving_function": driving_function,
        "vehicle": {"model": vehicle} if isinstance(vehicle, str) else dict(vehicle),
        "evaluator": evaluator,
    }
    names = [scenarios] if scenarios is None or isinstance(scenarios, str) else scenarios
    problems = [resolve_evaluation(validated(EvaluationSpecification, document | {"scenario": name})) for name in names]
    cells: dict[str, SimulatedCell] = {}
    for problem in problems:
        for scenario, request in problem.bench.requests.items():
            cells[scenario] = _simulated(scenario, Batch(request, (Cell(0, problem.parameter_set.floats),)))
    return LocalEvaluation(dict(parameters), cells)


def _simulated(scenario: str, batch: Batch) -> SimulatedCell:
    with _SIMULATION:
        answer = _worker().run(batch)
    if answer.refusal is not None:
        raise UnavailableError(answer.refusal)
    (result,) = answer.results
    error = None if result.breakdown is None else result.detail or result.breakdown
    return SimulatedCell(scenario, result.score, result.rating, result.metrics, result.failure, error, result.milliseconds)


@cache
def _worker() -> Worker:
    prepare_cache()
    return Worker("local")
