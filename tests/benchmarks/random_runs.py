"""Random simulators: how many runs find the best set, and what is then known of it: `run.py random`.

- Synthetic campaigns through the allocation of the product: sets at distances of 1, the noise of a run, and as much noise that all sets
  have in common. `equal`: the same sets and the same rule to stop, but all sets get equally many runs. Runs that report are not counted.
  `--kinds`: `normal` noise; `steps`: noisy ratings in six scenarios, rounded to scores 0..7; `failures`: runs also score 0 by chance.
- `--problems NAME ...`: problems of `economy`, or `choices`, whose objective has noise of `--noises` distances of the best and the tenth
  best of 100 random sets, and as much that all sets have in common, or `random_motorway`: the TRUE objective of the set that a campaign of
  `--cells` runs reports, over `--seeds` seeds, how far the report is off in the mean, in how many seeds an arm is better or worse than the
  first one, how many 95 % intervals hold the truth, the probability claimed that no set that was run is better than the reported one, the
  share of campaigns where none is, the share where the best one was listed as perhaps as good. `single` believes single samples, `after`
  has replicates after the search alone.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr
from tests.benchmarks._economy_problems import EconomyProblem, problem
from tests.benchmarks.economy import ARMS, Ended, Run, p_value, surrogate
from tests.support.values import by_score

from drivecal.analysis.replicates import assess, choosing, kept_back
from drivecal.analysis.solutions import Ranking
from drivecal.campaigns.stages.replication import next_runs
from drivecal.contracts.specification import ReplicatesSpecification
from drivecal.domain.evaluations import CellScore
from drivecal.plugins.ports import Floats
from drivecal.plugins.search import AskedCell, CellAnswer

Drawn = tuple[Floats, Floats, Floats]
TARGET = Path(".drivecal/bench/random.json")
NOISES = (0.5, 1.0, 3.0)
MANY, USUAL = ReplicatesSpecification(most=200), ReplicatesSpecification()
SEEDS, FRESH, REPORTING = 10_000, range(1001, 1101), 8
"""Number of a campaign's seeds, the seeds for the truth of its best set, and the number of seeds for its report."""
WAVES, LENGTH = 100, 0.3
"""Waves of luck that is alike for similar sets, and its length for one parameter, in ranges."""
ROOM = 8
"""Runs of a round."""
DISTANCE, BEST, SCENARIOS = 0.2, 6.0, 6
"""Distance of neighbours, true mean of the best set, and number of scenarios, of sets whose scores have steps."""
EQUAL = 200
"""Campaigns whose equal allocation is computed."""


def normal(generator: np.random.Generator, noise: float, sets: int, runs: int) -> Drawn:
    """Returns objectives, shape (sets, runs), ratings of the same shape, and the true means of sets at distances of 1."""
    means: Floats = -np.arange(sets, dtype=np.float64)
    common, own = generator.normal(size=runs), generator.normal(size=(sets, runs))
    samples = means[:, np.newaxis] + noise * (common + own)
    return samples, samples, means


def stepped(generator: np.random.Generator, noise: float, sets: int, runs: int, *, fails: bool = False) -> Drawn:
    """Returns the same of sets at distances of DISTANCE, whose objective is the mean of whole scores in SCENARIOS scenarios."""
    own, means = noise * DISTANCE * (0.5**0.5 if fails else 1.0), np.linspace(BEST, BEST - DISTANCE * (sets - 1), sets)
    failing = generator.uniform(0, 2, sets) * own**2 / 5 if fails else np.zeros(sets)  # a failure costs some 5.5 of 7 points
    deviation, grid = own * SCENARIOS**0.5, np.linspace(-20, 40, 6001)
    expected = ndtr((grid[:, np.newaxis] - np.arange(0.5, 7)) / (2**0.5 * deviation)).sum(axis=1)
    middles = np.interp(means / (1 - failing), expected, grid)
    drawn = generator.normal(size=(SCENARIOS, runs)) + generator.normal(size=(sets, SCENARIOS, runs))
    ratings = np.clip(middles[:, np.newaxis, np.newaxis] + deviation * drawn, 0, 7)
    ratings = np.where(generator.random(ratings.shape) < failing[:, np.newaxis, np.newaxis], 0.0, ratings)
    return np.floor(ratings + 0.5).mean(axis=1), ratings.mean(axis=1), means


KINDS: Mapping[str, Callable[..., Drawn]] = {"normal": normal, "steps": stepped, "failures": partial(stepped, fails=True)}


class Campaign:
    """Sets 0, 1, 2, ...; set 0 is the best. Its runs depend on the number of the campaign, the set and the seed alone."""

    def __init__(self, kind: str, noise: float, number: int, sets: int, wanted: ReplicatesSpecification) -> None:
        generator = np.random.Generator(np.random.PCG64([round(10 * noise), number]))
        self.samples, ratings, self._means = KINDS[kind](generator, noise, sets, wanted.most)
        values = np.stack([self.samples, ratings], axis=2)
        self._choosing, self.runs, ranking = choosing(wanted.most), 0, by_score({"S1": 1}, wanted=wanted)
        chosen = [(place, 1) for place in range(sets)]
        while chosen:
            for place, seed in chosen:
                score, rating = values[place, seed - 1].tolist()
                ranking.add([CellScore(place, "S1", score, rating, True, 0, place, seed=seed)])
            self.runs += sum(seed <= self._choosing for _, seed in chosen)
            chosen = next_runs(ranking, wanted, ROOM, sys.maxsize)
        self.ranking = ranking

    @property
    def is_right(self) -> bool:
        """True if the best set was chosen."""
        known = self.ranking.statistics()
        return known is not None and known[0][known[1].best(MANY.confidence)] == 0

    @property
    def is_covered(self) -> bool:
        """True if the interval of the chosen set holds its true mean."""
        best = self.ranking.best()
        if best is None or best[0].lower is None or best[0].upper is None:
            return False
        return best[0].lower <= float(self._means[best[0].parameter_set]) <= best[0].upper

    def equally(self, confidence: float) -> int:
        """Returns the runs after which the best set is known if all sets get equally many."""
        sets, most = len(self.samples), self._choosing
        for seeds in range(2, most + 1):
            standing = assess(self.samples[:, :seeds])
            leader = int(np.argmax(standing.means))
            if standing.is_known and standing.probabilities[leader] >= confidence:
                return sets * seeds
        return sets * most


def allocated(
    kinds: Sequence[str], sizes: Sequence[int], noises: Sequence[float], campaigns: int, figures: dict[str, list[float]]
) -> Iterator[str]:
    """Yields a line for each kind, each number of sets and each noise, and adds its figures: right choices, the share of their runs in the
    runs of equal allocation (by the first campaigns), and intervals that hold the chosen set's true mean, with the usual replicates."""
    yield f"{'':10}{'sets':>5}{'noise':>7}{'right':>9}{'runs':>9}{'runs/equal':>12}{'95 % intervals':>16}"
    for kind, sets, noise in product(kinds, sizes, noises):
        decided = [Campaign(kind, noise, number, sets, MANY) for number in range(campaigns)]
        right = float(np.mean([campaign.is_right for campaign in decided]))
        runs, first = float(np.mean([campaign.runs for campaign in decided])), decided[:EQUAL]
        share = sum(each.runs for each in first) / sum(each.equally(MANY.confidence) for each in first)
        held = float(np.mean([Campaign(kind, noise, number, sets, USUAL).is_covered for number in range(campaigns)]))
        figures[f"{kind} {sets} {noise}"] = [right, share, held]
        yield f"{kind:10}{sets:>5}{noise:>7}{100 * right:>7.1f} %{runs:>9.1f}{100 * share:>10.0f} %{100 * held:>14.1f} %"


def smooth(seed: tuple[int, ...], shares: Floats) -> float:
    """Returns a draw of variance 1 at a set, by shares of its ranges, that is alike for sets near each other: under one seed a sum of
    waves with random frequencies (Rahimi and Recht 2007)."""
    frequencies, phases, weights = waves(seed, len(shares))
    return float(weights @ np.cos(frequencies @ shares + phases))


@lru_cache(10_000)
def waves(seed: tuple[int, ...], parameters: int) -> tuple[Floats, Floats, Floats]:
    generator = np.random.default_rng([*seed, WAVES])
    frequencies = generator.normal(size=(WAVES, parameters)) / (LENGTH * parameters**0.5)
    return frequencies, generator.uniform(0, 2 * np.pi, WAVES), generator.normal(size=WAVES) * (2 / WAVES) ** 0.5


class RandomRun(Run):
    """Runs a problem of `economy` under the seeds of a campaign, and ranks its sets."""

    def __init__(self, chosen: EconomyProblem, cells: int, noise: float, number: int, *, is_smooth: bool = False) -> None:
        """`noise`: deviation of a run's objective, and as much again for what all sets have in common."""
        super().__init__(chosen, cells)
        self._smooth, self._last = is_smooth, np.maximum(np.asarray(chosen.space.n_values) - 1, 1)
        self._noise, self._number, self.sets = noise * len(chosen.scenarios) ** 0.5, number, dict[tuple[int, ...], int]()
        self._answers: list[CellScore] = []
        self.ranking = self._ranked()

    def _ranked(self) -> Ranking:
        return by_score(dict.fromkeys(self.problem.scenarios, 1.0), self.problem.scale, USUAL)

    def _sampled(self, cell: AskedCell) -> CellAnswer:
        """Returns the answer of a cell under the seed of its replicate."""
        if not self._noise:
            return self.problem.answer(cell, SEEDS * self._number + cell.replicate)
        answer, scale = self.problem.answer(cell), self.problem.scale
        if answer.failed:
            return answer
        seed = (self._number, cell.scenario, cell.replicate)
        own = (
            smooth(seed, np.array(cell.indices) / self._last)
            if self._smooth
            else np.random.default_rng([*seed, *cell.indices]).normal()
        )
        drawn = own + np.random.default_rng(seed).normal()
        return CellAnswer(cell, (scale.worth(answer.values[0] + self._noise * drawn),))

    def _scored(self, answer: CellAnswer) -> CellScore:
        cell, (rating,) = answer.cell, answer.values
        score = float(np.floor(rating + 0.5)) if self.problem.scale.step else rating
        number, name = self.sets.setdefault(cell.indices, len(self.sets)), self.problem.scenarios[cell.scenario]
        return CellScore(number, name, score, rating, True, 0, number, seed=cell.replicate, failed=answer.failed)

    def cell(self, cell: AskedCell) -> CellAnswer:
        """Returns the answer of a cell under the seed of its replicate. Raises Ended when the budget is spent."""
        if len(self._answers) >= self._cells:
            raise Ended
        answer = self._sampled(cell)
        self._values.setdefault(cell.indices, {}).setdefault(cell.scenario, answer.values[0])
        self._answers.append(self._scored(answer))
        self.ranking.add(self._answers[-1:])
        return replace(answer, failed=self._answers[-1].score == self.problem.scale.failed)

    def replicate(self, cells: int) -> None:
        """Spends the rest of a budget of `cells` on the best sets."""
        self._cells, scenarios = cells, range(len(self.problem.scenarios))
        sets = list(self.sets)
        while chosen := next_runs(self.ranking, USUAL, 2, (cells - len(self._answers)) // len(scenarios)):
            for number, seed in chosen:
                for scenario in scenarios:
                    self.cell(AskedCell(sets[number], scenario, seed))

    def _truth(self, number: int) -> float:
        cells = [AskedCell(list(self.sets)[number], place) for place in range(len(self.problem.scenarios))]
        return self.problem.objective([self.problem.answer(cell).values[0] for cell in cells])

    def claims(self) -> tuple[float, bool, bool]:
        """Returns the claimed probability of the best set, whether none is better, and whether the truly best one is listed as good."""
        order = self.ranking.best_first()
        truths = [self._truth(each.parameter_set) for each in order]
        as_good = [truth for truth, each in zip(truths, order, strict=True) if each is order[0] or each.is_close]
        claimed = float(np.array(order[0].probability_best, dtype=np.float64))  # NaN for None
        return claimed, truths[0] >= max(truths) - 1e-9, max(as_good) >= max(truths) - 1e-9

    def result(self) -> tuple[float, float, list[bool]]:
        """Returns the true objective of the best set, the reported one, higher is better, and whether intervals hold the truth: of the
        campaign, and of every other 8 fresh seeds in the place of the report's."""
        best, _ = self.ranking.best() or (None, 0)
        if best is None:
            return -np.inf, np.nan, []
        sign, scenarios = self.problem.scale.sign, range(len(self.problem.scenarios))
        cells = [AskedCell(list(self.sets)[best.parameter_set], scenario) for scenario in scenarios]
        if self._noise:
            truth = self._truth(best.parameter_set)
            return truth, sign * best.objective, [] if best.lower is None else [best.lower <= sign * truth <= (best.upper or 0)]
        fresh = [[self._scored(self._sampled(replace(cell, replicate=seed))) for cell in cells] for seed in FRESH]
        means, last = np.array([[cell.score for cell in run] for run in fresh]).mean(axis=1), choosing(USUAL.most)
        reports = [(best, float(means.mean()))]
        for first in range(0, len(fresh) - REPORTING, REPORTING) if best.lower is not None else ():
            again, block = self._ranked(), slice(first, first + REPORTING)
            again.add(cell for cell in self._answers if cell.seed <= last)
            again.add(replace(cell, seed=last + 1 + place) for place, run in enumerate(fresh[block]) for cell in run)
            known = again.get(best.parameter_set)
            reports += [] if known is None else [(known, float(np.delete(means, block).mean()))]
        held = [each.lower <= truth <= (each.upper or 0) for each, truth in reports if each.lower is not None]
        return float(means.mean()), best.objective, held


SEARCHES: Mapping[str, Callable[[Run, int], None]] = {
    "single": surrogate(2, 5),
    "after": surrogate(2, 5),
    "surrogate": surrogate(2, 5, random=True, replicates=choosing(USUAL.most)),
    **{name: ARMS[name] for name in ("random", "genetic_20", "tpe")},
}


def reported(
    chosen: EconomyProblem, arm: str, seed: int, cells: int, noise: float, *, is_smooth: bool = False
) -> tuple[tuple[float, float, list[bool]], tuple[float, bool, bool]]:
    """Returns the result of a campaign, and what it claims of its best set."""
    kept = 0 if arm == "single" else kept_back(cells, len(chosen.scenarios), USUAL.most, by_cell=arm == "surrogate")
    run = RandomRun(chosen, cells - kept, noise, seed, is_smooth=is_smooth)
    with suppress(Ended):
        SEARCHES[arm](run, seed)
    if kept:
        run.replicate(cells)
    return run.result(), run.claims() if noise else (np.nan, False, False)


def distance(chosen: EconomyProblem) -> float:
    """Returns the distance of the best and the tenth best objective of 100 random sets, without failed ones."""
    rows = chosen.task(None).sample(100, np.random.default_rng(1)).tolist()
    answers = [[chosen.answer(AskedCell(tuple(row), place)) for place in range(len(chosen.scenarios))] for row in rows]
    known = [chosen.objective([each.values[0] for each in row]) for row in answers if not any(each.failed for each in row)]
    return float(np.subtract(*np.sort(known)[[-1, -10]]))


def compared(options: Any, figures: dict[str, list[float]]) -> Iterator[str]:
    """Yields a line for each problem, noise, budget and arm, compared with the first arm, and adds the true objectives by seed."""
    yield (
        f"{'':16}{'noise':>6}{'runs':>6}{'arm':>11}{'true':>10}{'worst':>10}{'error':>9}{'too good':>9}{'better':>8}"
        f"{'intervals':>25}{'claimed':>9}{'best':>8}{'listed':>8}"
    )
    for name, cells in product(options.problems, options.cells):
        chosen = problem(name, options.cache)
        for noise in [0.0] if name == "random_motorway" else options.noises:
            deviation, seeds = noise * distance(chosen) if noise else 0.0, range(1, options.seeds + 1)
            by_seed = [
                [reported(chosen, arm, seed, cells, deviation, is_smooth=options.smooth) for arm in options.arms]
                for seed in seeds
            ]
            for arm, ended in zip(options.arms, zip(*by_seed, strict=True), strict=True):
                results, claims = zip(*ended, strict=True)
                probable, *right = zip(*claims, strict=True)
                claimed = np.mean([each for each in probable if np.isfinite(each)] or [np.nan])
                truths = figures[f"{name} {noise} {cells} {arm}"] = [truth for truth, *_ in results]
                off, held = (
                    np.array([report - truth for truth, report, _ in results]),
                    [each for *_, own in results for each in own],
                )
                others = np.subtract(truths, figures[f"{name} {noise} {cells} {options.arms[0]}"])
                yield (
                    f"{name:16}{noise:>6}{cells:>6}{arm:>11}{np.mean(truths):>10.3f}{min(truths):>10.3f}{np.abs(off).mean():>9.3f}"
                    f"{off.mean():>9.3f}{sum(others > 1e-9):>4}:{sum(others < -1e-9):<3}{p_value(others):>14}"
                    f"{sum(held):>7} of {len(held)}{claimed:>9.2f}" + "".join(f"{np.mean(share):>8.2f}" for share in right)
                )


def main(arguments: Sequence[str]) -> int:
    """Measures; returns 0 if the choice is right and cheap, and intervals hold what they say."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaigns", type=int, default=1000)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--sets", type=int, nargs="+", default=[10, 30])
    parser.add_argument("--noises", type=float, nargs="+", default=NOISES)
    parser.add_argument("--problems", nargs="*", default=[])
    parser.add_argument("--arms", nargs="+", choices=SEARCHES, default=list(SEARCHES))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--cells", type=int, nargs="+", default=[300, 600])
    parser.add_argument("--smooth", action="store_true", help="luck that is alike for similar sets")
    parser.add_argument("--cache", type=Path, help="folder of simulated answers")
    options, figures = parser.parse_args(arguments), dict[str, list[float]]()
    synthetic = allocated(options.kinds, options.sets, options.noises, options.campaigns, figures)
    for line in compared(options, figures) if options.problems else synthetic:
        print(line, flush=True)
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(figures))
    if options.problems:
        return 0
    return int(not all(right >= 0.95 and runs <= 0.5 and 0.93 <= held <= 0.97 for right, runs, held in figures.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
