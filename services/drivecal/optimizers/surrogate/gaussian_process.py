"""Gaussian processes with a Matérn kernel of smoothness 5/2 and a length for each parameter (Rasmussen and Williams 2006, chapters 2, 5).

Lengths and noise maximise the posterior density; the prior of the lengths grows with the number of parameters (Hvarfner, Hellsten and
Nardi 2024, "Vanilla Bayesian optimization performs great in high dimensions"). The variance is what maximises the likelihood.

Answers of a random simulator have seeds. What a further seed does to all sets is a constant (Pearce, Poloczek and Branke 2022, "Bayesian
optimization allowing for common random numbers"), or a repeat under a lucky seed would look like merit. The first seed has none: nearly all
answers are under it, and a constant of its own would only move the mean that sets have where nothing is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.optimize import minimize

from drivecal.domain.parameters import Indices, Kind
from drivecal.plugins.ports import Floats

LENGTH_MEAN, LENGTH_DEVIATION = np.sqrt(2.0) - 3.0, np.sqrt(3.0)
"""Mode and deviation of the logarithm of a length in one dimension, in ranges."""
LENGTHS = (-4.0, 5.0)
ITERATIONS = 40
RECENT = 20
"""Newest answers, which are near the best sets: they show whether a process is too sure of itself."""
FARTHEST = 25.0
"""Most that a squared error counts, in variances."""
ROOT = np.sqrt(5.0)


@dataclass(frozen=True, slots=True)
class NoisePrior:
    """Normal distribution of the logarithms of the noise and of what a further seed adds, in variances, and their largest value."""

    mean: float
    deviation: float
    largest: float
    luck: float | None = None
    """Mean for what a further seed adds to all sets; None without seeds."""
    least: float = -11.0

    @property
    def means(self) -> list[float]:
        """The means of all."""
        return [self.mean] if self.luck is None else [self.mean, self.luck]


EXACT = NoisePrior(-9.0, 2.0, 0.0)
"""Steps of scores, and shapes that the kernel lacks."""
SAMPLED = NoisePrior(-2.0, 2.0, 3.0, luck=-2.0)
"""Runs that depend on a seed. What replicates say outweighs it."""


class Encoding:
    """Features of parameter sets: shares of the ranges; of a choice a feature for each of its values, so that all are equally far apart."""

    def __init__(self, n_values: Indices, kinds: Sequence[Kind]) -> None:
        self._last = n_values - 1
        self._choices = [kind == "choice" for kind in kinds]
        self.n_parameters = len(kinds)
        self.owners: Indices = np.concatenate(
            [
                np.full(n if choice else 1, place)
                for place, (n, choice) in enumerate(zip(n_values.tolist(), self._choices, strict=True))
            ]
        )
        """The parameter that each feature is of."""

    def __call__(self, rows: Indices) -> Floats:
        """Returns the features of grid indices, shape (n, n_features)."""
        columns: list[Floats] = []
        for place, choice in enumerate(self._choices):
            if choice:
                columns.append((rows[:, place, np.newaxis] == np.arange(self._last[place] + 1)) * np.sqrt(0.5))
            else:
                columns.append(rows[:, place, np.newaxis] / self._last[place])
        return np.concatenate(columns, axis=1)


@dataclass(frozen=True, slots=True)
class Points:
    """Features of n answered sets, shape (n, n_features), and the seeds of the answers, shape (n,)."""

    features: Floats
    seeds: Indices

    def __getitem__(self, rows: Any) -> "Points":
        return Points(self.features[rows], self.seeds[rows])

    @property
    def alike(self) -> npt.NDArray[np.bool_]:
        """Which answers have a further seed in common, shape (n, n)."""
        result: npt.NDArray[np.bool_] = (self.seeds[:, np.newaxis] == self.seeds) & (self.seeds > 1)
        return result

    def followed_by(self, others: "Points") -> "Points":
        """Returns these and others."""
        return Points(np.concatenate([self.features, others.features]), np.concatenate([self.seeds, others.seeds]))


@dataclass(frozen=True, slots=True)
class Hyperparameters:
    """Logarithms of lengths, shape (n_parameters,), and of the noise's share of the variance; `count`: answers that they were fitted to."""

    lengths: Floats
    noise: float
    luck: float | None = None
    """Logarithm of the variance that a further seed adds to all sets; None without seeds."""
    count: int = 0

    @classmethod
    def usual(cls, n_parameters: int, noise: NoisePrior = EXACT) -> "Hyperparameters":
        """The middle of the prior."""
        return cls(np.full(n_parameters, LENGTH_MEAN + np.log(n_parameters) / 2), noise.mean, noise.luck)


def _squares(first: Floats, second: Floats) -> Floats:
    squares: Floats = (first**2).sum(axis=1)[:, np.newaxis] + (second**2).sum(axis=1) - 2.0 * (first @ second.T)
    np.maximum(squares, 0.0, out=squares)
    return squares


def _correlations(squares: Floats) -> Floats:
    away = ROOT * np.sqrt(squares)
    result: Floats = (1.0 + away + (5.0 / 3.0) * squares) * np.exp(-away)
    return result


def fitted(
    points: Points, targets: Floats, owners: Indices, start: Hyperparameters, prior: NoisePrior = EXACT
) -> Hyperparameters:
    """Returns hyperparameters of the largest posterior density near a start. Targets have a mean of 0."""
    features, alike = points.features, points.alike
    n_parameters, count = len(start.lengths), len(targets)
    variances = np.array([start.noise] if start.luck is None else [start.noise, start.luck])
    centre = LENGTH_MEAN + np.log(n_parameters) / 2
    squared = features**2
    diagonal = np.diag_indices(count)

    def loss(theta: Floats) -> tuple[float, Floats]:
        inverse = np.exp(-2.0 * theta[:n_parameters])[owners]
        scaled = features * np.sqrt(inverse)
        squares = _squares(scaled, scaled)
        squares[diagonal] = 0.0
        away = ROOT * np.sqrt(squares)
        decay = np.exp(-away)
        matrix = (1.0 + away + (5.0 / 3.0) * squares) * decay
        noise, *added = np.exp(theta[n_parameters:])
        for luck in added:
            matrix += luck * alike
        matrix[diagonal] += noise + 1e-8
        factor, info = dpotrf(matrix, lower=1, overwrite_a=0)
        if info:
            return 1e25, np.zeros_like(theta)
        inverted, _ = dpotri(factor, lower=1)
        inverted = np.tril(inverted) + np.tril(inverted, -1).T
        weights = inverted @ targets
        fit = float(targets @ weights) + 1e-12
        value = 0.5 * count * np.log(fit / count) + np.log(factor.diagonal()).sum()
        sensitivity = count / fit * np.outer(weights, weights) - inverted
        slopes = [noise * np.trace(sensitivity), *(luck * sensitivity[alike].sum() for luck in added)]
        slope = sensitivity * ((5.0 / 3.0) * (1.0 + away) * decay)
        by_feature = 2.0 * (slope.sum(axis=1) @ squared) - 2.0 * (features * (slope @ features)).sum(axis=0)
        gradient = -0.5 * np.append(np.bincount(owners, by_feature * inverse, n_parameters), slopes)
        away_from_prior = np.append(
            (theta[:n_parameters] - centre) / LENGTH_DEVIATION, (theta[n_parameters:] - prior.means) / prior.deviation
        )
        deviations = np.append(np.full(n_parameters, LENGTH_DEVIATION), np.full(len(variances), prior.deviation))
        return value + 0.5 * float(away_from_prior @ away_from_prior), gradient + away_from_prior / deviations

    bounds = [LENGTHS] * n_parameters + [(prior.least, prior.largest)] * len(variances)
    optimum = minimize(
        loss, np.append(start.lengths, variances), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": ITERATIONS}
    )
    return Hyperparameters(optimum.x[:n_parameters].copy(), *optimum.x[n_parameters:].tolist())


class GaussianProcess:
    """A process that knows targets at some points. Further points without targets may shrink its deviation (fantasies at its own mean)."""

    def __init__(
        self, points: Points, targets: Floats, owners: Indices, hyperparameters: Hyperparameters, pending: Points
    ) -> None:
        self._luck = 0.0 if hyperparameters.luck is None else float(np.exp(hyperparameters.luck))
        self._scale = np.exp(-hyperparameters.lengths)[owners]
        self._known = points.features * self._scale
        self._mean = float(targets.mean()) if len(targets) else 0.0
        centred = targets - self._mean
        count = len(targets)
        self._noise = float(np.exp(hyperparameters.noise)) + 1e-8
        factor = self._factor(points)
        self._weights = solve_triangular(factor, solve_triangular(factor, centred, lower=True), lower=True, trans=1)
        self.variance = max(float(centred @ self._weights) / max(count, 1), 1e-12)
        self.variance *= self._surprise(factor)
        asked = points.followed_by(pending)
        self._asked, self._own = asked.features * self._scale, factor
        self._all = self._factor(asked) if len(pending.seeds) else factor

    @property
    def noise(self) -> float:
        """Standard deviation of a target around the process, without what its seed does to all sets."""
        return float(np.sqrt(self.variance * self._noise))

    def _surprise(self, factor: Floats) -> float:
        """Returns the mean squared error at the newest answers, each predicted from all others, in variances; at least 1 (Rasmussen and
        Williams 2006, section 5.4.2)."""
        inverse, _ = dpotri(factor, lower=1)
        errors = (self._weights**2 / inverse.diagonal() / self.variance)[-RECENT:]
        return max(1.0, float(np.minimum(errors, FARTHEST).mean())) if len(errors) else 1.0

    def _factor(self, points: Points) -> Floats:
        scaled = points.features * self._scale
        squares = _squares(scaled, scaled)
        np.fill_diagonal(squares, 0.0)
        matrix = _correlations(squares)
        if self._luck > 0:
            matrix += self._luck * points.alike
        matrix[np.diag_indices(len(matrix))] += self._noise
        factor: Floats
        factor, info = dpotrf(matrix, lower=1, clean=1)
        if info:
            raise ArithmeticError("the covariance is not positive definite")
        return factor

    def predict(self, features: Floats, *, pending: bool) -> tuple[Floats, Floats]:
        """Returns means and deviations, without noise, at n points; pending points shrink the deviation or do not."""
        correlations = _correlations(_squares(self._asked if pending else self._known, features * self._scale))
        means = self._mean + self._weights @ correlations[: len(self._weights)]
        shares = solve_triangular(
            self._all if pending else self._own, correlations, lower=True, overwrite_b=True, check_finite=False
        )
        left = np.maximum(1.0 - (shares**2).sum(axis=0), 1e-10)
        return means, np.sqrt(self.variance * left)
