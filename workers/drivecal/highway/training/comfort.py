"""Training of the learned comfort evaluator on manoeuvres rated by a simulated panel, and the tables of its model card."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from sklearn.linear_model import RidgeCV
from sklearn.metrics import cohen_kappa_score

from drivecal.highway.comfort import rocket
from drivecal.highway.comfort.reference import Manoeuvre
from drivecal.highway.comfort.regressions import Regression
from drivecal.highway.comfort.rocket import LENGTH, UNITS, features_of, rating_of
from drivecal.highway.training.rated_drives import RatedDrive, group_of_profile, group_of_set, simulated, synthetic
from drivecal.highway.training.tables import table
from drivecal.plugins.ports import Floats

SEED = 1
PARAMETER_SETS, PROFILES = 240, 600
"""Number of simulated parameter sets, each in all scenarios, and of synthetic profiles per class."""
HELD_OUT = 0.25
FEATURES = 24
"""Features per kernel; the total is 84 times as many."""
MOST_DILATIONS = 4
PENALTIES = np.logspace(0.0, 5.0, 21)
GOLDEN = 0.5 * (np.sqrt(5.0) + 1.0)
RATERS = 15
STRICTNESS, FRIENDLINESS, INCONSISTENCY = 0.1, 0.4, 0.6
BEST = 7.0


def is_held_out(group: str) -> bool:
    """Returns whether a group of drives is held out, which applies to all its drives."""
    return zlib.crc32(group.encode()) / 2**32 < HELD_OUT


def drives(*, held_out: bool) -> list[RatedDrive]:
    """Returns the training manoeuvres or the held-out manoeuvres."""
    numbers = [number for number in range(PARAMETER_SETS) if is_held_out(group_of_set(number)) is held_out]
    selected = simulated(PARAMETER_SETS, numbers, SEED)
    for manoeuvre in Manoeuvre:
        for number in range(PROFILES):
            if is_held_out(group_of_profile(manoeuvre, number)) is held_out:
                drive = synthetic(manoeuvre, number, SEED)
                if drive is not None:
                    selected.append(drive)
    return selected


def dilations_of(length: int) -> tuple[rocket.Integers, rocket.Integers]:
    """Returns dilations, spread exponentially as in the original, and the number of features per kernel of each."""
    longest = np.log2((length - 1) / (rocket.TAPS - 1))
    spread = np.logspace(0.0, longest, MOST_DILATIONS, base=2.0).astype(np.int32)
    dilations, counts = np.unique(spread, return_counts=True)
    per_dilation = counts * (FEATURES // MOST_DILATIONS)
    return dilations.astype(np.int32), per_dilation.astype(np.int32)


def convolution_of(series: rocket.Integers, taps: rocket.Integers, dilation: int) -> rocket.Integers:
    """Returns one convolution of a kernel with `series`, shape (n,), from which biases are drawn."""
    padded = np.pad(series, ((0, 0), (4 * dilation, 4 * dilation)))
    shifted = np.array([padded[:, tap * dilation :][:, : series.shape[1]].sum(axis=0) for tap in range(rocket.TAPS)])
    return np.asarray(3 * shifted[taps].sum(axis=0) - shifted.sum(axis=0), dtype=np.int32)


def structure(drives: Sequence[RatedDrive], rng: np.random.Generator) -> Regression:
    """Returns a regression with random channels per kernel and zero weights.

    Biases are quantiles of convolutions of randomly drawn drives.
    """
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
        convolution = convolution_of(drive.channels[used], rocket.KERNELS[k], int(dilations[d]))
        shares = (np.arange(total + 1, total + 1 + per_dilation[d]) * GOLDEN) % 1.0
        biases.append(np.floor(np.quantile(convolution, shares)))
        total += int(per_dilation[d])
    all_biases = np.concatenate(biases).astype(np.int32)
    return Regression(dilations, per_dilation, n_channels, channels, all_biases, np.zeros(len(all_biases)), np.zeros(1))


def fit(drives: Sequence[RatedDrive], targets: Floats, seed: int) -> Regression:
    """Fits a ridge regression on standardised features, with the penalty of the smallest leave-one-out error."""
    untrained = structure(drives, np.random.default_rng(seed))
    features = np.array([features_of(untrained, drive.channels) for drive in drives])
    mean, deviation = features.mean(axis=0), features.std(axis=0)
    deviation[deviation < 1e-6] = 1.0
    ridge = RidgeCV(alphas=PENALTIES).fit((features - mean) / deviation, targets)
    weights = np.asarray(ridge.coef_, dtype=np.float64) / deviation
    intercept = np.array([float(ridge.intercept_) - float(weights @ mean)])
    return replace(untrained, weights=weights, intercept=intercept)


def agreement_with(panel: Floats, ratings: Floats) -> tuple[float, float, float, float]:
    """Compares ratings in 0..7 with the panel's, each of shape (n,).

    Returns the shares of equal scores and of scores at most 1 apart, the quadratic weighted kappa, the r.m.s. error of the rating.
    """
    ours, theirs = np.floor(ratings + 0.5).astype(int), np.floor(panel + 0.5).astype(int)
    distance = np.abs(ours - theirs)
    kappa = cohen_kappa_score(ours, theirs, weights="quadratic", labels=list(range(8)))
    error = np.sqrt(((ratings - panel) ** 2).mean())
    return float((distance == 0).mean()), float((distance <= 1).mean()), float(kappa), float(error)


def rated_by_panel(drives: Sequence[RatedDrive]) -> Floats:
    """Returns the ratings of a simulated panel with individual tastes, shape (n,); equal drives get equal ones. No human rated any.

    Rater i gives round(clip(7 - g_i (7 - r) + b_i + e)), with the reference rating r, strictness g_i ~ N(1, 0.1), friendliness
    b_i ~ N(0, 0.4), and inconsistency e ~ N(0, 0.6), which varies between ratings. The panel's rating is the mean of all raters, its score
    the rounded mean.
    """
    drawn = np.random.default_rng(SEED)
    strictness, friendliness = drawn.normal(1.0, STRICTNESS, RATERS), drawn.normal(0.0, FRIENDLINESS, RATERS)
    rated = list[float]()
    for drive in drives:
        rng = np.random.default_rng([SEED, zlib.crc32(drive.name.encode())])
        each = BEST - (BEST - drive.rating) * strictness + friendliness + rng.normal(0.0, INCONSISTENCY, RATERS)
        rated.append(float(np.floor(np.clip(each, 0.0, BEST) + 0.5).mean()))
    return np.array(rated)


AGREEMENT, CALIBRATION = "agreement on held-out manoeuvres", "calibration"


def ratings(regressions: Mapping[Manoeuvre, Regression], drives: Sequence[RatedDrive]) -> Floats:
    """Returns the evaluator's ratings, shape (n,)."""
    return np.array([rating_of(regressions[drive.manoeuvre], drive.channels).rating for drive in drives])


def agreement_table(ours: Floats, drives: Sequence[RatedDrive]) -> str:
    """Returns the table of agreement between these ratings and the panel's, by class.

    It includes the agreement of the reference scale itself, an upper bound for evaluators learned from the panel.
    """
    panel = rated_by_panel(drives)
    reference = np.array([drive.rating for drive in drives])
    simulated = np.array([drive.group.startswith("set ") for drive in drives])
    rows = []
    for manoeuvre in Manoeuvre:
        in_class = np.array([drive.manoeuvre is manoeuvre for drive in drives])
        for label, selected, rated in (
            (manoeuvre.value, in_class, ours),
            (f"{manoeuvre.value}, built-in scenarios only", in_class & simulated, ours),
            (f"{manoeuvre.value}, the reference scale itself", in_class, reference),
        ):
            shares = agreement_with(panel[selected], rated[selected])
            rows.append([label, str(int(selected.sum())), *(f"{share:.2f}" for share in shares)])
    return table(
        ["class", "manoeuvres", "equal score", "within one", "quadratic weighted kappa", "r.m.s. error of the rating"], rows
    )


def calibration_table(ours: Floats, drives: Sequence[RatedDrive]) -> str:
    """Returns the table of the panel's mean rating by class and score of these ratings, with the number of drives."""
    panel = rated_by_panel(drives)
    scores = np.floor(ours + 0.5).astype(int)
    rows = []
    for manoeuvre in Manoeuvre:
        in_class = np.array([drive.manoeuvre is manoeuvre for drive in drives])
        means = []
        for score in range(8):
            selected = in_class & (scores == score)
            means.append(f"{panel[selected].mean():.1f} ({selected.sum()})" if selected.any() else "none")
        rows.append([manoeuvre.value, *means])
    return table(["score given", *(str(score) for score in range(8))], rows)
