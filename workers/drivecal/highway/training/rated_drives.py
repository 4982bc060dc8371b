"""Manoeuvres for training the comfort evaluator: runs of the built-in scenarios and synthetic profiles, rated by the reference scale."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from drivecal.domain.evaluations import Rating
from drivecal.highway.comfort import reference
from drivecal.highway.comfort.metrics import comfort_metrics
from drivecal.highway.comfort.reference import Manoeuvre
from drivecal.highway.comfort.rocket import Integers, channels_of
from drivecal.highway.drive.tasks import TaskRunner
from drivecal.highway.planner.plugin import FRENET
from drivecal.highway.scenarios import HIGHWAY
from drivecal.highway.training.multibody import smooth
from drivecal.highway.vehicle.model import HybridModel, SingleTrackModel
from drivecal.highway.vehicle.parameters import NOMINAL
from drivecal.highway.vehicle.residual import shipped
from drivecal.plugins.ports import Floats, Series

STEP = 0.1
FINE = 0.01
IDLE = 0.15
"""Share of profiles without a change of lane or speed, and without each disturbance, so that training includes calm drives."""


@dataclass(frozen=True, slots=True)
class RatedDrive:
    """A manoeuvre with the reference scale's `rating` in 0..7.

    `group`: common to related drives, e.g. of one parameter set in several scenarios, which are never split between training and test.
    `name`: unique. `channels`: as from `channels_of`.
    """

    manoeuvre: Manoeuvre
    group: str
    name: str
    channels: Integers
    rating: float


class _Recorder:
    """Rates by the reference scale and keeps the channels of the last run."""

    def __init__(self) -> None:
        self.channels: Integers | None = None

    def rate_series(self, rated_as: str, series: Series) -> Rating:
        """Rates by the reference scale and keeps the channels."""
        self.channels = channels_of(series.dynamics, series.offset)
        return reference.rate(Manoeuvre(rated_as), comfort_metrics(series.dynamics, series.offset))


def group_of_set(number: int) -> str:
    """Returns the group of a simulated parameter set."""
    return f"set {number}"


def group_of_profile(manoeuvre: Manoeuvre, number: int) -> str:
    """Returns the group of a synthetic profile."""
    return f"{manoeuvre.value} {number}"


def simulated(total: int, numbers: Sequence[int], seed: int) -> list[RatedDrive]:
    """Simulates the given numbers of `total` random parameter sets (Latin hypercube over the space) in all scenarios of the catalogue.

    Odd numbers use the hybrid vehicle, even ones the single track. Failed runs are omitted.
    """
    space = FRENET.spaces["highway"]
    unit = qmc.LatinHypercube(len(space), seed=seed).random(total)
    drives = []
    for scenario in HIGHWAY.scenarios.values():
        recorder = _Recorder()
        models = SingleTrackModel(NOMINAL), HybridModel(NOMINAL, shipped())
        runners = [TaskRunner(scenario, FRENET, model, recorder) for model in models]
        for number in numbers:
            row = zip(unit[number], space, strict=True)
            values = [float(parameter.value(round(u * (parameter.n_values - 1)))) for u, parameter in row]
            result = runners[number % 2].run(values)
            if result.rating is not None and recorder.channels is not None:
                group = group_of_set(number)
                name = f"{group} {scenario.id}"
                drives.append(RatedDrive(Manoeuvre(scenario.rated_as), group, name, recorder.channels, result.rating.rating))
    return drives


def _waves(time: Floats, rng: np.random.Generator, lowest: float, highest: float) -> Floats:
    """Returns the sum of four waves of random frequency (Hz) and phase, with r.m.s. 1 and a soft begin."""
    frequency, phase = rng.uniform(lowest, highest, 4), rng.uniform(0.0, 2.0 * np.pi, 4)
    waves = np.sin(2.0 * np.pi * np.outer(time, frequency) + phase).sum(axis=1)
    return np.asarray(waves / np.sqrt((waves**2).mean()) * smooth(time / 1.5))


def _size(rng: np.random.Generator, mean: float) -> float:
    """Draws the size of a disturbance, which is 0 in `IDLE` of the profiles."""
    return float(rng.exponential(mean) * (rng.random() > IDLE))


def _profile(manoeuvre: Manoeuvre, time: Floats, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Draws offset from the target lane's centre (m), speed (m/s) and curvature of the road (1/m) over time, each of shape (n,)."""
    speed = np.full_like(time, rng.uniform(20.0, 36.0))
    offset = _size(rng, 0.01) * _waves(time, rng, 0.05, 0.4)
    road = np.zeros_like(time)
    if rng.random() < 0.5:
        begin, ramp, lasts = rng.uniform(0.0, 8.0), rng.uniform(1.5, 5.0), rng.uniform(1.0, 8.0)
        across = rng.uniform(-1.0, 1.0) * (3.4 if manoeuvre is Manoeuvre.LANE_KEEPING else 1.6)
        road = across / speed**2 * (smooth((time - begin) / ramp) - smooth((time - begin - ramp - lasts) / ramp))
    if manoeuvre is Manoeuvre.LANE_CHANGE:
        begin, takes, width = rng.uniform(0.5, 4.0), rng.uniform(2.8, 8.5), rng.choice([-1.0, 1.0]) * rng.uniform(3.4, 3.8)
        width *= rng.random() > IDLE
        beyond = _size(rng, 0.15) * np.exp(-np.maximum(time - begin - takes, 0.0)) * smooth((time - begin) / takes)
        offset += width * (smooth((time - begin) / takes) - 1.0)
        offset += width * beyond * np.sin(rng.uniform(0.6, 1.6) * (time - begin))
        speed += _size(rng, 0.4) * _waves(time, rng, 0.03, 0.15)
    elif manoeuvre is Manoeuvre.LANE_KEEPING:
        aside = rng.uniform(-0.8, 0.8) * (rng.random() > IDLE)
        rate, wave = rng.uniform(0.3, 1.2), rng.uniform(0.0, 1.2)
        offset += aside * np.exp(-rate * time) * np.cos(wave * time)
        offset += _size(rng, 0.12) * _waves(time, rng, 0.05, rng.uniform(0.15, 0.6))
        speed += _size(rng, 0.3) * _waves(time, rng, 0.03, 0.15)
    else:
        change, begin = rng.choice([-1.0, 1.0]) * rng.uniform(3.0, 12.0), rng.uniform(0.5, 4.0)
        takes = abs(change) * rng.uniform(0.5, 2.2)
        change *= rng.random() > IDLE
        speed += change * smooth((time - begin) / takes) + _size(rng, 0.25) * _waves(time, rng, 0.05, 0.3)
    return offset, speed, road


def _trajectory(offset: Floats, speed: Floats, road: Floats) -> Floats:
    """Returns the trajectory of a planner, with rows every 0.1 s, from profiles every 0.01 s."""
    time = np.arange(len(offset)) * FINE
    curvature = road + np.gradient(np.gradient(offset, FINE), FINE) / speed**2

    def integral(rate: Floats) -> Floats:
        return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * FINE)])

    heading = integral(speed * curvature)
    x, y = integral(speed * np.cos(heading)), integral(speed * np.sin(heading))
    rows = np.column_stack([time, x, y, heading, curvature, speed, np.gradient(speed, FINE)])
    return np.ascontiguousarray(rows[:: round(STEP / FINE)])


def synthetic(manoeuvre: Manoeuvre, number: int, seed: int) -> RatedDrive | None:
    """Draws a profile of offset, speed and curvature, and lets the single-track vehicle follow it for 12 to 22 s.

    Returns None if the vehicle cannot follow the profile.
    """
    rng = np.random.default_rng([seed, list(Manoeuvre).index(manoeuvre), number])
    steps = round(rng.uniform(12.0, 22.0) / STEP)
    time = np.arange((steps + 15) * round(STEP / FINE) + 1, dtype=np.float64) * FINE
    offset, speed, road = _profile(manoeuvre, time, rng)
    path = _trajectory(offset, speed, road)
    model = SingleTrackModel(NOMINAL)
    model.start(*(float(value) for value in path[0, [1, 2, 3, 5]]))
    dynamics, driven = np.zeros((10 * steps, 5)), np.zeros(steps)
    for k in range(steps):
        if not model.follow(path, k * STEP, STEP, dynamics[10 * k : 10 * k + 10]):
            return None
        x, y = model.pose[:2]
        _, due_x, due_y, heading = path[k + 1, :4]
        driven[k] = offset[10 * (k + 1)] + (y - due_y) * np.cos(heading) - (x - due_x) * np.sin(heading)
    rating = reference.rate(manoeuvre, comfort_metrics(dynamics, driven))
    group = group_of_profile(manoeuvre, number)
    return RatedDrive(manoeuvre, group, group, channels_of(dynamics, driven), rating.rating)
