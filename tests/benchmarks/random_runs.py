"""Random simulators: how many runs find the best set, and what is then known of it: `run.py random`.

- Synthetic campaigns through the allocation of the product: sets at distances of 1, the noise of a run, and as much noise that all sets
  have in common. `equal`: the same sets and the same rule to stop, but all sets get equally many runs. Runs that report are not counted.
  `--kinds`: `normal` noise; `steps`: noisy ratings in six scenarios, rounded to scores 0..7; `failures`: runs also score 0 by chance.
- `--problems NAME ...`: problems of `economy` with noise, a share (`--noise`) of the quartiles' distance of random sets, half of its
  variance common to all sets: the TRUE objective of the set that a campaign of `--cells` runs reports, over `--seeds` seeds, and in how
  many it is at least as good as `single`, which calls the best single sample the best set. `after`: replicates after the search alone.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr
from tests.benchmarks._economy_problems import EconomyProblem, problem
from tests.benchmarks.economy import ARMS, FIRST_SEED, Ended, Run, surrogate

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
        self._choosing, self.runs, ranking = choosing(wanted.most), 0, Ranking({"S1": 1}, wanted=wanted)
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
        known = self.ranking.standing()
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
            if standing.is_known and standing.probability(leader, range(sets)) >= confidence:
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
        yield f"{kind:10}{sets:>5}{noise:>7}{right:>9.1%}{runs:>9.1f}{share:>12.0%}{held:>16.1%}"


class NoisyRun(Run):
    """Runs a problem of `economy` under seeds, and ranks its sets."""

    def __init__(self, chosen: EconomyProblem, cells: int, noise: float, number: int) -> None:
        super().__init__(chosen, cells)
        self._number, self._numbers, self.spent = number, dict[tuple[int, ...], int](), 0
        rows = chosen.task(None).sample(100, np.random.default_rng(1)).tolist()
        self._noise = []
        for scenario in range(len(chosen.scenarios)):
            answers = [chosen.answer(AskedCell(tuple(row), scenario)) for row in rows]
            values = [answer.values[0] for answer in answers if not answer.failed]
            self._noise.append(noise * float(np.subtract(*np.percentile(values, [75, 25]))) / np.sqrt(2))
        weights = dict.fromkeys(chosen.scenarios, 1.0)
        self.ranking = Ranking(weights, chosen.scale.sign, span=chosen.scale.span, wanted=USUAL)

    def cell(self, cell: AskedCell) -> CellAnswer:
        """Returns the answer of a cell under the seed of its replicate. Raises Ended when the budget is spent."""
        if self.spent >= self._cells:
            raise Ended
        self.spent += 1
        answer, scale = self.problem.answer(cell), self.problem.scale
        if not answer.failed:
            seed = (self._number, cell.scenario, cell.replicate)
            drawn = np.random.default_rng([*seed, *cell.indices]).normal() + np.random.default_rng(seed).normal()
            value = answer.values[0] + self._noise[cell.scenario] * drawn
            answer = CellAnswer(cell, (scale.sign * max(scale.sign * value, scale.sign * scale.failed),))
        number, value = self._numbers.setdefault(cell.indices, len(self._numbers)), answer.values[0]
        name, failed = self.problem.scenarios[cell.scenario], answer.failed
        self._values.setdefault(cell.indices, {}).setdefault(cell.scenario, value)
        self.ranking.add([CellScore(number, name, value, value, True, 0, number, seed=cell.replicate, failed=failed)])
        return answer

    def replicate(self, cells: int) -> None:
        """Spends the rest of a budget of `cells` on the best sets."""
        self._cells, sets, scenarios = cells, list(self._numbers), len(self.problem.scenarios)
        while chosen := next_runs(self.ranking, USUAL, 2, (cells - self.spent) // scenarios):
            for number, seed in chosen:
                for scenario in range(scenarios):
                    self.cell(AskedCell(sets[number], scenario, seed))

    @property
    def truth(self) -> float:
        """The true objective of the best set, higher is better."""
        best = self.ranking.best()
        if best is None:
            return -np.inf
        indices = list(self._numbers)[best[0].parameter_set]
        cells = [AskedCell(indices, scenario) for scenario in range(len(self.problem.scenarios))]
        return self.problem.objective([self.problem.answer(cell).values[0] for cell in cells])


SEARCHES: Mapping[str, Callable[[Run, int], None]] = {
    "single": surrogate(2, 5),
    "after": surrogate(2, 5),
    "surrogate": surrogate(2, 5, random=True, replicates=choosing(USUAL.most)),
    **{name: ARMS[name] for name in ("random", "genetic_20", "tpe")},
}


def reported(name: str, arm: str, seed: int, cells: int, noise: float) -> float:
    """Returns the true objective of the set that a campaign reports."""
    chosen = problem(name)
    kept = 0 if arm == "single" else kept_back(cells, len(chosen.scenarios), USUAL.most, by_cell=arm == "surrogate")
    run = NoisyRun(chosen, cells - kept, noise, seed)
    with suppress(Ended):
        SEARCHES[arm](run, seed)
    if kept:
        run.replicate(cells)
    return run.truth


def compared(options: Any, figures: dict[str, list[float]]) -> Iterator[str]:
    """Yields a line for each problem and arm, and adds the true objectives by seed."""
    yield f"{'':16}{'arm':>12}{'mean':>10}{'worst':>10}{'>= single':>11}"
    for name in options.problems:
        for arm in options.arms:
            seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
            truths = figures[f"{name} {arm}"] = [reported(name, arm, seed, options.cells, options.noise) for seed in seeds]
            single = figures.get(f"{name} single", truths)
            better = sum(ours >= theirs - 1e-9 for ours, theirs in zip(truths, single, strict=True))
            yield f"{name:16}{arm:>12}{np.mean(truths):>10.3f}{min(truths):>10.3f}{better:>8} of {len(truths)}"


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
    parser.add_argument("--cells", type=int, default=600)
    parser.add_argument("--noise", type=float, default=0.3)
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
