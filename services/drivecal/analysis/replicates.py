"""Chooses the best of several sets whose runs are random, and the runs that decide it. Pure.

All sets meet the same seeds. The objective of a set under a seed is its mean, plus the effect of the seed, plus noise: what seeds have in
common disappears from comparisons. The last seeds are kept back: they choose no set, and so report the best one without bias.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from drivecal.plugins.ports import Floats

KEPT, KEPT_BY_CELL = 0.3, 0.15
"""Shares of a budget for the runs after a search by populations, and after a search that requests further seeds itself."""
FRESH = 0.4
"""Share of a set's runs that report it and do not choose it."""
SHRINKAGE = 4
"""Degrees of freedom of the pooled variance in the variance of a set."""
FEWEST = 3
"""Degrees of freedom that make the noise known."""
FEWEST_REPORTING = 3
"""Runs that report a best set, if the budget does not suffice for more."""
FIRST = 4
"""Sets that get a second run before the noise is known."""
RATIOS = np.array([*np.logspace(-14, -6, 9), *np.logspace(-5, 1, 19)])
"""Variances of a run, in variances of the means of sets; the most probable one is taken."""
SEED_RATIOS = (1e-12, 1e-8, 1e-3, 0.1, 1.0, 10.0, 1e4)
"""The same in variances of the effects of seeds."""
DRAWS = 4000
"""Draws of the means of sets that tell how probably each is the best."""
QUANTILES = 200
"""Points of a distribution over which probabilities are integrated."""
MOST_BAD_LUCK = 2.0
"""The largest move of the mean of a worse set, in errors."""
LEAST_APART = 0.1
"""Least squared distance of sets, in the largest squared error."""
NEGLIGIBLE = 0.05
"""Rivals whose probability is below this share of the permitted error get no runs."""
LISTED = 200
"""Most sets whose probability to be the best is computed."""


def choosing(most: int) -> int:
    """Returns how many of a set's `most` runs choose it: the first seeds. The others report it; none if there would be fewer than two."""
    fresh = int(most * FRESH)
    return most - fresh if fresh > 1 else most


def kept_back(budget: int, scenarios: int, most: int, shown: int = 0, of_variants: int = 0, *, by_cell: bool) -> int:
    """Returns the simulations of a budget that are kept for the runs after the search: at most a third, or a half if rates need `shown`
    seeds at least. `of_variants`: scenarios of each variant, in sum."""
    share = KEPT_BY_CELL if by_cell else KEPT
    needed = fewest(scenarios, most, shown, of_variants, by_cell=by_cell)
    return min(budget // (2 if shown else 3), max(int(share * budget), needed)) if most > 1 else 0


def fewest(scenarios: int, most: int, shown: int = 0, of_variants: int = 0, *, by_cell: bool = False) -> int:
    """Returns the simulations that the choice and the report of the best set need at least, and the reports of variants; `shown`: seeds
    that rates need. A search `by_cell` requests further seeds itself, so that the report alone needs some."""
    reporting = most - choosing(most)
    least = min(FEWEST_REPORTING, reporting)
    runs = least if by_cell and not shown else reporting + max(FIRST, shown)
    return runs * scenarios + least * of_variants if most > 1 else 0


@dataclass(frozen=True)
class SetStatistics:
    """Statistics of n sets. All arrays have the shape (n,)."""

    counts: npt.NDArray[np.int64]
    """Runs of each set."""
    means: Floats
    """Means without the effects of seeds; higher is better."""
    variances: Floats
    """Variance of a run without the effect of its seed; NaN if the noise is unknown."""
    spreads: Floats
    """Variance of a run, the effect of its seed included."""
    freedom: Floats
    """Degrees of freedom of the variances."""
    spread_freedom: Floats
    """Degrees of freedom of the spreads."""
    noise: float | None = None
    """Deviation of a run without the effect of its seed, over all sets; None if unknown."""
    skewness: float = 0.0
    """Skewness of a run, over all sets; above 0 if the longer tail is on the better side."""
    failing: tuple[Floats, npt.NDArray[np.bool_], float | None] | None = None
    """Samples, failed runs and level, as `assess` takes them; None if no run failed."""

    def of(self, rows: Sequence[int]) -> "SetStatistics":
        """Returns the statistics of some of the sets."""
        names = ("counts", "means", "variances", "spreads", "freedom", "spread_freedom")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    @property
    def errors(self) -> Floats:
        """Standard errors of comparisons."""
        result: Floats = np.sqrt(self.variances / self.counts)
        return result

    @property
    def standard_errors(self) -> Floats:
        """Standard errors of the sets' own means."""
        result: Floats = np.sqrt(self.spreads / self.counts)
        return result

    @property
    def is_known(self) -> bool:
        """True if the noise is known."""
        return bool(np.isfinite(self.variances).all())

    @property
    def is_random(self) -> bool:
        """True if there is noise."""
        return bool(self.is_known and self.spreads.max(initial=0.0) > 0)

    def bounds(self, confidence: float) -> Floats:
        """Returns what each set reaches at least with this confidence; its mean if the noise is unknown."""
        if not self.is_known:
            return self.means
        result: Floats = self.means - NormalDist().inv_cdf(confidence) * self.errors
        return result

    def half_widths(self, confidence: float) -> Floats:
        """Returns half the widths of two-sided intervals of the sets' own means (Student)."""
        from scipy.special import stdtrit

        result: Floats = stdtrit(self.spread_freedom, 0.5 + confidence / 2) * self.standard_errors
        return result

    def best(self, confidence: float) -> int:
        """Returns the set with the highest bound."""
        return int(np.argmax(self.bounds(confidence)))

    def ahead(self, leader: int) -> Floats:
        """Returns the probability that each set is better than the leader; 0 for itself."""
        from scipy.special import stdtr  # takes a part of a second

        error = np.sqrt(self.errors**2 + self.errors[leader] ** 2)
        distance = self.means - self.means[leader]
        with np.errstate(divide="ignore", invalid="ignore"):
            result: Floats = stdtr(np.minimum(self.freedom, self.freedom[leader]), distance / error)
        result = np.where(error > 0, result, np.where(distance > 0, 1.0, np.where(distance < 0, 0.0, 0.5)))
        result[leader] = 0.0
        return result

    @cached_property
    def sound_noise(self) -> float | None:
        """Deviation of a run that did not fail, without the effect of its seed, over these sets; None if unknown."""
        if self.failing is None:
            return self.noise
        samples, failed, _ = self.failing
        others = np.where(failed, np.nan, samples)
        sound = others[np.isfinite(others).any(axis=1)]
        return assess(sound).noise if len(sound) else None

    @cached_property
    def probabilities(self) -> Floats:
        """Probability of each set to be the best; NaN: unknown. Only the LISTED most promising ones have one above 0.

        A rare failure is no noise of all sets: the mean of a set is the mean of its other runs, less what failures lose in the share of its
        runs that fail. This share is drawn as its runs tell it, and the share of all sets as SHRINKAGE runs more.
        """
        from scipy.special import stdtrit

        known, sound, failures, lost = self, np.arange(len(self.means)), np.zeros(len(self.means)), 0.0
        if self.failing is not None:
            samples, failed, level = self.failing
            others = np.where(failed, np.nan, samples)
            sound = np.flatnonzero(np.isfinite(others).any(axis=1))
            if level is not None:
                return np.full(len(samples), np.nan)
            if not len(sound) or not (known := assess(others[sound])).is_known:  # failures are noise like all else then
                return replace(self, failing=None).probabilities
            failures, lost = failed[sound].sum(axis=1), float(samples[failed].mean())
        listed = np.argsort(-(known.means + 2 * known.errors), kind="stable")[:LISTED]
        means, counts, failures = known.means[listed], known.counts[listed], failures[listed]
        prior = max(SHRINKAGE * failures.sum() / (failures + counts).sum(), 1e-9)
        random, shape = np.random.Generator(np.random.PCG64(1)), (DRAWS, len(listed))
        freedoms, places = np.unique(known.freedom[listed], return_inverse=True)
        # equal shares of the draws in equal shares of t
        usual = stdtrit(freedoms, (np.arange(DRAWS)[:, np.newaxis] + 0.5) / DRAWS)[:, places]
        drawn = means + np.maximum(known.errors[listed], 1e-12 * np.maximum(1.0, np.abs(means))) * random.permuted(
            usual, axis=0
        )
        if self.failing is not None:
            drawn -= random.beta(failures + prior, counts + SHRINKAGE - prior, shape) * (means - lost)
        return np.bincount(sound[listed[drawn.argmax(axis=1)]], minlength=len(self.means)) / DRAWS


def assess(
    samples: Floats, level: float | None = None, failed: npt.NDArray[np.bool_] | None = None, rows: Sequence[int] | None = None
) -> SetStatistics:
    """Returns what runs say about sets.

    Args:
        samples: objective of each set under each seed, higher is better, shape (n, n_seeds); NaN without a run. Each set has a run.
        level: of the quantiles that take the place of means; None for means.
        failed: which runs failed, of the same shape; they tell no effects of seeds, and probabilities count them by their rate.
        rows: the sets to compare, None for all; the others tell the noise, too.
    """
    known = _means(samples, failed)
    if level is not None:
        known = _quantiles(samples, known, level)
    if rows is not None:
        known, samples = known.of(rows), samples[rows]
        failed = None if failed is None else failed[rows]
    if failed is not None and failed.any():
        known = replace(known, failing=(samples, failed, level))
    return _without_luck(known) if known.is_known and level is None else known


def _means(samples: Floats, failed: npt.NDArray[np.bool_] | None) -> SetStatistics:
    run = np.isfinite(samples)
    counts = run.sum(axis=1)
    several = counts > 1
    # a rare failure is no effect of its seed
    effects, noise, common, lost = _effects(samples if failed is None else np.where(failed, np.nan, samples))
    filled = np.where(run, samples - effects, 0.0)
    means = filled.sum(axis=1) / counts
    residuals = np.where(run, samples - effects - means[:, np.newaxis], 0.0)
    raw = np.where(run, samples, 0.0).sum(axis=1) / counts
    deviations = np.where(run, samples - raw[:, np.newaxis], 0.0)
    sets_by_seed = run[several].sum(axis=0)
    used, own = sets_by_seed > 0, counts - 1.0
    freedom, least = own.sum() - lost, max(own.sum() - max(used.sum() - 1, 0), 0.0)  # if all effects may have any size
    if least < FEWEST:
        unknown, few = np.full(len(samples), np.nan), np.full(len(samples), least)
        return SetStatistics(counts, means, unknown, unknown, few, few)
    if np.abs(deviations).max() <= 1e-12 * np.abs(raw).max():  # rounding is no noise
        residuals = deviations = np.zeros_like(deviations)
    squares, spread = max(float((residuals**2).sum()), noise * freedom), (deviations**2).sum() / own.sum()
    # scores with steps may be equal by chance: one further run might have been a step away
    noise = (squares + _step(samples[run]) ** 2) / (freedom + 1.0) if spread > 0 else 0.0
    prior = min(SHRINKAGE, freedom)
    # residuals of a set lose a little to the effects of seeds
    variances = (prior * noise + (residuals**2).sum(axis=1) * own.sum() / freedom) / (prior + own)
    # a few equal runs, or none with a rare failure, make no set surer than all together
    variances = np.maximum(variances, noise)
    triples = float((own * (counts - 2) / counts).sum())  # cubes of two runs cancel out
    skewness = float((deviations**3).sum() / triples / spread**1.5) if triples > 0 and spread > 0 else 0.0
    freedoms, spreads = np.minimum(prior + own, freedom), variances + (common if spread > 0 else 0.0)
    share = (spreads - variances) / np.maximum(spreads, 1e-300)
    spread_freedoms = 1 / (share**2 / (used.sum() - 1) + (1 - share) ** 2 / freedoms)  # Satterthwaite 1946
    return SetStatistics(counts, means, variances, spreads, freedoms, spread_freedoms, noise**0.5, skewness)


def _step(values: Floats) -> float:
    """Returns the least distance of different values; next to nothing without steps."""
    gaps = np.diff(np.sort(values))
    return float(gaps[gaps > 1e-9 * np.ptp(values)].min(initial=np.inf)) if np.ptp(values) > 0 else 0.0


def _without_luck(known: SetStatistics) -> SetStatistics:
    """Draws means to their median, each by the share of luck in it (James and Stein 1961), so that no lucky single run stands before many
    good ones. The better half tells how far sets are apart: a search asks for many bad sets, but for few that beat its best ones. Worse
    sets move by `MOST_BAD_LUCK` errors at most (Efron and Morris 1972): the others are bad, not unlucky. Errors stay what they are."""
    middle, errors = float(np.median(known.means)), known.errors**2
    better = known.means > middle
    if not better.any():
        return known
    apart = float(((known.means[better] - middle) ** 2 - errors[better]).mean())
    luck = errors / (errors + max(apart, LEAST_APART * float(errors.max()), 1e-300))
    return replace(known, means=known.means + np.minimum(luck * (middle - known.means), MOST_BAD_LUCK * known.errors))


def _quantiles(samples: Floats, known: SetStatistics, level: float) -> SetStatistics:
    """Returns quantiles in the place of means: of a set's own runs together with the deviations of all sets, which count as SHRINKAGE runs.
    Their errors are as of normal runs, the effects of seeds included."""
    several = known.counts > 1
    counts = known.counts[several, np.newaxis]
    deviations = (samples[several] - np.nanmean(samples[several], axis=1, keepdims=True)) * np.sqrt(counts / (counts - 1))
    deviations = deviations[np.isfinite(deviations)]
    pooled = np.quantile(deviations, (np.arange(QUANTILES) + 0.5) / QUANTILES) if len(deviations) else deviations
    quantiles = []
    for row, mean in zip(samples, known.means.tolist(), strict=True):
        own = row[np.isfinite(row)]
        values = np.concatenate([own, mean + pooled])
        shares = np.concatenate([np.ones(len(own)), np.full(len(pooled), SHRINKAGE / QUANTILES)])
        order = np.argsort(values, kind="stable")
        reached = np.cumsum(shares[order])
        quantiles.append(float(values[order][np.searchsorted(reached, level * reached[-1] - 1e-9)]))
    spreads = known.spreads * widening(level) ** 2
    return replace(known, means=np.array(quantiles), variances=spreads, spreads=spreads)


def widening(level: float | None) -> float:
    """Returns the standard error of a quantile in that of the mean, for normal values; 1 for the mean."""
    usual = NormalDist()
    return 1.0 if level is None else (level * (1 - level)) ** 0.5 / usual.pdf(usual.inv_cdf(level))


def _effects(samples: Floats) -> tuple[Floats, float, float, float]:
    """Returns what seeds add to all sets, of mean 0, shape (n_seeds,), the variance of a run without it, the variance of such effects, and
    the degrees of freedom that they take; zeros if too few sets tell.

    Sets get further runs because their first one was good. Means of these sets alone take their luck for an effect of the first seed, and
    leave some 0.7 of the noise. So sets are draws from a normal distribution around the median, effects are draws as well (Henderson
    1975), and the restricted likelihood (Patterson and Thompson 1971) tells which part of a first run is luck. Where effects are small,
    sets are compared by all their runs, also under seeds of their own. Sets `MOST_BAD_LUCK` below the median are bad, not unlucky.
    """
    run = np.isfinite(samples)
    several = run.sum(axis=1) > 1
    rows, effects = run[several].astype(np.float64), np.zeros(samples.shape[1])
    used, counts = rows.any(axis=0), rows.sum(axis=1)
    if not len(rows) or counts.sum() - len(rows) < used.sum():
        return effects, 0.0, 0.0, 0.0
    first = int(np.argmax(np.where(used, run.sum(axis=0), 0)))
    centred = np.where(run, samples - np.median(samples[run[:, first], first]), 0.0)
    is_better, values = centred[:, first] > 0, centred[several]
    alone, good = centred[is_better & ~several, first], np.ones(len(rows), dtype=np.bool_)
    if is_better.any():
        good = values[:, first] > -MOST_BAD_LUCK * (centred[is_better, first] ** 2).mean() ** 0.5
    values[~good] -= rows[~good] * (values[~good].sum(axis=1) / counts[~good])[:, np.newaxis]
    free = np.flatnonzero(used & (np.arange(len(used)) != first))
    part, freedom = rows[:, free], counts.sum() - (~good).sum() + len(alone)
    ratios = RATIOS[:: 1 + len(free) // 60]  # many seeds tell enough of sets, and matrices are as large
    drawn = np.where(good, ratios[:, np.newaxis], 0.0)  # by ratio and set, as all that follows
    weights = 1 / (counts + drawn)
    told = np.diag(part.sum(axis=0)) - part.T @ (part * weights[:, :, np.newaxis])
    right = values[:, free].sum(axis=0) - (weights * values.sum(axis=1)) @ part
    constant = np.log1p(counts[good] / ratios[:, np.newaxis]).sum(axis=1) + len(alone) * np.log1p(1 / ratios)
    prior, least = np.eye(len(free)) - 1 / (len(free) + 1), np.inf  # of differences from the effect of the first seed
    for ratio in SEED_RATIOS:
        added, design = np.zeros((len(ratios), len(used))), told + ratio * prior
        added[:, free] = np.linalg.solve(design, right[:, :, np.newaxis])[:, :, 0]
        left, away = values - rows * added[:, np.newaxis], ((added[:, free] @ prior) * added[:, free]).sum(axis=1)
        means = left.sum(axis=2) / counts
        within = ((left - rows * means[:, :, np.newaxis]) ** 2).sum(axis=(1, 2)) + (means**2 * counts * weights * drawn).sum(
            axis=1
        )
        noises = np.maximum((within + ratio * away + (alone**2).sum() * ratios / (1 + ratios)) / freedom, 1e-300)
        improbable = freedom * np.log(noises) + constant + np.linalg.slogdet(design).logabsdet - len(free) * np.log(ratio)
        likely = int(np.argmin(improbable))
        if improbable[likely] < least:
            least, effects, noise = improbable[likely], added[likely], noises[likely]
            doubt = np.trace(np.linalg.solve(design[likely], prior))
            common, lost = (away[likely] + noise * doubt) / len(free), len(free) - ratio * doubt
    return np.where(used, effects - effects[used].mean(), 0.0), float(noise), float(common), float(lost)


def allocate(standing: SetStatistics, room: int, most: int, confidence: float) -> list[int]:
    """Returns the sets that get the next runs, as often as each gets one; empty if the best one is known, or none may have more.

    The leader and the rival that is hardest to tell from it get runs in the shares that decide soonest (Chen and Ryzhov 2019, balancing
    optimal large deviations); means stay what they are within a round.

    Args:
        standing: what is known.
        room: the largest number of runs.
        most: runs of a set at most.
        confidence: with which the best set is to be known.
    """
    counts, room = standing.counts.astype(np.float64), max(0, room)
    if not standing.is_known:
        order = np.argsort(-standing.means, kind="stable")[: FIRST if len(counts) > 1 else 0].tolist()
        return sorted([place for place in order if counts[place] < most], key=lambda place: counts[place])[:room]
    if not standing.is_random:
        return []
    leader = int(np.argmax(standing.means))
    ahead = standing.ahead(leader)
    shown = standing.probabilities
    if np.isnan(shown[leader]):  # what failures mean for quantiles is not known
        shown = replace(standing, failing=None).probabilities
    if shown[leader] >= confidence:
        return [leader][:room] if counts[leader] < min(2, most) else []  # no single run is sure
    rivals = np.flatnonzero(ahead > NEGLIGIBLE * (1 - confidence))
    variances = np.maximum(standing.variances, 1e-300)
    distances = (standing.means[leader] - standing.means) ** 2
    chosen: list[int] = []
    while len(chosen) < room:
        free = rivals[(counts[rivals] < most) | (counts[leader] < most)]
        if not len(free):
            break
        errors = variances / counts
        rival = int(free[np.argmin(distances[free] / (errors[leader] + errors[free]))])
        others = (counts**2 / variances).sum() - counts[leader] ** 2 / variances[leader]
        needs_leader = counts[leader] ** 2 / variances[leader] < others
        place = leader if (needs_leader and counts[leader] < most) or counts[rival] >= most else rival
        counts[place] += 1
        chosen.append(place)
    return chosen


def unbeaten(known: Sequence[SetStatistics], front: Sequence[int], confidence: float) -> npt.NDArray[np.bool_]:
    """Returns which sets no set of a front is known to beat in every objective, shape (n,). `known` has the statistics by objective."""
    means, errors = np.stack([each.means for each in known], axis=1), np.stack([each.errors for each in known], axis=1)
    beaten = np.zeros(len(means), dtype=np.bool_)
    for place in front:
        margins = NormalDist().inv_cdf(confidence) * np.hypot(errors[place], errors)
        beaten |= (means[place] - means >= margins).all(axis=1)
    return ~beaten


def to_tell(standing: SetStatistics, leader: int, rival: int, confidence: float) -> int | None:
    """Returns how many runs of each of two sets of known noise would tell them apart; None if they are equal so far."""
    distance = abs(standing.means[leader] - standing.means[rival])
    if distance <= 0:
        return None
    both = standing.variances[leader] + standing.variances[rival]
    return max(1, int(np.ceil(NormalDist().inv_cdf(confidence) ** 2 * both / distance**2)))


def interval(
    values: Sequence[float],
    level: float | None,
    confidence: float,
    spread: float = 0.0,
    freedom: float = 0.0,
    skewness: float = 0.0,
) -> tuple[float | None, float | None]:
    """Returns a two-sided interval of at least two independent values: of the mean (Student, corrected for the `skewness` of such values as
    by Hall 1992, Journal of the Royal Statistical Society B 54(1)), or of the quantile of this `level`, exact by order statistics. An end
    of a quantile is None if there are too few values for it. `spread`, `freedom`: see `variance`."""
    from scipy.special import bdtr, stdtrit

    if level is None:
        error = float(np.sqrt(variance(values, spread, freedom) / len(values)))
        own, mean = len(values) - 1, float(np.mean(values))
        skewed = float(np.clip(skewness, -1.5, 1.5)) * min(1.0, (own - 1) / 6) / (own + 1) ** 0.5  # estimated by few runs
        bend = skewed * (3 * own / (own + freedom) - 1) / 6  # the variance of other runs does not lean with this mean
        points = stdtrit(freedom + own, np.array([0.5 + confidence / 2, 0.5 - confidence / 2])) - skewed / 6
        if abs(bend) > 1e-6:
            points = (np.cbrt(1 + 3 * bend * points) - 1) / bend
        lower, upper = (mean - error * points).tolist()
        return lower, upper
    ordered, tail = sorted(values), (1 - confidence) / 2
    above = bdtr(np.arange(len(ordered), dtype=np.float64), len(ordered), level)  # probability of each to be above the quantile
    under, over = int((above <= tail).sum()), int((above < 1 - tail).sum())
    return ordered[under - 1] if under else None, ordered[over] if over < len(ordered) else None


def variance(values: Sequence[float], spread: float, freedom: float) -> float:
    """Returns the variance of at least two values, pooled with the `spread` of other runs (degrees of `freedom`): few runs often
    lack a rare bad one, and runs with equal scores are no proof that there is no noise."""
    own = len(values) - 1
    return (freedom * spread + own * float(np.var(values, ddof=1))) / (freedom + own)


def rate_bounds(bad: int, runs: int, confidence: float = 0.975) -> tuple[float, float]:
    """Returns what a rate is at least and at most, each with this confidence, if `bad` of `runs` count (Clopper, Pearson 1934); (0, 1)
    without runs. By default both are the exact two-sided 95 % interval."""
    from scipy.special import betaincinv

    least = 0.0 if bad == 0 else float(betaincinv(bad, runs - bad + 1, 1 - confidence))
    return least, 1.0 if bad == runs else float(betaincinv(bad + 1, runs - bad, confidence))


def exceeding(bad: int, runs: int, rate: float) -> float:
    """Returns how probably the true share is above a rate, if `bad` of `runs` count: at the rate that `rate_bounds` gives at most, it is
    1 less the confidence."""
    from scipy.special import betainc

    return 1.0 if bad == runs else 1.0 - float(betainc(bad + 1, runs - bad, rate))
