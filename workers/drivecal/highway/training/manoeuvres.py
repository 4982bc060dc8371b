"""Random open-loop highway manoeuvres, i.e. steering and acceleration over time, for training and testing the hybrid vehicle."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from drivecal.plugins.ports import Floats

STEP = 0.01
QUIET = 1.0
"""Seconds of straight driving at the begin, in which the suspension of the multi-body model settles. They are dropped."""
DURATION = 5.0
TRAINED = ("lane change", "curve", "slalom", "corrections")
UNSEEN = "swerve"
"""A kind that is not used in training: aside and back at once, as in a double lane change."""


@dataclass(frozen=True, slots=True)
class OpenLoopManoeuvre:
    """Inputs of a vehicle over time.

    `steering`: front wheel angle (rad), twice differentiable; `pull`: desired longitudinal acceleration (m/s^2), shape (n,).
    """

    kind: str
    speed: float
    times: Floats
    steering: Callable[..., Floats]
    pull: Floats


def smooth(u: Floats) -> Floats:
    """Rises from 0 to 1, with two derivatives that vanish at both ends."""
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u * u)


def _shape(kind: str, time: Floats, rng: np.random.Generator) -> Floats:
    """Returns steering of magnitude 1 over the time since the quiet second, shape (n,)."""
    if kind == "lane change":
        takes = rng.uniform(2.5, 6.0)
        window = smooth(time / (0.15 * takes)) * smooth((takes - time) / (0.15 * takes))
        return np.asarray(np.sin(2.0 * np.pi * time / takes) * window)
    if kind == "curve":
        entry, lasts, leaves = rng.uniform(0.8, 3.0), rng.uniform(1.0, 4.0), rng.integers(0, 2)
        return smooth(time / entry) - smooth((time - entry - lasts) / entry) * leaves
    if kind == "slalom":
        return np.sin(2.0 * np.pi * rng.uniform(0.1, 0.6) * time) * smooth(time / 0.8)
    if kind == UNSEEN:
        takes = rng.uniform(1.8, 2.4)
        there = np.sin(2.0 * np.pi * time / takes) * np.where(time < takes, 1.0, 0.0)
        back = np.sin(2.0 * np.pi * (time - takes) / takes) * np.where((time >= takes) & (time < 2.0 * takes), 1.0, 0.0)
        return (there - back) * smooth(time / 0.3) * smooth((2.0 * takes - time) / 0.3)
    frequency, phase = rng.uniform(0.05, 1.0, 5), rng.uniform(0.0, 2.0 * np.pi, 5)
    waves = np.sin(2.0 * np.pi * np.outer(time, frequency) + phase) @ (rng.normal(size=5) / np.sqrt(frequency))
    waves = waves * smooth(time)
    return np.asarray(waves / np.abs(waves).max() * rng.uniform(0.2, 0.8))


def draw(kind: str, rng: np.random.Generator, wheelbase: float) -> OpenLoopManoeuvre:
    """Draws a manoeuvre of this kind: 14 to 36 m/s, lateral acceleration up to 4.6 m/s^2 (of a neutral vehicle).

    Half of all manoeuvres brake or accelerate.
    """
    speed = rng.uniform(14.0, 36.0)
    across = rng.uniform(0.3, 4.6) * rng.choice([-1.0, 1.0])
    times = np.round(np.arange(round((QUIET + DURATION - 1.0) / STEP) + 1) * STEP, 9)
    since = np.maximum(times - QUIET, 0.0)
    angle = _shape(kind, since, rng) * across * wheelbase / speed**2
    pull = rng.uniform(-3.2, 2.6) if rng.random() < 0.5 else 0.0
    begins = rng.uniform(0.0, 1.5)
    return OpenLoopManoeuvre(kind, speed, times, CubicSpline(times, angle), pull * smooth((since - begins) / 0.6))
