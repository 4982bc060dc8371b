"""Robustness of solutions against the vehicle's parameters (Sections II-C and IV-D of the paper).

A solution is driven in vehicles drawn from a box around the nominal one, whose half width is a multiple k of delta, the parameters
being normalised to their bounds (Table 8). The degree of robustness is the largest k up to which the condition holds in all boxes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from drivecal.contracts.specification import RobustnessSpecification
from drivecal.contracts.tables import BoxTrial
from drivecal.domain.rounding import grains
from drivecal.domain.vehicles import VehicleParameter
from drivecal.plugins.ports import Floats

Condition = Literal["max", "mean"]
SIGNIFICANT = 12
"""Digits of a drawn value: enough for any vehicle, few enough to be read and typed again."""


def directions(count: int, samples: int, seed: int, box: int) -> Floats:
    """Returns a box's vehicles in the unit box [-1, 1]^n, shape (samples, count): a Latin hypercube of its own per box."""
    from scipy.stats import qmc

    generator = np.random.Generator(np.random.PCG64([seed, box]))
    points: Floats = 2.0 * qmc.LatinHypercube(count, rng=generator).random(samples) - 1.0
    return points


def vehicles(
    parameters: Sequence[VehicleParameter], nominal: Mapping[str, float], radius: float, points: Floats
) -> list[dict[str, float]]:
    """The vehicles at `points` of the unit box, shape (samples, n), around the nominal one; `radius`: half its width in shares of each
    parameter's range. What reaches beyond a bound lies between nominal value and bound, so that no vehicle is left out."""
    drawn = []
    for point in points.tolist():
        values = {}
        for parameter, towards in zip(parameters, point, strict=True):
            centre, width = nominal[parameter.name], radius * (parameter.maximum - parameter.minimum)
            room = parameter.maximum - centre if towards > 0 else centre - parameter.minimum
            value = float(f"{centre + towards * min(width, room):.{SIGNIFICANT}g}")
            values[parameter.name] = min(max(value, parameter.minimum), parameter.maximum)
        drawn.append(values)
    return drawn


def deviation(nominal: Floats, scores: Floats, condition: Condition, least: float = 1.0) -> Floats:
    """Returns what the condition compares with eta, shape (n_s,), for scores `nominal` in the nominal vehicle, shape (n_s,), or under the
    seed of each other vehicle, shape (samples, n_s), and `scores`, shape (samples, n_s), in the others: the largest change, or the mean
    one relative to the nominal score, which counts as at least `least`. NaN if one has no result."""
    away = np.abs(scores - nominal)
    if condition != "max":
        size = np.broadcast_to(np.maximum(np.abs(nominal), least), away.shape)
        away = np.divide(away, size, out=np.where(away > 0, np.inf, away), where=size > 0)  # 0 / 0: no change
    return np.asarray(away.mean(axis=0) if condition == "mean" else away.max(axis=0), dtype=np.float64)


def holds(deviations: Floats, nominal: Floats, settings: RobustnessSpecification) -> bool:
    """Returns whether the condition holds in every scenario; false if a vehicle has no result. The rounding errors of the `deviations`
    follow from the size of the scores in the nominal vehicle, `nominal`."""
    if settings.eta is None:
        raise ValueError("the settings are on no scale yet")
    room = grains(np.atleast_2d(nominal), settings.eta).max(axis=0)
    within = deviations <= settings.eta + room if settings.condition == "max" else deviations < settings.eta
    return bool(within.all())  # a comparison with NaN is false


def undetected_share(samples: int, compared: int = 1) -> float:
    """Returns an upper 95 % limit of the share of failing vehicles in a box without a failure among `samples` independent vehicles. The
    boxes may decide which of `compared` sets is chosen."""
    return float(1.0 - ((1.0 - 0.95) / max(1, compared)) ** (1.0 / samples))


def vehicles_text(settings: Mapping[str, Any], compared: int, replicates: int = 1) -> str:
    """Returns a sentence about vehicles that were not simulated, in a box that holds. The recommended set was chosen by its boxes from
    `compared` examined sets, all with vehicles in the same directions. `replicates`: number of seeds."""
    samples = settings["samples"]
    seeds = "Each vehicle has a seed, and is compared with the nominal one under that seed. " if replicates > 1 else ""
    if settings["condition"] == "mean":
        return (
            f"{seeds}A box holds if the mean over the vehicles simulated in it ({samples:,}) holds in every scenario; "
            "a single vehicle may change more."
        )
    return (
        f"{seeds}A box holds if the condition holds in every vehicle simulated in it ({samples:,}): up to "
        f"{100 * undetected_share(samples):.1f} % of all vehicles in a box may still break it if its set was chosen beforehand, and up to "
        f"{100 * undetected_share(samples, compared):.1f} % in a box of the recommended set, chosen from {compared:,} (95 % each)."
    )


@dataclass(frozen=True, slots=True)
class Box:
    """The next box, of half width `radius`: its vehicles, and the solutions to drive in them. `number` counts from 1."""

    number: int
    radius: float
    solutions: Sequence[int]
    vehicles: Sequence[Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class Robustness:
    """Robustness of one solution, so far. The condition holds up to `degree` multiples of delta, or more with `at_least`. `radius` is the
    half width of the widest simulated box that holds, in shares of the parameters' ranges (delta_max, from below)."""

    degree: int
    at_least: bool
    radius: float
    trials: tuple[BoxTrial, ...]


def failing_at_most(known: Robustness, settings: RobustnessSpecification, compared: int) -> float | None:
    """Returns the share of vehicles in the widest box that holds which may break the condition (95 %), whichever of `compared` sets is
    chosen. None if no box holds, or if the condition is one of means."""
    return undetected_share(settings.samples, compared) if known.radius > 0 and settings.condition == "max" else None


class RobustnessStudy:
    """Ask/tell: growing boxes for all solutions at once, each until its condition fails.

    A new study with the same answers continues in the same way.
    """

    def __init__(
        self,
        nominal_scores: Floats,
        scenarios: Sequence[str],
        parameters: Sequence[VehicleParameter],
        nominal: Mapping[str, float],
        settings: RobustnessSpecification,
        least: float = 1.0,
    ) -> None:
        """`nominal_scores`: scores in the nominal vehicle, shape (n_solutions, n_s), or by seed. `least`: see `deviation`."""
        self._scores, self._scenarios = nominal_scores, scenarios
        self._parameters, self._nominal, self._settings = parameters, nominal, settings
        self._least = least
        self._trials: list[list[BoxTrial]] = [[] for _ in nominal_scores]
        self._asked: Box | None = None
        self._boxes = 0

    def ask(self) -> Box | None:
        """Returns the next box, the same until its scores arrive. None when the study is complete."""
        if self._asked is None:
            left = [solution for solution, trials in enumerate(self._trials) if all(trial.holds for trial in trials)]
            if not left or self._boxes == self._settings.steps:
                return None
            number, radius = self._boxes + 1, (self._boxes + 1) * self._settings.delta
            points = directions(len(self._parameters), self._settings.samples, self._settings.seed, number)
            self._asked = Box(number, radius, left, vehicles(self._parameters, self._nominal, radius, points))
        return self._asked

    def tell(self, scores: Mapping[int, Floats]) -> None:
        """The scores of the asked solutions in their vehicles, shape (samples, n_s) each, NaN for cells without a result."""
        if self._asked is None:
            raise RuntimeError("ask first")
        for solution in self._asked.solutions:
            away = deviation(self._scores[solution], scores[solution], self._settings.condition, self._least)
            sizes = {name: None if np.isnan(size) else size for name, size in zip(self._scenarios, away.tolist(), strict=True)}
            is_kept = holds(away, self._scores[solution], self._settings)
            trial = BoxTrial(box=self._asked.number, radius=self._asked.radius, holds=is_kept, deviations=sizes)
            self._trials[solution].append(trial)
        self._boxes, self._asked = self._asked.number, None

    def result(self) -> list[Robustness]:
        """Returns the robustness by solution, as far as it is known."""
        return [self._robustness(trials) for trials in self._trials]

    def _robustness(self, trials: Sequence[BoxTrial]) -> Robustness:
        inside = [trial.radius for trial in trials if trial.holds]
        return Robustness(len(inside), len(inside) == self._settings.steps, max(inside, default=0.0), tuple(trials))


def key_of(parameters: Mapping[str, float | str]) -> tuple[tuple[str, float | str], ...]:
    """Returns a key of a parameter set, to compare the rows of two studies."""
    return tuple(sorted(parameters.items()))
