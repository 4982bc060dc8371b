"""The objective of the peers' benchmark, in a module of its own: Ray and `multiprocessing` find it by name in their processes."""

from collections.abc import Mapping, Sequence
from functools import cache

from drivecal.domain.parameters import Parameter
from drivecal.highway.episode.runner import EpisodeRunner
from drivecal.plugins import registry

SCENARIOS = ("S1", "S2", "S3", "S4", "S5", "S6")


@cache
def runner(scenario: str) -> EpisodeRunner:
    """This process's runner of a scenario."""
    driving_function, vehicle = registry.driving_function("frenet"), registry.vehicle("single_track")
    nominal = {parameter.name: parameter.nominal for parameter in vehicle.parameters}
    return EpisodeRunner(
        registry.catalogue("highway").scenarios[scenario],
        driving_function,
        vehicle.create(nominal),
        registry.evaluator("reference"),
    )


@cache
def space() -> tuple[Parameter, ...]:
    """The parameters P1 to P11 with their grids, which all peers search."""
    return registry.driving_function("frenet").spaces["highway"]


def decoded(indices: Mapping[str, int]) -> list[float]:
    """The parameters' values at grid indices."""
    return [float(parameter.value(int(indices[parameter.name]))) for parameter in space()]


def scenarios_of(trial: int, cells_per_trial: int) -> Sequence[str]:
    """Returns what a trial simulates: all scenarios, or each in its turn."""
    return SCENARIOS if cells_per_trial == len(SCENARIOS) else (SCENARIOS[trial % len(SCENARIOS)],)


def objective(trial: int, parameters: Sequence[float], cells_per_trial: int) -> float:
    """The mean score of what the trial simulates."""
    scores = [runner(scenario).run(parameters).rating.score for scenario in scenarios_of(trial, cells_per_trial)]
    return sum(scores) / len(scores)


def warm_up() -> None:
    """Loads and compiles everything in this process."""
    objective(0, decoded({parameter.name: parameter.n_values // 2 for parameter in space()}), len(SCENARIOS))
