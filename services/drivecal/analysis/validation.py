"""Validation of the reduction (Section V of the paper): are answers really the same when the influence map says so?

Sets are drawn over the whole space until the sets in non-influential regions cover all main effects and interactions of the reducible
parameters. Each of these sets is compared with variants that differ from it only inside its regions.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from drivecal.analysis.replicates import rate_bounds
from drivecal.contracts.campaign import ErrorRate
from drivecal.domain.constraints import Constraints
from drivecal.domain.evaluations import AuditCount
from drivecal.domain.parameters import Indices
from drivecal.domain.scales import Scale
from drivecal.plugins.ports import Floats

ROWS = 1_000
"""Rows of the table of all pairs of combinations that are in memory at a time."""
MOST_EXACT = 16
"""Largest number of reducible parameters whose 2^n - 1 effects are all examined; for more, effects of up to three parameters are."""
REDRAWN = 10
"""How often the changes of a variant are drawn again, if each of them breaks constraints."""
HYPERCUBE, VARIANTS, REGION = 0, 1, 2
"""Purposes of the stream."""


Region = range | tuple[int, ...]
"""Grid indices, ascending: an interval, or some texts of a choice."""


class ReducibleSpace:
    """Regions of a scenario's map without influence. Values of a parameter in the same region answer for each other."""

    def __init__(self, n_values: Indices, regions: Sequence[Sequence[Region]]) -> None:
        """Leaves out regions of one value. `n_values` are grid sizes, shape (n_searched,). The `regions` of a parameter are disjoint."""
        self.n_values = n_values
        self._regions = [[region for region in listed if len(region) > 1] for listed in regions]

    @property
    def reducible(self) -> Indices:
        """The columns of the parameters with a region of more than one value."""
        columns: Indices = np.flatnonzero([len(regions) > 0 for regions in self._regions])
        return columns

    def variable(self, points: Indices) -> npt.NDArray[np.bool_]:
        """Returns the values with others in their region, shape (n, n_searched)."""
        variable = np.zeros(points.shape, dtype=np.bool_)
        for column, regions in enumerate(self._regions):
            for region in regions:
                variable[:, column] |= _lies_in(points[:, column], region)
        return variable

    def variant(self, point: Indices, columns: Indices, generator: np.random.Generator) -> Indices:
        """`point`, shape (n_searched,), with another value of the same region in each of `columns`."""
        changed = point.copy()
        for column in columns.tolist():
            own = int(point[column])
            members = next(region for region in self._regions[column] if own in region)
            other = members[int(generator.integers(0, len(members) - 1))]
            changed[column] = members[-1] if other == own else other
        return changed


def _lies_in(indices: Indices, region: Region) -> npt.NDArray[np.bool_]:
    if isinstance(region, range):
        return (indices >= region.start) & (indices < region.stop)
    return np.isin(indices, region)


@dataclass(frozen=True, slots=True)
class Coverage:
    """Number of `effects` (main effects and interactions) of the `reducible` parameters, and of `covered` ones."""

    reducible: int
    effects: int
    covered: int

    @property
    def complete(self) -> bool:
        """True if all effects are covered."""
        return self.covered == self.effects


def coverage(masks: npt.NDArray[np.bool_]) -> Coverage:
    """Returns the coverage of sets that can vary in the reducible parameters of `masks`, shape (n_sets, n_reducible).

    If the parameters A of a set can vary, the set covers the effect of every non-empty subset of A.
    """
    n = masks.shape[1]
    if n > MOST_EXACT:
        return _coverage_to_third_order(masks)
    covered = np.zeros(1 << n, dtype=np.bool_)
    covered[masks @ (1 << np.arange(n))] = True
    for bit in range(n):  # a subset is covered if it, or it with one parameter more, is
        split = covered.reshape(-1, 2, 1 << bit)
        split[:, 0] |= split[:, 1]
    return Coverage(n, (1 << n) - 1, int(covered[1:].sum()))


def _coverage_to_third_order(masks: npt.NDArray[np.bool_]) -> Coverage:
    n = masks.shape[1]
    member = masks.astype(np.float64)
    pairs = member.T @ member > 0
    triples = sum(int(np.triu(member[:, j + 1 :].T @ (member[:, j + 1 :] * member[:, [j]]) > 0, 1).sum()) for j in range(n - 2))
    covered = int(np.diag(pairs).sum()) + int(np.triu(pairs, 1).sum()) + triples
    return Coverage(n, n + n * (n - 1) // 2 + n * (n - 1) * (n - 2) // 6, covered)


@dataclass(frozen=True, slots=True)
class ValidationDesign:
    """Sets that one scenario's validation simulates: `bases`, shape (n_lhs, n_searched), and `variants`, shape (n_lhs, n_ref, n_searched);
    `drawn`: the size of the Latin hypercube that the bases were taken from."""

    bases: Indices
    variants: Indices
    drawn: int
    coverage: Coverage


def design(
    space: ReducibleSpace, samples: int, references: int, seed: int, largest: int, constraints: Constraints | None = None
) -> ValidationDesign | None:
    """Returns the validation design of a scenario; None if no parameter can be reduced.

    Latin hypercubes of `samples`, 2 `samples`, 4 `samples` ... points are drawn until their qualifying sets cover all effects, at most
    `largest` points. If some effects stay uncovered, the coverage reports them. A large hypercube finds the few sets with several small
    regions among many others. So only the sets that the coverage needs are kept, and the first others up to `samples` in total. Each
    variant changes a random non-empty subset of the values that can vary.

    With `constraints` the points are the feasible ones of the hypercube, or, if these are less than half, a sample of the feasible part.
    Variants change as much as keeps the constraints. A base without a feasible neighbour may have variants that break them; the caller
    must not run these.
    """
    reducible = space.reducible
    if not reducible.size:
        return None
    for size in _sizes(samples, largest):
        points = _latin_hypercube(space.n_values, size, generator("validation", seed, HYPERCUBE))
        if constraints and 2 * len(points := points[constraints.feasible(points)]) < size:
            points = constraints.whole_region.sample(size := min(size, 10 * samples), generator("validation", seed, REGION))
        varies = space.variable(points)
        qualified, masks = points[varies.any(axis=1)], varies[varies.any(axis=1)][:, reducible]
        covered = coverage(masks)
        if covered.complete or len(points) == 10 * samples:
            break
    if not len(qualified):
        return None
    kept = _kept(masks, samples)
    qualified, covered = qualified[kept], coverage(masks[kept])
    variants = _variants(space, np.repeat(qualified, references, axis=0), constraints, generator("validation", seed, VARIANTS))
    variants = variants.reshape(len(qualified), references, len(space.n_values))
    return ValidationDesign(qualified, variants, size, covered)


@dataclass(frozen=True, slots=True)
class Differences:
    """Differences of the variants' scores from their base's, shape (n_bases, n_ref); NaN if either has no score."""

    values: Floats

    @property
    def known(self) -> Floats:
        """The differences of variants and bases with scores, shape (n,)."""
        known: Floats = self.values[~np.isnan(self.values)]
        return known

    def wrong_shares(self, largest_agreeing: float) -> Floats:
        """The share of variants beyond `largest_agreeing` by base, shape (n,), of the bases with a compared variant."""
        compared = (~np.isnan(self.values)).sum(axis=1)
        wrong = (np.abs(self.values) > largest_agreeing).sum(axis=1)  # a comparison with NaN is false
        return np.asarray(wrong[compared > 0] / compared[compared > 0], dtype=np.float64)


def _kept(masks: npt.NDArray[np.bool_], samples: int) -> Indices:
    """Returns the at most `samples` sets to keep, ascending: the first of each maximal combination, which cover all, the largest
    combinations before others; then the first sets."""
    combinations, first = np.unique(masks, axis=0, return_index=True)
    every, contained = combinations.astype(np.float32), np.zeros(len(combinations), dtype=np.bool_)
    for start in range(0, len(every), ROWS):
        some = every[start : start + ROWS]
        within = some @ every.T == some.sum(axis=1, keepdims=True)
        contained[start : start + ROWS] = within.sum(axis=1) > 1  # in itself in any case
    needed = first[~contained]
    needed = needed[np.argsort(-masks[needed].sum(axis=1), kind="stable")][:samples]
    others = np.setdiff1d(np.arange(len(masks)), needed)
    kept: Indices = np.sort(np.concatenate([needed, others[: max(0, samples - len(needed))]])).astype(np.int64)
    return kept


def _sizes(samples: int, largest: int) -> Iterator[int]:
    size = samples
    while size < largest:
        yield size
        size *= 2
    yield largest


def _latin_hypercube(n_values: Indices, size: int, drawing: np.random.Generator) -> Indices:
    from scipy.stats import qmc

    points = qmc.LatinHypercube(len(n_values), rng=drawing).random(size)
    indices: Indices = np.floor(points * n_values).astype(np.int64)
    return indices


def _variants(space: ReducibleSpace, bases: Indices, constraints: Constraints | None, drawing: np.random.Generator) -> Indices:
    """Returns a variant of each base, shape (n, n_searched). If its changes break constraints, it has a part of them, taken one after
    the other; if each one breaks some, others are drawn."""
    varies = space.variable(bases)
    rows = np.array([_variant(*pair, space, drawing) for pair in zip(bases, varies, strict=True)], dtype=np.int64)
    if not constraints:
        return rows
    for _ in range(REDRAWN):
        broken = np.flatnonzero(~constraints.feasible(rows))
        kept = bases[broken]
        for column in drawing.permutation(bases.shape[1]).tolist():
            tried = kept.copy()
            tried[:, column] = rows[broken, column]
            kept = np.where(constraints.feasible(tried)[:, None], tried, kept)
        changed = (kept != bases[broken]).any(axis=1)
        rows[broken[changed]] = kept[changed]
        for place in broken[~changed].tolist():
            rows[place] = _variant(bases[place], varies[place], space, drawing)
    return rows


def _variant(base: Indices, varies: npt.NDArray[np.bool_], space: ReducibleSpace, generator: np.random.Generator) -> Indices:
    columns = np.flatnonzero(varies)
    chosen = columns[generator.random(len(columns)) < 0.5]
    if not chosen.size:
        chosen = generator.choice(columns, size=1)
    return space.variant(base, chosen, generator)


def generator(study: str, seed: int, *key: int) -> np.random.Generator:
    """Returns the generator of a `study` by its name, its `seed` and the `key` of one of its purposes.

    A list of numbers alone would not do: numpy fills short ones up with zeros, so that `PCG64([seed, 0])` is `PCG64(seed)`, the stream of
    every optimizer's start population. What is in a spawn key follows the filling and always counts.
    """
    name = int.from_bytes(study.encode(), "big")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(name, *key))))


CONFIDENCE = 0.95
STAKES = 40
"""Stakes below 1 in the mixture."""
SMALLEST = 1e-12
"""Smallest mean that is distinguished from 0."""
HALVINGS = 40
"""Halvings of the range of a limit's logarithm, to eleven digits."""


def mean_interval(shares: Floats) -> tuple[float, float]:
    """Returns the two-sided confidence interval of the mean of independent `shares` in [0, 1], shape (n,); (0, 1) for none. Shares of 0 and
    1 alone are counts, whose interval is exact.

    Raises ValueError if a share lies outside [0, 1].
    """
    if np.any(~((shares >= 0.0) & (shares <= 1.0))):
        raise ValueError("shares must lie between 0 and 1")
    if not shares.size:
        return 0.0, 1.0
    if np.minimum(shares, 1.0 - shares).max() <= SMALLEST:
        return rate_bounds(round(float(shares.sum())), len(shares))
    return _lower_limit(shares), 1.0 - _lower_limit(1.0 - shares)


def _lower_limit(shares: Floats) -> float:
    """The smallest mean that the bet on a higher one leaves; its capital falls with the mean."""
    values, counts = np.unique(shares, return_counts=True)
    angles = np.pi * (2 * np.arange(1, STAKES + 1) - 1) / (4 * STAKES)
    stakes, weights = np.append(np.sin(angles) ** 2, 1.0), np.log(np.append(np.full(STAKES, 0.5 / STAKES), 0.5))
    enough = np.log(2.0 / (1.0 - CONFIDENCE))

    def capital(mean: float) -> float:
        with np.errstate(divide="ignore"):  # a stake of 1 is lost at the first share of 0
            gains = np.log1p(stakes[:, np.newaxis] * (values / mean - 1.0))
        return float(np.logaddexp.reduce(weights + gains @ counts))

    if values[-1] < SMALLEST or capital(SMALLEST) < enough:
        return 0.0
    below, above = np.log(SMALLEST), np.log(float(shares.mean()))  # at the observed mean the capital is at most 1
    for _ in range(HALVINGS):
        middle = 0.5 * (below + above)
        below, above = (middle, above) if capital(float(np.exp(middle))) >= enough else (below, middle)
    return float(np.exp(below))


def compared(differences: Floats, scale: Scale) -> dict[str, Any]:
    """Returns the fields of a row that follow from differences of scores, shape (n,)."""
    total, away = len(differences), np.abs(differences)
    wrong = int((away > scale.largest_agreeing).sum())
    bins, counts = np.unique(_bars(differences, scale), return_counts=True)
    return {
        "compared": total,
        "wrong": wrong,
        "different": int((away > scale.rounding).sum()),
        "error_rate": wrong / total if total else None,
        "histogram": {str(number): count for number, count in zip(bins.tolist(), counts.tolist(), strict=True)},
        "histogram_step": scale.bin,
    }


def _bars(differences: Floats, scale: Scale) -> Indices:
    """Returns numbers of bars, 0 in the middle: a bar is wrong exactly if its differences are; the outermost hold all beyond the span."""
    last = scale.last_bar + 1
    numbers = np.clip(np.rint(differences / scale.bin), -last, last)
    agreeing = next((number - 1 for number in range(1, last) if scale.is_wrong(number * scale.bin)), last - 1)
    sizes = np.abs(numbers)
    wrong = np.abs(differences) > scale.largest_agreeing
    sizes = np.where(wrong, np.maximum(sizes, agreeing + 1), np.minimum(sizes, agreeing))
    bars: Indices = (np.copysign(1, differences) * sizes).astype(np.int64)
    return bars


def error_rates(
    counts: Iterable[AuditCount],
    scenarios: Iterable[str],
    contradictions: Mapping[str, int] | None = None,
    lots: Mapping[str, Mapping[str, int]] | None = None,
    released: Mapping[str, float] | None = None,
) -> dict[str, ErrorRate]:
    """Returns the error rate of each scenario (Eq. 8: wrong / audited), with `contradictions` and counts of `lots`.

    `released` has upper limits of the share of wrong answers that lots released. Lots are sampled in different shares, so only audits
    without lots have a Clopper-Pearson interval."""
    by_scenario = {count.scenario: count for count in counts}
    rates: dict[str, ErrorRate] = {}
    for scenario in scenarios:
        inspected = (lots or {}).get(scenario, {})
        rate = ErrorRate(contradictions=(contradictions or {}).get(scenario, 0), **inspected)
        count = by_scenario.get(scenario)
        if count is not None and count.audited:
            upper = (released or {}).get(scenario) if rate.lots else rate_bounds(count.wrong, count.audited)[1]
            counted = {"audited": count.audited, "different": count.different, "wrong": count.wrong, "upper_95": upper}
            rate = rate.model_copy(update=counted)
        rates[scenario] = rate
    return rates
