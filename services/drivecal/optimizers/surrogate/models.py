"""A model for each scenario: what its values and failures probably are at sets that were not asked there."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from drivecal.domain.parameters import Indices
from drivecal.domain.rounding import grain
from drivecal.optimizers.surrogate.gaussian_process import (
    EXACT,
    SAMPLED,
    GaussianProcess,
    Hyperparameters,
    NoisePrior,
    Points,
    fitted,
)
from drivecal.plugins.ports import Floats

Bools = npt.NDArray[np.bool_]
GROWTH = 1.15
"""Hyperparameters are fitted again when its answers have grown by this factor."""
MOST = 300
"""Answers that a process learns from; of more, the newest, some of all, those nearest to the newest, and the newest sound ones."""
MOST_TUNED = 150
"""Answers that hyperparameters are fitted to; of more, every second or third."""
FEWEST = 3
"""Answers with which a process begins."""
FAR_BEYOND = 0.5
"""Least gain in the logarithm of the likelihood of a value for which values without a better end are warped."""
GAP = 4.0
"""Gap between logarithms of values, beyond which the worse ones count as equal: a part of the space blows up."""
OUT_OF_REACH = 1e3
"""Feature that no set is near, in ranges."""
DOUBTFUL = 0.1
"""Probability of a failure from which on a set that is under way counts as failed."""
WARY = 10
"""Newest sets under way that may count as failed: with more of them, a search would stay away from the edge of the failures."""
MOST_ALIKE = 0.9999
"""Largest correlation of a set's runs in failing."""


@dataclass(frozen=True, slots=True)
class Warp:
    """Strictly rising function of values, under which they are nearer to a normal distribution: none, the logarithm of the distance from
    an end of the range, or the inverse hyperbolic sine, a logarithm to both sides."""

    origin: float = 0.0
    sign: float = 0.0
    """Direction of the values from the origin; 0: both."""
    unit: float = 0.0
    """0: no warp."""

    @classmethod
    def chosen(cls, values: Floats, best: float) -> "Warp":
        """Returns what makes values likelier (Box and Cox 1964); `best`: the better end of their range, NaN if none is better."""
        spread = values.std()
        if len(values) < FEWEST + 2 or spread <= 0:
            return cls()
        if np.isnan(best):  # some may be far beyond all others, on either side
            centre = float(np.median(values))
            unit = float(np.median(np.abs(values - centre)))
            if unit <= 0:
                return cls()
            places = (values - centre) / unit
            gain = np.log(places.std() / np.arcsinh(places).std()) - 0.5 * np.log1p(places**2).mean()
            return cls(centre, 0.0, unit) if gain > FAR_BEYOND else cls()
        for sign in (1.0, -1.0):
            nearest = float((sign * values).min())
            # a value without limits may get better by half of the median's distance, in any unit and from any offset
            origin = best if np.isfinite(best) else sign * (nearest - 0.5 * (float(np.median(sign * values)) - nearest))
            away = sign * (values - origin) / spread
            if (np.isfinite(best) or sign * best < 0) and away.min() > 0:
                logarithms = np.log(away)
                # the logarithm of the likelihood's ratio, per value
                if np.log(max(logarithms.std(), 1e-12)) + logarithms.mean() < 0:
                    return cls(origin, sign, float(spread))
        return cls()

    def __call__(self, values: Floats) -> Floats:
        warped = values
        if self.sign:
            warped = np.log(np.maximum(self.sign * (values - self.origin) / self.unit, 1e-300))
        elif self.unit:
            warped = np.arcsinh((values - self.origin) / self.unit)
        return warped

    def undone(self, warped: Floats) -> Floats:
        """Inverts the warp."""
        values = warped
        if self.sign:
            values = self.origin + self.sign * self.unit * np.exp(np.minimum(warped, 300.0))
        elif self.unit:
            values = self.origin + self.unit * np.sinh(np.clip(warped, -300.0, 300.0))
        return values


@dataclass(slots=True)
class Output:
    """One of a scenario's values, or its failures as 0 and 1, as a process."""

    tuned: Hyperparameters
    prior: NoisePrior = EXACT
    warp: Warp = field(default_factory=Warp)
    process: GaussianProcess | None = None
    constant: float = 0.0
    spread: float = 0.0

    def learn(self, points: Points, targets: Floats, owners: Indices, pending: Points, warp: Warp, known: int) -> None:
        """Learns from at least one answer. `known`: number of all answers, those left out included."""
        self.warp = warp
        warped = warp(targets)
        if warp.unit and self.prior is EXACT:  # how bad the worst are tells nothing about the best, and would hide it
            for side in (1.0,) if warp.sign else (1.0, -1.0):
                worse = np.sort(side * warped)[len(warped) // 2 :]
                if len(gaps := np.flatnonzero(np.diff(worse) > GAP)):
                    warped = side * np.minimum(side * warped, worse[gaps[0]] + 2.0)
        self.constant, self.spread = float(warped.mean()), float(warped.std())
        if len(targets) < FEWEST or self.spread <= grain(*targets[:1].tolist() if warp.unit == 0 else ()):
            self.process = None
            return
        if known >= max(self.tuned.count + 1, GROWTH * self.tuned.count):
            chosen = slice(None, None, -(-len(targets) // MOST_TUNED))
            centred = (warped[chosen] - warped[chosen].mean()) / self.spread
            self.tuned = replace(fitted(points[chosen], centred, owners, self.tuned, self.prior), count=known)
        self.process = GaussianProcess(points, (warped - self.constant) / self.spread, owners, self.tuned, pending)

    def predict(self, features: Floats, *, pending: bool) -> tuple[Floats, Floats]:
        """Returns means and deviations of the warped value."""
        if self.process is None:
            return np.full(len(features), self.constant), np.full(len(features), self.spread)
        means, deviations = self.process.predict(features, pending=pending)
        return self.constant + self.spread * means, self.spread * deviations

    @property
    def noise(self) -> float:
        """Standard deviation of an answer around the process, of the warped value."""
        return self.spread * (1.0 if self.process is None else self.process.noise)


@dataclass(frozen=True, slots=True)
class Belief:
    """Distribution of a scenario's values at n sets."""

    means: Floats
    """Means of the warped values, shape (n, n_values)."""
    deviations: Floats
    failing: Floats
    """Probabilities of a failure, shape (n,)."""
    alike: Floats
    """How far random runs of a set are alike in failing, shape (n,): 0 if each fails by chance, 1 if all fail or none."""


class ScenarioModel:
    """The model of one scenario. Answers of a `random` simulator are samples: what counts is their mean, failures included."""

    def __init__(
        self, n_values: int, n_parameters: int, owners: Indices, best: Floats, worst: Floats, *, random: bool = False
    ) -> None:
        self._owners, self._best, self._worst, self._random = owners, best, worst, random
        prior = SAMPLED if random else EXACT
        *self._outputs, self._failure = (Output(Hyperparameters.usual(n_parameters, prior), prior) for _ in range(n_values + 1))
        self._wary = self._failure
        """The same, where sets that are under way and may fail count as failed."""
        self._least = 0.5
        """Least probability that a random run fails, and that it does not."""

    def learn(self, points: Points, values: Floats, failed: Bools, pending: Points) -> None:
        """Learns from answers in the order of asking: values, shape (n, n_values), and failures, shape (n,)."""
        known = len(failed)
        self._least = 1.0 / (known + 2)  # Laplace's rule of succession
        held = np.union1d(_kept(points.features), np.flatnonzero(~failed)[-MOST // 10 :])  # sound ones may be rare
        points, values, failed = points[held], values[held], failed[held]
        if known > 0 and failed.all():
            self._hope(points, pending)
            return
        for place, output in enumerate(self._outputs if known else ()):
            own, best = values[~failed, place], float(self._best[place])
            warp = Warp() if self._random and np.isnan(best) else Warp.chosen(own, best)  # a mean counts all of a rare bad run
            output.learn(points[~failed], own, self._owners, pending, warp, known)
        if known:
            self._failure.learn(points, failed.astype(np.float64), self._owners, pending[:0], Warp(), known)
            self._doubt(points, failed.astype(np.float64), pending)

    def _doubt(self, points: Points, labels: Floats, pending: Points) -> None:
        """Takes sets that are under way and may fail for failed ones: a round that is asked before their answers asks elsewhere."""
        self._wary = self._failure
        if self._failure.process is None or self._random or not len(pending.seeds):
            return
        pending = pending[-WARY:]
        doubtful = pending[self.predict(pending.features, pending=False).failing > DOUBTFUL]
        if len(doubtful.seeds):
            points, labels = points.followed_by(doubtful), np.append(labels, np.ones(len(doubtful.seeds)))
            targets = (labels - self._failure.constant) / self._failure.spread
            process = GaussianProcess(points, targets, self._owners, self._failure.tuned, points[:0])
            self._wary = replace(self._failure, process=process)

    def _hope(self, points: Points, pending: Points) -> None:
        """Learns from failures alone: that other sets fail as well is not certain, or a search would never leave them. It is as likely as
        if one answer were sound, out of reach of all sets (Laplace), with the best value to be expected."""
        labels = np.ones(len(points.seeds))
        if np.isfinite(self._best).all():
            for output, best in zip(self._outputs, self._best.tolist(), strict=True):
                output.constant = best
            sound = Points(np.full_like(points.features[:1], OUT_OF_REACH), points.seeds[:1])
            points, labels = points.followed_by(sound), np.append(labels, 0.0)
        self._failure.learn(points, labels, self._owners, pending[:0], Warp(), known=0)  # equal answers tell no lengths
        self._doubt(points, labels, pending)

    def predict(self, features: Floats, *, pending: bool) -> Belief:
        """Predicts n sets. Pending points shrink the deviation, and may count as failed, or do not."""
        predictions = [output.predict(features, pending=pending) for output in self._outputs]
        failing, unsure = (self._wary if pending else self._failure).predict(features, pending=False)
        alike = np.zeros_like(failing)
        if self._failure.process is not None and self._random:
            failing = np.clip(failing, self._least, 1.0 - self._least)
            alike = _correlation(unsure**2 / (failing * (1.0 - failing)))
        elif self._failure.process is not None:
            failing = ndtr((failing - 0.5) / np.sqrt(unsure**2 + 0.04))
        return Belief(
            np.stack([means for means, _ in predictions], axis=1),
            np.stack([deviations for _, deviations in predictions], axis=1),
            failing,
            alike,
        )

    def values(self, prediction: Belief, normal: Floats, uniform: Floats) -> Floats:
        """Returns draws of the values, shape (n_draws, n, n_values), from standard normal numbers, shape (n_draws, 1 or n, n_values), and
        uniform ones, shape (n_draws, 1 or n)."""
        warped = prediction.means + prediction.deviations * normal
        values = np.stack([output.warp.undone(warped[:, :, place]) for place, output in enumerate(self._outputs)], axis=2)
        failing = uniform < prediction.failing
        drawn = np.where(failing[:, :, np.newaxis], self._worst, values)
        if not self._random:
            return drawn
        rate = _rates(prediction.failing, prediction.alike, uniform)[:, :, np.newaxis]
        mixed = np.where(rate > 0, values + rate * (self._worst - values), values)
        return np.where(np.isnan(self._worst), drawn, mixed)  # a failure that has no worth leaves no mean

    def expected(self, features: Floats) -> Floats:
        """Returns the values that the model expects, shape (n, n_values)."""
        belief = self.predict(features, pending=False)
        belief = replace(belief, alike=np.zeros_like(belief.alike))  # a mean counts the mean share of failures
        values: Floats = self.values(belief, np.zeros((1, 1, 1)), np.full((1, 1), 0.5))[0]
        return values

    def runs(self, features: Floats, normal: Floats, uniform: Floats) -> Floats:
        """Returns draws of single answers at n sets as the model expects them; shapes as of `values`."""
        belief = self.predict(features, pending=False)
        noise = np.broadcast_to([output.noise for output in self._outputs], belief.means.shape)
        none = np.zeros(len(features))
        values = self.values(Belief(belief.means, noise, none, none), normal, np.full_like(uniform, 0.5))
        return np.where((uniform < belief.failing)[:, :, np.newaxis], self._worst, values)

    def to_json(self) -> list[dict[str, Any]]:
        """Returns as plain data what answers alone do not tell."""
        tuned = (output.tuned for output in (*self._outputs, self._failure))
        return [{"lengths": row.lengths.tolist(), "noise": row.noise, "luck": row.luck, "count": row.count} for row in tuned]

    def restore(self, documents: Sequence[Mapping[str, Any]]) -> None:
        """Inverts `to_json`."""
        for output, document in zip((*self._outputs, self._failure), documents, strict=True):
            output.tuned = Hyperparameters(**{**document, "lengths": np.array(document["lengths"], dtype=np.float64)})


def _correlation(share: Floats) -> Floats:
    """Returns how far two runs of a set are alike in failing: the correlation of normal numbers that decide it (Sheppard 1899).

    Args:
        share: Variance of the probability of a failure, as a share of the variance of one run, which is 1 where all runs fail or none.
    """
    result: Floats = np.minimum(np.sin(np.pi / 2 * np.minimum(share, 1.0)), MOST_ALIKE)
    return result


def _rates(failing: Floats, alike: Floats, uniform: Floats) -> Floats:
    """Returns draws of the share of a set's runs that fail (Vasicek 1987), shape (n_draws, n): near `failing` where runs fail by chance,
    near 0 or 1 where all of a set's runs fail or none. One number for an unknown share would keep a search where nothing failed."""
    result: Floats = ndtr((ndtri(failing) + np.sqrt(alike) * ndtri(uniform)) / np.sqrt(1.0 - alike))
    return result


def _kept(features: Floats) -> Indices:
    """Returns the places of at most MOST answers, rising."""
    count = len(features)
    if count <= MOST:
        return np.arange(count)
    newest = np.arange(count - MOST // 3, count)
    spread = np.linspace(0, count - MOST // 3 - 1, MOST // 3).astype(np.int64)
    centre = features[-MOST // 3 :].mean(axis=0)
    near = np.argsort(((features - centre) ** 2).sum(axis=1), kind="stable")
    taken = np.unique(np.concatenate([newest, spread]))
    rest = near[~np.isin(near, taken)][: MOST - len(taken)]
    return np.sort(np.concatenate([taken, rest]))
