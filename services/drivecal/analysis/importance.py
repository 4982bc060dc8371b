"""Importance of parameters for a score, by permutation on held-out sets (Breiman 2001; Fisher, Rudin and Dominici 2019)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivecal.plugins.ports import Floats

LEAST_SETS = 40
"""Fewer sets leave too few for a judgement by held-out ones."""
MOST_SETS = 2_000
"""Most sets that are learned from; more are sampled evenly, so that an answer takes seconds at most."""
HELD_OUT = 1 / 3
TREES = 100
REPEATS = 5
UNEXPLAINED = 1 / 8
"""Addition to the upper end of each importance, in parts of the root of the share that the forest does not predict."""
RESAMPLED = 1_000
"""Bootstrap samples behind an interval."""


@dataclass(frozen=True, slots=True)
class Importances:
    """Half the fall of R² on held-out sets when a parameter's values are shuffled among them: the total effect of an independent parameter
    as a share of their variation (Jansen 1999), where the forest predicts them. `mean`, shape (n_parameters,), is over the repetitions.
    `lower` and `upper` bound the 95 % interval. A forest that predicts a part s of each deviation from the mean has an R² of 1 - (1 - s)²
    and shows the part s of a total effect: `upper` is divided by it. `r2` is R² without shuffling: 1 if the forest predicts the held-out
    sets exactly, 0 if no better than their mean. `held_out` of the `sets` were kept for the test. `spread`: width of the middle
    80 % of the sets in each feature."""

    mean: Floats
    lower: Floats
    upper: Floats
    r2: float
    sets: int
    held_out: int
    spread: Floats


def importances(features: Floats, values: Floats) -> Importances | None:
    """Returns the importance of each of the `features`, shape (n, n_parameters), for `values`, shape (n,); None if there are fewer than
    LEAST_SETS sets or their values are all the same. The same arguments give the same answer."""
    if len(values) < LEAST_SETS:
        return None
    from sklearn.ensemble import ExtraTreesRegressor  # takes seconds, which a server that is not asked need not pay

    spread = np.ptp(np.quantile(features, [0.1, 0.9], axis=0), axis=0)
    chosen = np.unique(np.linspace(0, len(values) - 1, min(len(values), MOST_SETS)).astype(np.int64))
    features, values = _shares(features[chosen]), _shares(values[chosen, np.newaxis])[:, 0]
    generator = np.random.default_rng(0)
    judged, learned = np.split(generator.permutation(len(values)), [round(HELD_OUT * len(values))])
    if np.ptp(values[judged]) == 0 or np.ptp(values[learned]) == 0:
        return None
    forest = ExtraTreesRegressor(TREES, min_samples_leaf=2, random_state=0, n_jobs=1)
    forest.fit(features[learned], values[learned])
    own = forest.predict(features[judged])
    undisturbed = float(_r2(own[np.newaxis], values[judged])[0])
    losses, added = np.empty((features.shape[1], REPEATS)), np.empty((features.shape[1], len(judged)))
    for column in range(features.shape[1]):
        shuffled = np.tile(features[judged], (REPEATS, 1, 1))
        shuffled[:, :, column] = [generator.permutation(features[judged, column]) for _ in range(REPEATS)]
        predicted = forest.predict(shuffled.reshape(-1, features.shape[1])).reshape(REPEATS, len(judged))
        losses[column] = (undisturbed - _r2(predicted, values[judged])) / 2
        added[column] = (((predicted - values[judged]) ** 2).mean(axis=0) - (own - values[judged]) ** 2) / 2
    lower, upper = _interval(added, values[judged], generator)
    left = (1.0 - max(undisturbed, 0.0)) ** 0.5
    lower, upper = np.minimum([lower, upper / max(1.0 - left, 1e-9) + UNEXPLAINED * left], 1.0)  # no share is more than all
    return Importances(losses.mean(axis=1), lower, upper, undisturbed, len(values), len(judged), spread)


def mean_of(parts: Sequence[tuple[float, Importances]]) -> Importances:
    """Returns the mean of the importances for several values with positive weights. Their errors are alike: parts share their sets."""
    weights, known = zip(*parts, strict=True)
    names = ("mean", "lower", "upper", "r2", "spread")
    figures = {name: np.average([getattr(part, name) for part in known], axis=0, weights=weights) for name in names}
    return Importances(**figures, sets=max(part.sets for part in known), held_out=max(part.held_out for part in known))


def _interval(added: Floats, values: Floats, generator: np.random.Generator) -> tuple[Floats, Floats]:
    """Returns the 95 % interval of importances, shape (n_parameters,) each, by the bootstrap over held-out sets (Efron 1979). `added`:
    squared error that shuffling adds at each set, shape (n_parameters, n)."""
    counts = generator.multinomial(len(values), np.full(len(values), 1 / len(values)), size=RESAMPLED).astype(np.float64)
    means = counts @ values / len(values)
    variation = counts @ values**2 / len(values) - means**2
    varied = variation > 1e-9 * values.var()  # a sample of equal values has no shares; 1e-9: rounding
    shares = (counts @ added.T / len(values))[varied] / variation[varied, np.newaxis]
    lower, upper = np.quantile(shares, [0.025, 0.975], axis=0)
    return lower, upper


def _shares(columns: Floats) -> Floats:
    """Returns columns as shares of their ranges, 0 without one: trees compare in 32 bits, and take small spreads for none."""
    lowest, spans = columns.min(axis=0), np.ptp(columns, axis=0)
    shares: Floats = (columns - lowest) / np.where(spans > 0, spans, 1.0)
    return shares


def _r2(predicted: Floats, values: Floats) -> Floats:
    """Returns the coefficient of determination of each row of predictions, shape (n_repetitions, n)."""
    left = np.sum((predicted - values) ** 2, axis=1)
    whole: Floats = 1 - left / np.sum((values - values.mean()) ** 2)
    return whole
