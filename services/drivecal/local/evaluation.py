"""The way of one parameter set through this process: resolved as by the server, simulated as by a worker."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from os import PathLike
from pathlib import Path
from threading import Lock

from drivecal.bundles.archives import content_digest, files_digest
from drivecal.bundles.installed import Bundle
from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.problem import resolve_evaluation
from drivecal.campaigns.resolve.workbench import installed_bundles, with_tools
from drivecal.configuration.problems import read_bundle
from drivecal.contracts.campaign import html_table
from drivecal.contracts.input_errors import validated
from drivecal.contracts.specification import DEFAULT_PROBLEM, EvaluationSpecification, Given
from drivecal.contracts.work import Batch, BatchResult, Cell
from drivecal.domain.errors import UnavailableError
from drivecal.domain.scales import plain
from drivecal.plugins.simulators import BusyError
from drivecal.runtime.compilation import prepare_cache
from drivecal.runtime.worker import Worker

_SIMULATION = Lock()
"""A process can hold a single SUMO simulation."""


@dataclass(frozen=True, slots=True)
class SimulatedCell:
    """The result in one scenario. `score`, `rating` and `metrics` are the same as in the server's answer.

    `failure` names why a run is worth a failed one. If the run broke down, `score` and `rating` are None and `error` says why.
    """

    scenario: str
    score: float | None
    rating: float | None
    metrics: Mapping[str, float]
    """Measures: of the motorway's runs with units in their names, of a problem its declared ones."""
    failure: str | None
    error: str | None
    milliseconds: float
    """CPU time."""


@dataclass(frozen=True, slots=True)
class LocalEvaluation:
    """The results of one parameter set, by scenario in the order asked for."""

    parameters: Mapping[str, Given]
    cells: Mapping[str, SimulatedCell]

    @property
    def scores(self) -> dict[str, float | None]:
        """The score in each scenario."""
        return {scenario: cell.score for scenario, cell in self.cells.items()}

    @property
    def objective(self) -> float | None:
        """The mean score over the scenarios; None without scenarios, and if one has no score."""
        scores = [cell.score for cell in self.cells.values() if cell.score is not None]
        return sum(scores) / len(scores) if 0 < len(scores) == len(self.cells) else None

    def _repr_html_(self) -> str:
        """Returns a table with a row per scenario; failures and errors have columns if there are any."""
        cells = self.cells.values()
        reasons = [name for name in ("failure", "error") if any(getattr(cell, name) is not None for cell in cells)]
        rows = []
        for cell in cells:
            told = {name: getattr(cell, name) for name in reasons}
            rows.append({"scenario": cell.scenario, "score": cell.score, **cell.metrics, **told})
        return html_table(rows)


def evaluate(
    parameters: Mapping[str, Given],
    scenarios: str | Sequence[str] | None = None,
    *,
    problem: str | PathLike[str] | None = None,
    catalogue: str | None = None,
    driving_function: str | None = None,
    vehicle: str | Mapping[str, object] | None = None,
    evaluator: str | None = None,
    seed: int = 1,
) -> LocalEvaluation:
    """Simulates a parameter set in the given scenarios, or in all of the catalogue. A random problem runs under the `seed`.

    `problem` is the folder of a problem of yours, which replaces the built-in motorway; `evaluator` is one of its scores, by default its
    first. Its simulator runs in a child process, as on a worker. `vehicle` is a model's name or the `vehicle` section of a campaign
    file. The first call on the motorway compiles, which takes some seconds.

    Raises InvalidInputError with everything that is wrong with the arguments, UnavailableError if this installation cannot simulate, and
    its subclass BusyError (`drivecal.plugins.simulators`) if the simulator is busy.
    """
    bundle = None if problem is None else _stored(Path(problem))
    document = {
        "parameters": dict(parameters),
        "problem": DEFAULT_PROBLEM if bundle is None else bundle.manifest.problem,
        "catalogue": catalogue,
        "driving_function": driving_function,
        "vehicle": {"model": vehicle} if vehicle is None or isinstance(vehicle, str) else dict(vehicle),
        "evaluator": evaluator,
        "seeds": [seed],
    }
    source = installed_bundles if bundle is None else lambda _: bundle
    names = [scenarios] if scenarios is None or isinstance(scenarios, str) else scenarios
    wanted = [validated(EvaluationSpecification, document | {"scenario": name}) for name in names]
    resolved = [resolve_evaluation(each, source) for each in wanted]
    to_probe = next((each.bench.to_probe for each in resolved), None)
    if to_probe is not None:
        source = with_tools(source, _answer(Batch(to_probe, ())).tools)
        resolved = [resolve_evaluation(each, source) for each in wanted]
    cells: dict[str, SimulatedCell] = {}
    for each in resolved:
        for scenario in each.bench.requests:
            cells[scenario] = _simulated(scenario, each.bench, Cell(0, each.parameter_set.floats))
    return LocalEvaluation(dict(parameters), cells)


def _stored(folder: Path) -> Bundle:
    """Returns the problem in a folder, ready to run. Raises InvalidInputError with all its faults."""
    manifest, archive = read_bundle(folder)
    bundle = Bundle(content_digest(archive), files_digest(archive), manifest)
    _worker().store(bundle.digest, archive)
    return bundle


def _simulated(scenario: str, bench: Bench, cell: Cell) -> SimulatedCell:
    (result,) = _answer(Batch(bench.requests[scenario], (cell,))).results
    rated = None if result.breakdown is not None else bench.rate_result(scenario, result)
    score, rating = (None, None) if rated is None else (plain(rated.score), rated.rating)
    error = None if result.breakdown is None else result.detail or result.breakdown
    return SimulatedCell(scenario, score, rating, result.metrics, result.failure, error, result.milliseconds)


def _answer(batch: Batch) -> BatchResult:
    """Returns the results of a batch. Raises UnavailableError if this installation cannot run it, BusyError if the simulator is busy."""
    with _SIMULATION:
        answer = _worker().run(batch)
    if answer.refusal is not None:
        raise UnavailableError(answer.refusal)
    if answer.busy is not None:
        raise BusyError(answer.busy)
    return answer


@cache
def _worker() -> Worker:
    prepare_cache()
    return Worker("local")
