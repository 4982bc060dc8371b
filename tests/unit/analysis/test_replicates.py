"""Which sets get further runs, and what is then known of the best one: small synthetic campaigns with fixed seeds."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import permutations, product
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.stats import binomtest
from tests.support.values import COST, by_score, present

from drivecal.analysis import replicates
from drivecal.analysis.goals import UNDECIDED, Aggregate, Bound, CellValue, Goals, Objective, over_seeds
from drivecal.analysis.replicates import SetStatistics, allocate, assess, choosing, exceeding, interval, rate_bounds, to_tell
from drivecal.analysis.solutions import Ranking
from drivecal.campaigns.stages.replication import next_runs
from drivecal.contracts.specification import Quantile, ReplicatesSpecification
from drivecal.domain.evaluations import CellScore
from drivecal.domain.scales import COMFORT, Direction, Scale

SETS, CONFIDENCE, MOST = 12, 0.95, 300
USUAL = ReplicatesSpecification()
PRICE, GAP, ALONE = CellValue(measure="cost"), CellValue(measure="gap"), {"S1": 1.0}
LIMITED = Goals((Objective("cost", PRICE, ALONE, Aggregate(), -1),), (Bound("gap", GAP, ALONE, Aggregate(), 1, 2.0, 1.0),))


@dataclass
class Campaign:
    """Sets at distances of 1, noise of the sets, and as much noise that all sets have in common; set 0 is the best."""

    noise: float
    number: int

    def __post_init__(self) -> None:
        self._random = np.random.Generator(np.random.PCG64([int(10 * self.noise), self.number]))
        self._common = self.noise * self._random.normal(size=MOST)
        self.samples = np.full((SETS, MOST), np.nan)
        for place in range(SETS):
            self.run(place)

    def run(self, place: int) -> None:
        seed = int(np.isfinite(self.samples[place]).sum())
        self.samples[place, seed] = -place + self._common[seed] + self.noise * self._random.normal()

    @property
    def standing(self) -> SetStatistics:
        return assess(self.samples[:, : int(np.isfinite(self.samples).any(axis=0).sum())])

    @property
    def runs(self) -> int:
        return int(np.isfinite(self.samples).sum())

    def decide(self, *, equally: bool = False) -> int:
        """Runs until the best set is known, and returns it."""
        while True:
            standing = self.standing
            if not equally:
                chosen = allocate(standing, 8, MOST, CONFIDENCE)
            else:
                leader = int(np.argmax(standing.means))
                is_decided = standing.is_known and standing.probabilities[leader] >= CONFIDENCE
                chosen = [] if is_decided else list(range(SETS))
            if not chosen:
                return standing.best(CONFIDENCE)
            for place in chosen:
                self.run(place)


def one_run(number: int, seed: int, score: float, scenario: str = "S1", **more: Any) -> CellScore:
    return CellScore(number, scenario, score, score, True, 0, number, seed=seed, **more)


def ranked(runs: Mapping[int, Iterable[float]], scale: Scale = COMFORT, wanted: ReplicatesSpecification = USUAL) -> Ranking:
    """A ranking of sets with the scores of their seeds 1, 2, ..."""
    ranking = by_score({"S1": 1}, scale, wanted)
    ranking.add(one_run(number, seed, score) for number, scores in runs.items() for seed, score in enumerate(scores, 1))
    return ranking


@pytest.mark.slow("1.0-40")
@pytest.mark.faults("3.0-40")
@pytest.mark.parametrize(("noise", "campaigns"), [(0.5, 40), (1.0, 40), (3.0, 40)])
def test_the_best_set_is_found_with_fewer_runs_than_equal_ones(noise: float, campaigns: int) -> None:
    right, runs, equal = 0, 0, 0
    for number in range(campaigns):
        adaptive, equally = Campaign(noise, number), Campaign(noise, number)
        right += adaptive.decide() == 0
        equally.decide(equally=True)
        runs, equal = runs + adaptive.runs, equal + equally.runs
    assert right >= 0.95 * campaigns
    assert runs <= 0.6 * equal


@pytest.mark.parametrize("sign", [-1, 1])
def test_intervals_of_skewed_runs_miss_as_often_on_both_sides(sign: int) -> None:
    drawn = sign * (np.random.Generator(np.random.PCG64(1)).exponential(size=(1000, 20)) - 1)
    known = assess(drawn[:, :12])
    assert known.skewness == pytest.approx(2 * sign, abs=0.3)
    missed = {}
    for skewness in (0.0, known.skewness):
        ends = [interval(row[12:].tolist(), None, CONFIDENCE, 0.0, 0.0, skewness) for row in drawn]
        missed[skewness] = sum((lower or 0) > 0 for lower, _ in ends), sum((upper or 0) < 0 for _, upper in ends)
    assert sum(missed[known.skewness]) <= 0.07 * len(drawn) < sum(missed[0.0])
    assert abs(np.subtract(*missed[known.skewness])) < abs(np.subtract(*missed[0.0])) / 2
    assert interval([1, 2], None, CONFIDENCE, 1.0, 11.0, known.skewness) == interval([1, 2], None, CONFIDENCE, 1.0, 11.0)


def test_effects_that_all_sets_share_disappear_from_comparisons() -> None:
    effects = 100.0 * np.array([0.0, 1.0, -2.0, 4.0, 1.0])
    noise = 0.1 * np.random.Generator(np.random.PCG64(1)).normal(size=(6, 5))
    samples = -np.arange(6.0)[:, np.newaxis] + effects + noise
    samples[3:, 1:] = np.nan  # one run each, under the first seed
    standing = assess(samples)
    assert np.allclose(standing.means - standing.means[0], -np.arange(6.0), atol=0.3)
    assert standing.errors.max() < 0.3 < 10 < standing.standard_errors.min()
    samples = np.random.Generator(np.random.PCG64(3)).normal(size=(8, 60))
    samples[1:, 4:] = np.nan
    moved = assess(samples + (np.arange(60) > 3)).means - assess(samples).means
    assert moved[0] - moved[1] > 0.3, "runs under seeds that no other set has count as well"


def test_equal_sets_are_the_best_with_equal_probability_however_large_their_objectives() -> None:
    assert assess(np.full((2, 6), 1e6)).probabilities == pytest.approx([0.5, 0.5], abs=0.05)


def test_equal_runs_need_no_further_ones() -> None:
    samples = np.tile(np.arange(5.0)[:, np.newaxis] / 10, (1, 3))  # a mean of three equal ones is another number
    assert allocate(assess(samples), 8, 20, CONFIDENCE) == []
    assert not assess(samples).is_random


def test_the_first_further_runs_go_to_the_best_sets() -> None:
    assert allocate(assess(np.array([[1.0], [5.0], [4.0], [2.0], [3.0]])), 8, 20, CONFIDENCE) == [1, 2, 4, 3]
    samples = np.array([[5.0, 5.1], [4.0, np.nan], [3.0, np.nan], [2.0, np.nan], [1.0, np.nan]])
    assert allocate(assess(samples), 2, 20, CONFIDENCE) == [1, 2], "before the noise is known"


def test_neither_small_noise_nor_a_set_far_off_changes_the_noise_that_is_found() -> None:
    sets, drawn = np.random.default_rng(1).normal(size=(2, 40, 3))
    for noise, far in ((1e-6, 0.0), (0.1, 1e6), (0.1, -1e8)):
        samples = sets[:, :1] + noise * drawn + far * np.eye(40)[:, :1]
        assert assess(samples).noise == pytest.approx(noise, rel=0.3)


def test_a_value_that_a_run_lacks_has_a_mean_in_a_report_only() -> None:
    cells = [one_run(1, 1, 5.0, values={"gap": 1.0}), one_run(1, 2, 5.0)]
    assert (over_seeds(cells).values, over_seeds(cells, partial=True).values) == ({}, {"gap": 1.0})


def test_no_set_gets_more_runs_than_it_may() -> None:
    samples = np.random.Generator(np.random.PCG64(2)).normal(size=(3, 5))
    assert allocate(assess(samples), 100, 5, 0.999) == []
    counts = np.bincount(allocate(assess(samples), 100, 7, 0.999), minlength=3)
    assert counts.max() <= 2


def test_the_last_seeds_report_and_do_not_choose() -> None:
    assert [choosing(most) for most in (1, 4, 5, 10, 20)] == [1, 4, 3, 6, 12]
    scores = {1: [5.0, 5.2, 4.9, 1.0, 1.4], 2: [4.0, 4.1, 4.3], 3: [3.0, 3.2, 2.9]}
    best = present(ranked(scores, wanted=ReplicatesSpecification(most=5)).best())
    assert (best[0].parameter_set, best[0].replicates) == (1, 5)
    assert best[0].objective == pytest.approx(1.2)
    assert present(best[0].lower) < 1.2


def test_a_set_with_one_lucky_run_stands_behind_a_set_that_is_known() -> None:
    ranking = by_score({"S1": 1}, COST, ReplicatesSpecification(most=4))
    known = {1: [2.0, 2.4, 1.8, 2.2], 2: [3.0, 3.5, 2.6, 3.1], 3: [1.95]}
    for number, listed in known.items():
        ranking.add(one_run(number, seed, score, failed=seed == 2) for seed, score in enumerate(listed, 1))
    best_first = ranking.best_first()
    assert [solution.parameter_set for solution in best_first] == [1, 3, 2]
    assert best_first[1].is_close
    assert (best_first[1].runs_to_tell or 0) > 1
    assert [solution.failures for solution in best_first] == [1, 0, 1]


def test_a_rare_failure_is_no_noise_of_sets_that_do_not_fail() -> None:
    """Set 0 is the best without its one failure, and loses more by a rate of 5 % than what it is ahead."""
    ranking, scores = by_score({"S1": 1}), 0.3 * (np.random.default_rng(1).normal(size=(4, 12)) - np.arange(4)[:, np.newaxis])
    scores[0, 5] = -15
    for (place, seed), x in np.ndenumerate(scores):
        ranking.add([one_run(place, seed + 1, x, failed=x == -15)])
    chances = [getattr(ranking.get(place), "probability_best", 0.0) for place in range(4)]
    assert chances[1] > 0.6 > 0.3 > chances[0] > 0.1 > chances[3]
    assert np.isnan(assess(scores, 0.1, scores == -15).probabilities).all()
    assert assess(scores, None, scores < 15).probabilities.sum() == pytest.approx(1), "if all fail, failures are noise"


def test_kept_runs_report_the_best_set_though_the_noise_is_unknown() -> None:
    ranking = ranked({1: [5.0, 5.2], 2: [4.0, 4.1], 3: [3.0]}, wanted=ReplicatesSpecification(most=5))
    chosen = next_runs(ranking, ReplicatesSpecification(most=5), 2, 2)
    assert chosen == [(1, 4), (1, 5)]
    ranking.add(one_run(1, seed, score) for (_, seed), score in zip(chosen, (1.0, 2.0), strict=True))
    best = present(ranking.best())
    assert (best[0].parameter_set, best[0].objective) == (1, 1.5)
    assert best[0].lower is not None
    assert ranking.close() == 2, "two differences of runs tell no set from the best one"


def test_runs_that_report_choose_nothing_through_constraints() -> None:
    ranking = Ranking({"S1": 1}, LIMITED, ReplicatesSpecification(most=5))
    kept = {1: [(1.0, 2.5), (1.1, 2.5), (1.2, 2.5), (1.3, 0.5), (1.4, 0.5)], 2: [(3.0, 2.5), (3.1, 2.5), (3.2, 2.5)]}
    for number, runs in kept.items():
        ranking.add(one_run(number, seed, 0.0, values={PRICE.key: run[0], GAP.key: run[1]}) for seed, run in enumerate(runs, 1))
    best = present(ranking.best())
    assert best[0].parameter_set == 1
    assert best[0].violation == pytest.approx(1.5)
    [front] = ranking.front()  # a set is on it by the values that it shows
    assert (front.solution.replicates, front.solution.violation, front.cells["S1"].values[GAP.key]) == (3, 0.0, 2.5)


def test_sets_that_break_constraints_tell_the_noise_of_those_that_keep_them() -> None:
    ranking = Ranking({"S1": 1}, LIMITED, ReplicatesSpecification(most=5))
    broken = {number: [(1.0, 2.5), (5.0, 0.5)] for number in range(1, 5)}
    for number, runs in (broken | {5: [(2.9, 2.5), (3.1, 2.5)], 6: [(2.5, 2.5)]}).items():
        for seed, (cost, width) in enumerate(runs, 1):
            ranking.add([one_run(number, seed, 0, values={PRICE.key: cost, GAP.key: width})])
    assert [each.parameter_set for each in ranking.best_first()[:2]] == [5, 6], "one lucky run"


def test_the_noise_of_each_scenario_is_told() -> None:
    ranking, random = by_score({"S1": 1, "S2": 1}, wanted=USUAL), np.random.default_rng(1)
    for number in range(20):
        for seed in range(1, 5):
            values = {"S1": number + seed + 0.1 * random.normal(), "S2": 2 * number + 0.4 * random.normal()}
            ranking.add(one_run(number, seed, value, name) for name, value in values.items())
    best = present(ranking.best())
    assert ranking.noise() == pytest.approx({"S1": 0.1, "S2": 0.4}, rel=0.3)
    assert ranking.failed_runs(best[0].parameter_set) == (0, 8)


def test_runs_that_would_tell_grow_with_the_noise() -> None:
    drawn, means = np.random.default_rng(1).normal(size=(SETS, 2)), np.arange(SETS)[:, np.newaxis]
    needed = [to_tell(assess(noise * drawn - means), 0, 1, CONFIDENCE) or 0 for noise in (0.5, 3.0)]
    assert 1 <= needed[0] < needed[1]


def test_a_budget_keeps_runs_for_the_choice() -> None:
    assert replicates.kept_back(600, 6, 20, by_cell=False) == 180
    assert replicates.kept_back(1000, 6, 20, by_cell=True) == 150
    assert replicates.kept_back(100, 6, 20, by_cell=False) == 33
    assert replicates.kept_back(100, 6, 20, by_cell=True) == 18
    assert replicates.kept_back(100, 6, 20, 10, by_cell=True) == 50
    assert replicates.kept_back(600, 6, 1, by_cell=True) == 0
    assert replicates.kept_back(600, 6, 20, of_variants=50, by_cell=True) == 168


def test_sets_are_compared_under_the_seeds_that_both_have() -> None:
    counts = {1: 14, 2: 20}
    ranking = ranked({n: [n + 0.01 * seed + 50.0 * (seed > 12) for seed in range(1, most + 1)] for n, most in counts.items()})
    assert present(ranking.best())[0].objective > 50, "reported by its last seeds"
    best, other = present(ranking.beside_best(1))
    assert best.parameter_set == 2
    assert best.objective - other.objective == pytest.approx(1.0)
    best, other = present(ranking.beside_best(1, [13, 14]))
    assert (best.seeds, other.seeds) == ((13, 14), (13, 14))
    assert best.objective - other.objective == pytest.approx(1.0)
    assert [ranking.beside_best(1, seeds) for seeds in ([], [12, 13], [14, 15])] == [None] * 3


def test_each_objective_of_a_front_is_the_mean_over_seeds_of_the_objective_of_a_run() -> None:
    worst = Objective("worst", CellValue(COST), {"S1": 0.5, "S2": 0.5}, Aggregate("max"), -1)
    ranking = Ranking(worst.shares, Goals((worst, replace(worst, name="again"))), USUAL)
    runs = {1: (1.0, 5.0), 2: (5.0, 1.0)}
    for seed, scores in runs.items():
        ranking.add(one_run(1, seed, x, name) for name, x in zip(("S1", "S2"), scores, strict=True))
    (member,) = ranking.front()
    assert member.solution.judgement.amounts == (5.0, 5.0)


def test_intervals_of_quantiles_are_exact() -> None:
    random, usual = np.random.default_rng(1), NormalDist().inv_cdf(0.9)
    ends = [interval(random.normal(size=40).tolist(), 0.9, CONFIDENCE) for _ in range(400)]
    covered = sum(lower is not None and upper is not None and lower <= usual <= upper for lower, upper in ends)
    assert 0.94 <= covered / 400 < 1
    assert interval([1.0, 2.0, 3.0, 4.0], 0.9, CONFIDENCE) == (2.0, None)
    assert interval([float(value) for value in range(36)], 0.9, CONFIDENCE)[1] == 35.0


def test_a_quantile_prefers_a_set_whose_runs_are_alike() -> None:
    random = np.random.default_rng(2)
    runs = {1: 4.5 + random.normal(size=12), 2: 5.0 + 0.1 * random.normal(size=12), 3: np.array([4.9])}
    wanted = USUAL, ReplicatesSpecification(aggregate=Quantile(quantile=0.9))
    rankings = [ranked(runs, COST, each).best_first() for each in wanted]
    assert [[each.parameter_set for each in sets] for sets in rankings] == [[1, 2, 3], [2, 1, 3]]
    assert rankings[1][0].objective == sorted(runs[2])[10]  # the least value that nine of ten runs do not exceed


def test_equal_scores_of_ratings_that_differ_do_not_say_that_there_is_no_noise() -> None:
    for step in (0.1, 0.0):
        ranking = by_score({"S1": 1}, wanted=USUAL)
        for number in range(6):
            seeds = range(1, 3 if number < 5 or not step else 2)
            ranking.add(replace(one_run(number, seed, 6.0), rating=6.0 + step * seed) for seed in seeds)
        assert bool(next_runs(ranking, USUAL, 8, 100)) == (step > 0)


@pytest.mark.parametrize("budget", [8, 15])
def test_sets_that_change_alike_get_more_runs_and_the_best_one_has_a_report(budget: int) -> None:
    """Equal losses by seed are no proof that sets are equal; single runs of other sets were as good, with a better rating."""
    ranking, chosen, spent = by_score({"S1": 1}, wanted=USUAL), [(number, 1) for number in range(30)], -30
    while chosen:
        scores = [(number, seed, 6.5 - seed % 3 / 6 - (number >= 20)) for number, seed in chosen]
        ranking.add(replace(one_run(number, seed, x), rating=x + 0.01 * number) for number, seed, x in scores)
        spent += len(chosen)
        chosen = next_runs(ranking, USUAL, 2, budget - spent)
    assert spent == budget
    assert ranking.best_first()[0].chosen_by is not None
    assert ranking.best_first()[0].bound is not None  # the noise is known


@pytest.mark.parametrize("budget", range(3, 10))
def test_the_best_set_of_a_small_budget_is_the_one_that_is_reported(budget: int) -> None:
    random = np.random.default_rng(budget)
    for _ in range(20):
        ranking, chosen, left = by_score({"S1": 1}, wanted=USUAL), [(number, 1) for number in range(30)], budget + 30
        while chosen:
            left -= len(chosen)
            ranking.add([one_run(number, seed, float(random.normal())) for number, seed in chosen])
            chosen = next_runs(ranking, USUAL, 2, left)
        assert present(ranking.best())[0].chosen_by is not None


def test_a_seed_is_tried_only_if_all_scenarios_of_the_ranking_ran() -> None:
    """S3 belongs to another variant, and a search by the cell may run a further seed in some scenarios only."""
    ranking = by_score({"S1": 1, "S2": 1}, wanted=USUAL)
    for number, (scenario, last) in product((1, 2), {"S1": 6, "S2": 2, "S3": USUAL.most}.items()):
        ranking.add(one_run(number, seed, 5.0 + (seed * number % 3) / 10, scenario) for seed in range(1, last + 1))
    assert set(next_runs(ranking, USUAL, 8, 100)) >= {(1, 3), (2, 3)}


def test_intervals_are_those_of_a_ranking_that_takes_all_answers_at_once() -> None:
    """Set 2 leads until it has further runs; set 1, which leads then, has none that report it."""
    random = np.random.default_rng(1)

    def cells(numbers: Iterable[int], seeds: range, mean: float) -> list[CellScore]:
        return [one_run(number, seed, mean + 0.1 * random.normal()) for number in numbers for seed in seeds]

    first = cells([1], range(1, 5), 5.2) + cells([2], range(1, 5), 5.35) + cells(range(3, 33), range(1, 5), 4.0)
    later = cells([2], range(5, 13), 4.8) + cells(range(3, 13), range(5, 13), 4.0)
    grown, whole = (by_score({"S1": 1}, wanted=USUAL) for _ in range(2))
    grown.add(first)
    assert grown.best_first()[0].parameter_set == 2
    grown.add(later)
    whole.add(first + later)
    assert [(row.lower, row.upper) for row in grown.best_first()] == [(row.lower, row.upper) for row in whole.best_first()]


def test_a_set_that_lost_its_value_to_a_failed_run_tells_nothing_of_others() -> None:
    goals = Goals((Objective("gap", GAP, {"S1": 1.0}, Aggregate(), 1),))
    cells = [one_run(1, seed, 1.0, values={GAP.key: float(seed)}) for seed in range(1, 5)]
    cells += [one_run(number, 1, 1.0, values={GAP.key: 0.0}) for number in range(2, 8)]
    ranking = Ranking({"S1": 1}, goals, USUAL)
    ranking.add(cells)
    ranking.add([replace(cells[0], seed=5, failed=True, values={})])
    assert ranking.best_first()
    assert ranking.close() == 0


def test_a_report_with_a_failed_run_keeps_its_set_and_counts_the_failure() -> None:
    goals = Goals((Objective("gap", GAP, {"S1": 1.0}, Aggregate(), 1),))
    first = choosing(USUAL.most) + 1
    cells = [one_run(1, seed, 1.0, values={GAP.key: float(seed % 3)}) for seed in (*range(1, 4), *range(first, first + 5))]
    ranking = Ranking({"S1": 1}, goals, USUAL)
    ranking.add([*cells[:-1], replace(cells[-1], score=None, rating=None, failed=True, values={})])
    (best,) = ranking.best_first()
    assert (best.failures, best.replicates, ranking.failed_runs(1)) == (1, 7, (1, 5))
    assert best.objective == np.mean([seed % 3 for seed in range(first, first + 4)])


def test_reports_with_equal_scores_have_an_interval() -> None:
    scores = 6.0 + np.random.default_rng(1).integers(-1, 2, (2, 20)) / 6
    scores[:, 12:] = 6.0
    assert 5.8 < (ranked(dict(enumerate(scores))).best_first()[0].lower or 0.0) < 5.97


def test_a_lucky_single_run_counts_less_than_many_good_ones() -> None:
    samples = 5.0 + 0.5 * np.random.default_rng(3).normal(size=(40, 8))
    samples[0] += 0.8
    samples[1:5, 4:] = samples[5:, 1:] = np.nan
    samples[38, 0], samples[39, 0] = 1.0, 6.5
    known = assess(samples)
    assert known.best(CONFIDENCE) == 0
    assert known.means[39] < 5.5
    assert known.means[38] < 3.0, "it is bad, not unlucky"


def test_the_luck_of_sets_that_got_a_second_run_for_it_is_no_effect_of_a_seed() -> None:
    noises, random = [], np.random.default_rng(4)
    for _ in range(100):
        samples = random.normal(size=(30, 1)) + random.normal(size=2) + random.normal(size=(30, 2))
        samples[np.argsort(-samples[:, 0])[4:], 1] = np.nan
        noises.append(present(assess(samples).noise))
    assert np.mean(noises) == pytest.approx(1.0, abs=0.15)  # 0.72 by the differences of these sets alone


def test_failures_of_sets_that_are_alike_are_no_effect_of_a_seed() -> None:
    samples = np.full((12, 2), np.nan)
    samples[:, 0] = -30.0 - 0.01 * np.arange(12)
    samples[:4, 1] = samples[:4, 0] - 20.0
    assert assess(samples, failed=samples < -40.0).probabilities.max() < 0.5


def test_no_single_run_is_sure() -> None:
    others = [[1.0 - place / 100, 1.0 - place / 90] for place in range(6)]
    assert allocate(assess(np.array([[5.0, np.nan], *others])), 8, 20, CONFIDENCE) == [0]


@pytest.mark.parametrize("quantile", [0.0, 1.0])
def test_an_extreme_over_seeds_is_refused(quantile: float) -> None:
    with pytest.raises(ValidationError, match="quantile"):
        ReplicatesSpecification(aggregate=Quantile(quantile=quantile))


@pytest.mark.parametrize("failing", [False, True])
@pytest.mark.parametrize(("gap", "reported", "close"), [(2.0, True, False), (0.01, True, True), (2.0, False, True)])
def test_the_seeds_that_report_both_tell_a_set_from_the_best(gap: float, reported: bool, close: bool, failing: bool) -> None:
    """Whatever failures make of the noise of other sets."""
    ranking = by_score({"S1": 1}, COMFORT, ReplicatesSpecification(most=20))
    noise = np.random.Generator(np.random.PCG64(1)).normal(size=(3, 21))  # the last row is common to both
    for place, seeds in ((0, (1, 2, 3, 4, 13, 14, 15)), (1, (1, 13, 14, 15) if reported else (1,))):
        scores = {seed: float(5 - gap * place + 0.2 * noise[place, seed] + noise[2, seed]) for seed in seeds}
        ranking.add(one_run(place, seed, score) for seed, score in scores.items())
    for place, seed in product((2, 3), range(1, 13)) if failing else ():
        worth = float(noise[2, seed] - 20 * (seed % 3 == 0))
        ranking.add([one_run(place, seed, worth, failed=seed % 3 == 0)])
    gain, is_close = ranking.gain_over(1, random=True)
    assert (gain is not None, is_close) == (reported, close)
    assert ranking.gain_over(0, random=True) == (None, False)


def test_ids_of_sets_in_the_database_decide_nothing() -> None:
    scores = np.random.default_rng(4).normal(size=(12, 3)).round(1)
    rankings = [by_score({"S1": 1}, COMFORT, ReplicatesSpecification(most=20)) for _ in range(2)]
    for ranking, first, step in zip(rankings, (1, 99), (1, -1), strict=True):
        for place, seed in product(range(12), range(1, 4)):
            run = replace(one_run(place, seed, float(scores[place, seed - 1])), parameter_set=first + step * place)
            ranking.add([run])
    (rising, one), (falling, other) = (present(ranking.statistics()) for ranking in rankings)
    assert [number - 1 for number in rising] == [99 - number for number in falling] == list(range(12))
    np.testing.assert_array_equal(one.means, other.means)
    assert rankings[0].noise() == rankings[1].noise()


@pytest.mark.parametrize("gain", [1.0, -1.0])
def test_failures_that_only_one_of_two_sets_met_leave_open_which_is_better(gain: float) -> None:
    """The best set was chosen under the first seed."""
    ranking = by_score({"S1": 1}, COMFORT, ReplicatesSpecification(most=20))
    for place, seeds in ((0, (1, 13, 14, 15, 16)), (1, (1, 13, 14, 15))):
        ranking.add(one_run(place, seed, 5.0 - place * (gain if seed > 1 else 2.0) + seed / 64) for seed in seeds)
    assert ranking.gain_over(1, random=True) == (gain, False)
    ranking.add([one_run(0, 17, 1.0, failed=True)])
    assert ranking.gain_over(1, random=True) == (gain, True)


RATE = Bound("gap", CellValue(measure="gap", failed=-1.0), {"S1": 1.0}, Aggregate("min"), 1, 0.0, 1.0, rate=0.1, confidence=0.9)
"""At most a tenth of the runs has a gap below 0: 22 runs without one show it."""


@pytest.mark.parametrize("failing", [range(18, 21), range(14, 21), range(13, 21)])
def test_runs_without_what_a_constraint_bounds_count_for_the_reported_objective(failing: range) -> None:
    scale = Scale("score", Direction.MAXIMISE, -10, 10, 0.0, -10, None, "1")
    gap = replace(RATE, rate=None, value=CellValue(measure="gap"))
    goals = Goals((Objective("score", CellValue(scale), {"S1": 1.0}, Aggregate(), 1),), (gap,))
    ranking = Ranking({"S1": 1}, goals, USUAL)
    for seed in (1, 2, 3, *range(13, 21)):
        score, values = (-10.0, {}) if seed in failing else (5.0 + seed % 2 / 10, {gap.value.key: 1.0})
        ranking.add([one_run(1, seed, score, values=values, failed=seed in failing)])
    best = (ranking.best() or [None])[0]
    assert (best is None) == (len(failing) == 8)
    if best is not None:
        assert (best.seeds, best.violation, best.failures) == (tuple(range(13, 21)), 0.0, len(failing))
        assert best.objective == pytest.approx(
            np.mean([-10.0 if seed in failing else 5 + seed % 2 / 10 for seed in best.seeds])
        )


def rated(most: int, fails: dict[int, int], sets: int = 3, budget: int = 1000, scatter: float = 0.1) -> Ranking:
    """Sets, the first the best. `fails`: each how many seeds one run of a set has a gap below 0."""
    scale = Scale("score", Direction.MAXIMISE, -10, 10, 0.0, -10, None, "1")
    goals = Goals((Objective("score", CellValue(scale), {"S1": 1.0}, Aggregate(), 1),), (RATE,))
    wanted = ReplicatesSpecification(most=most)
    ranking = Ranking({"S1": 1}, goals=goals, wanted=wanted)
    chosen = [(place, 1) for place in range(sets)]
    noise = np.random.Generator(np.random.PCG64(1)).normal(size=(sets, most)) * scatter
    while chosen:
        cells = []
        for place, seed in chosen:
            gap = -1.0 if place in fails and seed % fails[place] == 0 else 1.0
            score = float(noise[place, seed - 1] - place / 2 + gap / 4)
            cells.append(one_run(place, seed, score, values={RATE.value.key: gap}))
        ranking.add(cells)
        chosen = next_runs(ranking, wanted, 4, budget)
        budget -= len(chosen)
    return ranking


@pytest.mark.parametrize(
    ("beyond", "runs", "least", "most"), [(0, 22, 0.0, 0.0), (0, 21, 1e-4, 2e-4), (2, 10, 1e-4, UNDECIDED), (9, 10, 0.79, 0.81)]
)
def test_a_rate_is_kept_broken_or_undecided(beyond: int, runs: int, least: float, most: float) -> None:
    cells = [{"S1": one_run(1, seed, 1.0, values={RATE.value.key: -float(seed <= beyond)})} for seed in range(1, runs + 1)]
    judged = present(next(Goals((), (RATE,)).judge(cells[:1], [cells])))
    assert least <= judged.violation <= most
    assert judged.undecided == (0 < most <= UNDECIDED)
    assert judged.bounded == (beyond / runs, *rate_bounds(beyond, runs, 0.9))
    assert RATE.fewest_runs == 22
    assert exceeding(beyond, runs, rate_bounds(beyond, runs, 0.9)[1]) == pytest.approx(0.1)
    assert exceeding(0, 8, 0.08) < exceeding(5, 54, 0.08), "more runs with too many beyond are no nearer to it"


def test_bounds_of_a_rate_have_names_of_their_own() -> None:
    cells = {"S1": one_run(1, 1, 1.0, values={RATE.value.key: 1.0})}
    for bounds in permutations([replace(RATE, name="gap_lower", rate=None), RATE, RATE]):
        goals = Goals((), bounds)
        assert len(goals.named_bounds(present(next(goals.judge([cells]))))) == 7


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_bounds_of_rates_are_exact(counts: tuple[int, int]) -> None:
    bad, runs = counts
    expected = binomtest(bad, runs).proportion_ci(confidence_level=0.95, method="exact")
    assert rate_bounds(bad, runs) == pytest.approx((expected.low, expected.high), abs=1e-12)
    assert rate_bounds(0, 0) == (0.0, 1.0)
    assert rate_bounds(0, 299, 0.95) == pytest.approx((0.0, 1 - 0.05 ** (1 / 299)))


@pytest.mark.parametrize(("most", "fails", "best", "unsure"), [(40, {}, 0, False), (40, {0: 3}, 1, False), (20, {}, 0, True)])
def test_the_best_set_gets_the_runs_that_show_its_rate(most: int, fails: dict[int, int], best: int, unsure: bool) -> None:
    ranking = rated(most, fails)
    winner = ranking.best_first()[0]
    assert (winner.parameter_set, winner.violation > 0, winner.is_undecided) == (best, unsure, unsure)
    for place in fails:  # it can keep the rate no more, and gets no further runs
        assert max(ranking.seeds(place)) < 22


def test_sets_that_may_still_show_their_rates_may_be_as_good() -> None:
    ranking = rated(40, {}, sets=2, budget=80, scatter=1.0)
    assert not any(each.is_close for each in ranking.best_first())
    ranking.add([one_run(9, 1, 0.0, values={RATE.value.key: 1.0}), one_run(10, 1, -5.0, values={RATE.value.key: 1.0})])
    assert [each.parameter_set for each in ranking.best_first() if each.is_close] == [9]


def test_a_noisy_set_is_not_told_by_the_noise_of_others() -> None:
    """Three differences of a set with eight times the noise of others, all on one side by chance."""
    ranking = by_score({"S1": 1}, COMFORT, ReplicatesSpecification(most=20))
    scatter = 0.1 * np.random.default_rng(2).normal(size=(6, 12))
    for place in range(6):
        ranking.add(one_run(place + 2, seed, float(x) - 3) for seed, x in enumerate(scatter[place], start=1))
    for place, scores in ((0, (5.0, 5.0, 5.0)), (1, (4.95, 3.5, 4.9))):
        ranking.add(one_run(place, seed, score) for seed, score in zip((13, 14, 15), scores, strict=True))
        ranking.add([one_run(place, 1, 4.5)])
    gain, is_close = ranking.gain_over(1, random=True)
    assert (gain == pytest.approx(0.55), is_close) == (True, True)


def test_a_small_budget_decides_the_rate_of_one_set_before_it_tries_another() -> None:
    ranking = rated(40, {0: 2, 1: 3}, sets=12, budget=34, scatter=0.0)
    winner = ranking.best_first()[0]
    assert (winner.parameter_set, winner.is_undecided) == (2, False)
    assert [ranking.to_show(place) for place in range(4)] == [None, None, 0, 21 - (len(ranking.seeds(3)) - 1)]


def test_sets_of_a_front_get_further_runs_and_lucky_ones_leave_it() -> None:
    worst = Objective("worst", CellValue(COST), {"S1": 1.0}, Aggregate("max"), -1)
    other = Objective("gap", GAP, {"S1": 1.0}, Aggregate(), -1)
    ranking, left = Ranking({"S1": 1}, Goals((worst, other), (replace(RATE, rate=0.5, value=GAP),)), USUAL), 28
    truths, drawn = (
        {0: (1.0, 4.0), 1: (2.0, 2.0), 2: (4.0, 1.0), 3: (5.0, 5.0)},
        np.random.default_rng(1).normal(size=(4, 20, 2)),
    )
    chosen = [(number, 1) for number in truths]
    while chosen:
        left -= len(chosen)
        for number, seed in chosen:
            cost, gap = np.add(
                truths[number], [-4.0, 0.0] if (number, seed) == (3, 1) else 0.1 * drawn[number, seed - 1]
            ).tolist()
            ranking.add([one_run(number, seed, cost, values={GAP.key: gap})])
        chosen = next_runs(ranking, USUAL, 3, left)
    assert sorted(member.solution.parameter_set for member in ranking.front()) == [0, 1, 2]
    assert min(len(ranking.seeds(number)) for number in (0, 1, 2)) >= 5 > len(ranking.seeds(3)) >= 2
    assert max(max(ranking.seeds(number)) for number in truths) <= 12, "nothing reports a front"
