"""Trains the learned comfort evaluator on manoeuvres that a simulated panel rated, and measures it on others."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.linear_model import RidgeCV
from sklearn.metrics import cohen_kappa_score

from drivecal.comfort import rocket
from drivecal.comfort.channels import LENGTH, UNITS
from drivecal.comfort.regression import features_of
from drivecal.comfort.regression_arrays import Regression
from drivecal.domain.scenarios import Manoeuvre
from drivecal.plugins.ports import Floats
from drivecal.training.panel import Panel
from drivecal.training.rated_drives import RatedDrive, group_of_profile, group_of_set, simulated, synthetic

SEED = 1
PARAMETER_SETS, PROFILES = 240, 600
"""Simulated parameter sets, each in all scenarios; synthetic profiles per class."""
HELD_OUT = 0.25
FEATURES = 24
"""Per kernel; 84 times as many in all."""
MOST_DILATIONS = 4
PENALTIES = np.logspace(0.0, 5.0, 21)
GOLDEN = 0.5 * (np.sqrt(5.0) + 1.0)


def is_held_out(group: str) -> bool:
    """Drives of a group are all held out or none of them."""
    return zlib.crc32(group.encode()) / 2**32 < HELD_OUT


def drives(*, held_out: bool) -> list[RatedDrive]:
    """The manoeuvres that are learned from, or those that are held out."""
    numbers = [number for number in range(PARAMETER_SETS) if is_held_out(group_of_set(number)) is held_out]
    found = simulated(PARAMETER_SETS, numbers, SEED)
    for manoeuvre in Manoeuvre:
        for number in range(PROFILES):
            if is_held_out(group_of_profile(manoeuvre, number)) is held_out:
                drive = synthetic(manoeuvre, number, SEED)
                if drive is not None:
                    found.append(drive)
    return found


def dilations_of(length: int) -> tuple[rocket.Integers, rocket.Integers]:
    """Dilations and how many features per kernel each has, spread exponentially as in the original."""
    longest = np.log2((length - 1) / (rocket.TAPS - 1))
    spread = np.logspace(0.0, longest, MOST_DILATIONS, base=2.0).astype(np.int32)
    dilations, counts = np.unique(spread, return_counts=True)
    per_dilation = counts * (FEATURES // MOST_DILATIONS)
    return dilations.astype(np.int32), per_dilation.astype(np.int32)


def structure(drives: Sequence[RatedDrive], rng: np.random.Generator) -> Regression:
    """Kernels with the channels that each looks at, and biases: quantiles of convolutions of drives drawn at random. No weights yet."""
    dilations, per_dilation = dilations_of(LENGTH)
    count = len(rocket.KERNELS) * len(dilations)
    n_channels = (2.0 ** rng.uniform(0.0, np.log2(len(UNITS) + 1), count)).astype(np.int32)
    channels = np.concatenate([rng.choice(len(UNITS), n, replace=False) for n in n_channels]).astype(np.int32)
    places = np.concatenate([[0], np.cumsum(n_channels)])
    biases: list[Floats] = []
    total = 0
    for combination in range(count):
        d, k = divmod(combination, len(rocket.KERNELS))
        used = channels[places[combination] : places[combination + 1]]
        drive = drives[int(rng.integers(len(drives)))]
        convolution = rocket.convolution_of(drive.channels, rocket.KERNELS[k], int(dilations[d]), used)
        shares = (np.arange(total + 1, total + 1 + per_dilation[d]) * GOLDEN) % 1.0
        biases.append(np.floor(np.quantile(convolution, shares)))
        total += int(per_dilation[d])
    found = np.concatenate(biases).astype(np.int32)
    return Regression(dilations, per_dilation, n_channels, channels, found, np.zeros(len(found)), np.zeros(1))


@dataclass(frozen=True, slots=True)
class Fit:
    """A regression with the framework's own model of it: `scale` (mean and deviation of the features, (2, n)) and `ridge`."""

    regression: Regression
    scale: Floats
    ridge: RidgeCV


def fit(drives: Sequence[RatedDrive], targets: Floats, seed: int) -> Fit:
    """Ridge regression on standardised features; the penalty has the smallest leave-one-out error."""
    shape = structure(drives, np.random.default_rng(seed))
    features = np.array([features_of(shape, one.channels) for one in drives])
    mean, deviation = features.mean(axis=0), features.std(axis=0)
    deviation[deviation < 1e-6] = 1.0
    ridge = RidgeCV(alphas=PENALTIES).fit((features - mean) / deviation, targets)
    weights = np.asarray(ridge.coef_, dtype=np.float64) / deviation
    intercept = np.array([float(ridge.intercept_) - float(weights @ mean)])
    done = Regression(shape.dilations, shape.per_dilation, shape.n_channels, shape.channels, shape.biases, weights, intercept)
    return Fit(done, np.vstack([mean, deviation]), ridge)


@dataclass(frozen=True, slots=True)
class PanelAgreement:
    """How well ratings agree with the panel's: shares of equal scores and of those at most one apart, quadratic weighted kappa, r.m.s.
    error of the rating."""

    count: int
    equal: float
    within_one: float
    kappa: float
    error: float

    @classmethod
    def of(cls, ratings: Floats, panel: Floats) -> PanelAgreement:
        """Of ratings in 0..7, each of shape (n,)."""
        ours, theirs = np.floor(ratings + 0.5).astype(int), np.floor(panel + 0.5).astype(int)
        apart = np.abs(ours - theirs)
        kappa = cohen_kappa_score(ours, theirs, weights="quadratic", labels=list(range(8)))
        error = float(np.sqrt(((ratings - panel) ** 2).mean()))
        return cls(len(ours), float((apart == 0).mean()), float((apart <= 1).mean()), float(kappa), error)


def rated_by_panel(drives: Sequence[RatedDrive]) -> Floats:
    """The simulated panel's ratings, shape (n,): always the same for the same drive."""
    panel = Panel.of(SEED)
    return np.array([panel.rate(one.rating, np.random.default_rng([SEED, zlib.crc32(one.name.encode())])) for one in drives])
