"""Whatever a predictor or an influence map does, the errors released stay below the limit in the mean, for each answer in a lot. All that a
useless predictor costs is its fits and its samples."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from tests.support.effort import tries
from tests.support.values import COST

from drivecal.analysis.replicates import rate_bounds
from drivecal.analysis.validation import error_rates
from drivecal.contracts.campaign import ErrorRate
from drivecal.domain.evaluations import AuditCount
from drivecal.reduction.assignment import expected_error_rate
from drivecal.reduction.forest import predictor_on
from drivecal.reduction.lots import SamplingPlan, best_plan, draw, outgoing_errors
from drivecal.reduction.prediction import Bools, Floats, Predictions, ScenarioLearner, choose_lot

REPLAYS = tries(50, 1000)
"""Replays of each sabotage."""
BATCHES, CELLS = 4, 60

Simulator = Callable[[Floats, int], Floats]
Guess = Callable[[Floats, np.random.Generator], Floats]


@dataclass(slots=True)
class Tally:
    """Counts of a scenario. `inspected`: predictions in lots; `different`: released ones off by more than the tolerance; `simulated`: runs,
    samples among them."""

    cells: int = 0
    simulated: int = 0
    released: int = 0
    different: int = 0
    lots: int = 0
    inspected: int = 0
    rejected: int = 0
    sampled: int = 0


def inspect(learner: ScenarioLearner, features: Floats, scores: Floats, ratings: Floats, limit: float, secret: bytes) -> Tally:
    """Answers a batch, n sets with features of shape (n, k); the learner then learns what was simulated."""
    tally = Tally(cells=len(scores), simulated=len(scores))
    told = learner.predict(features)
    if told is None:
        learner.learn(features, scores, ratings)
        return tally
    predictions, error_rates = told
    lot = choose_lot(error_rates, limit)
    wrong = learner.is_wrong(predictions.scores, scores)
    simulated, weight = np.arange(len(scores)), np.ones(len(scores))
    if lot is not None:
        sampled = lot.members[draw([int(member).to_bytes(8) for member in lot.members], lot.plan.sample, secret)]
        tally.lots, tally.inspected, tally.sampled = 1, lot.plan.size, len(sampled)
        if lot.plan.releases(int(wrong[sampled].sum())):
            released = np.setdiff1d(lot.members, sampled)
            tally.released, tally.different = len(released), int(wrong[released].sum())
            simulated, weight[sampled] = np.setdiff1d(simulated, released), lot.plan.size / lot.plan.sample
        else:
            tally.rejected = 1
    tally.simulated = len(simulated)
    learner.learn(features[simulated], scores[simulated], ratings[simulated])
    seen = predictions.scores[simulated], predictions.confidence[simulated]
    learner.observe(*seen, scores[simulated], weight[simulated])
    return tally


def plan_of_references(size: int, limit: float, known: ErrorRate) -> SamplingPlan:
    """The plan of a lot of references, as campaigns choose it."""
    return best_plan(size, limit, expected_error_rate(known))


def inspect_references(wrong: Bools, limit: float, known: ErrorRate, secret: bytes) -> tuple[Tally, ErrorRate]:
    """Inspects a lot of references, some of them `wrong`, and adds its sample to the audits `known`."""
    plan = plan_of_references(len(wrong), limit, known)
    sampled = draw([place.to_bytes(8) for place in range(len(wrong))], plan.sample, secret)
    errors = int(wrong[sampled].sum())
    tally = Tally(cells=len(wrong), simulated=len(wrong), lots=1, inspected=len(wrong), sampled=plan.sample)
    if plan.releases(errors):
        tally.released = tally.cells - plan.sample
        tally.simulated, tally.different = plan.sample, int(wrong.sum()) - errors
    else:
        tally.rejected = 1
    seen = {"audited": known.audited + plan.sample, "wrong": known.wrong + errors, "lots": known.lots + 1}
    return tally, known.model_copy(update=seen)


@dataclass
class Sabotaged:
    """Predicts the scores that `guess` gives for features, and claims to be certain and never wrong."""

    guess: Guess
    generator: np.random.Generator
    fits: list[int]

    def fit(self, features: Floats, scores: Floats, ratings: Floats) -> None:
        del features, ratings
        self.fits.append(len(scores))

    def known_errors(self) -> tuple[Floats, Bools]:
        return np.ones(500), np.zeros(500, dtype=np.bool_)

    def weights(self, features: Floats) -> Floats:
        return np.empty(len(features))

    def predict(self, features: Floats) -> Predictions:
        scores, certain = self.guess(features, self.generator), np.ones(len(features))
        return Predictions(scores, scores, certain, scores, np.zeros(len(features)))


def constant(features: Floats, _: object) -> Floats:
    return np.full(len(features), 3.0)


def random(features: Floats, generator: np.random.Generator) -> Floats:
    return generator.integers(0, 8, len(features)).astype(np.float64)


def over_confident(features: Floats, generator: np.random.Generator) -> Floats:
    """Wrong by two points in a share of the cells that drifts from batch to batch."""
    share = generator.choice([0.02, 0.05, 0.1, 0.2, 0.4])
    scores: Floats = true_scores(features) + 2.0 * (generator.random(len(features)) < share)
    return scores


def right(features: Floats, _: object) -> Floats:
    """Right as long as the simulator does not change its mind."""
    return true_scores(features)


def true_scores(features: Floats, _: int = 0) -> Floats:
    scores: Floats = np.floor(features[:, 0] * 8.0)
    return scores


def mostly_three(features: Floats, _: int) -> Floats:
    """All but every twelfth set have the score that the constant predictor names: few enough errors for most samples to miss."""
    scores: Floats = np.where(features[:, 0] < 1 / 12, 5.0, 3.0)
    return scores


def changed(features: Floats, batch: int) -> Floats:
    """Changes the score of a seventh of the sets in the second half of the batches."""
    scores: Floats = true_scores(features) + 2.0 * (batch >= BATCHES // 2) * (features[:, 1] < 1 / 7)
    return scores


def changed_within_a_batch(features: Floats, batch: int) -> Floats:
    """From the middle of the second batch on, and so in the middle of its lot, a fifth of the sets has another score."""
    place = batch * CELLS + np.arange(len(features))
    scores: Floats = true_scores(features) + 2.0 * (place >= 1.5 * CELLS) * (features[:, 1] < 1 / 5)
    return scores


def replay(guess: Guess, simulator: Simulator, tolerance: float, limit: float, number: int) -> tuple[list[Tally], int]:
    """Returns the batches of a scenario that begins with 100 known sets, and the number of fits."""
    generator, fits = np.random.default_rng([5, number]), list[int]()
    learner = ScenarioLearner(lambda: Sabotaged(guess, generator, fits), tolerance)
    first = generator.random((100, 2))
    learner.learn(first, true_scores(first), np.zeros(100))
    tallies = []
    for batch in range(BATCHES):
        features, secret = generator.random((CELLS, 2)), number.to_bytes(4) + batch.to_bytes(4)
        tallies.append(inspect(learner, features, simulator(features, batch), np.zeros(CELLS), limit, secret))
    return tallies, len(fits)


@pytest.mark.parametrize(("tolerance", "limit"), [(0.0, 0.05), (1.0, 0.01)])
@pytest.mark.parametrize(
    ("guess", "simulator", "useless"),
    [
        (constant, true_scores, True),
        (constant, mostly_three, False),
        (random, true_scores, True),
        (over_confident, true_scores, False),
        (right, changed, False),
        (right, changed_within_a_batch, False),
    ],
)
def test_replays_of_a_sabotaged_predictor_release_few_errors(
    guess: Guess, simulator: Simulator, useless: bool, tolerance: float, limit: float
) -> None:
    excesses: list[float] = []
    released = different = lots = 0
    for number in range(REPLAYS):
        tallies, fits = replay(guess, simulator, tolerance, limit, number)
        asked = [tally for tally in tallies if tally.lots]
        excesses.append(sum(tally.different - limit * tally.inspected for tally in asked))
        released += sum(tally.released for tally in asked)
        different += sum(tally.different for tally in asked)
        lots += len(asked)
        # the fits and the samples are all that it costs: no cell is simulated twice, and a batch takes at most one fit and one lot
        assert fits <= BATCHES
        assert all(tally.simulated == tally.cells - tally.released for tally in tallies)
        assert all(tally.sampled <= tally.simulated for tally in tallies)
    assert lots >= REPLAYS, "without a lot in every replay nothing was tried"
    assert np.mean(excesses) <= 3.0 * np.std(excesses) / np.sqrt(REPLAYS)
    assert (released == 0) == useless
    assert (different == 0) == useless, "a sabotage without an error shows nothing"
    if useless:
        assert lots <= 1.1 * REPLAYS, "a rejected lot is lesson enough"


@pytest.mark.slow
@pytest.mark.parametrize("limit", [0.05, 0.02])
def test_predictions_of_continuous_scores_are_released_and_keep_the_limit(limit: float) -> None:
    """A cost with a cliff, searched in a region that moves from batch to batch."""
    shares: list[float] = []
    released = cells = 0
    for number in range(8):
        generator = np.random.default_rng(number)
        learner = ScenarioLearner(predictor_on(COST, COST.tolerance), COST.tolerance)
        centre = generator.random(3)
        for batch in range(6):
            features = (
                generator.random((200, 3)) if batch < 2 else np.clip(centre + 0.4 * (generator.random((200, 3)) - 0.5), 0, 1)
            )
            costs = 40.0 * np.abs(features[:, 0] - 0.4) + 20.0 * features[:, 1] ** 2 + 10.0
            costs[features[:, 0] + features[:, 1] > 1.7] = COST.failed
            tally = inspect(learner, features, costs, costs, limit, number.to_bytes(4) + batch.to_bytes(4))
            released, cells = released + tally.released, cells + tally.cells
            if tally.inspected:
                shares.append(tally.different / tally.inspected)
    assert released > 0.2 * cells
    assert np.mean(shares) <= limit + 3.0 * np.std(shares) / np.sqrt(len(shares))


Adversary = Callable[[int, int, float, ErrorRate, "list[Tally]"], int]
"""Number of wrong references in a lot: of a batch, of a size, under a limit, after these audits and verdicts."""


def wholly_wrong(batch: int, size: int, limit: float, known: ErrorRate, verdicts: list[Tally]) -> int:
    del batch, limit, known, verdicts
    return size


def careful(batch: int, size: int, limit: float, known: ErrorRate, verdicts: list[Tally]) -> int:
    """As many as pass best, of all that know the plan: the worst case of every lot."""
    del batch, verdicts
    return int(np.argmax(outgoing_errors(plan_of_references(size, limit, known))))


def greedy(batch: int, size: int, limit: float, known: ErrorRate, verdicts: list[Tally]) -> int:
    """More after each release, and none after a rejection, until the audits look well again."""
    del batch, limit
    if verdicts and verdicts[-1].rejected:
        return 0
    return min(size, 1 + size * sum(tally.released > 0 for tally in verdicts) // 40 + known.lots % 2)


@pytest.mark.parametrize("limit", [0.02, 0.05])
@pytest.mark.parametrize("adversary", [wholly_wrong, careful, greedy])
def test_replays_of_a_sabotaged_map_release_few_wrong_references(adversary: Adversary, limit: float) -> None:
    excesses: list[float] = []
    released = different = 0
    for number in range(REPLAYS):
        generator, known, tallies = np.random.default_rng([7, number]), ErrorRate(), list[Tally]()
        for batch in range(8):
            size = int(generator.integers(10, 160))
            wrong = np.zeros(size, dtype=np.bool_)
            wrong[generator.permutation(size)[: adversary(batch, size, limit, known, tallies)]] = True
            tally, known = inspect_references(wrong, limit, known, number.to_bytes(4) + batch.to_bytes(4))
            tallies.append(tally)
        excesses.append(sum(tally.different - limit * tally.inspected for tally in tallies))
        released += sum(tally.released for tally in tallies)
        different += sum(tally.different for tally in tallies)
        assert all(tally.simulated == tally.cells - tally.released for tally in tallies)
    assert np.mean(excesses) <= 3.0 * np.std(excesses) / np.sqrt(REPLAYS)
    assert (released == 0) == (different == 0) == (adversary is wholly_wrong), "a sabotage without an error shows nothing"


def test_a_wrong_sample_stops_no_map_for_good() -> None:
    """A rejected lot raises what is expected of references; right ones lower it again, and are released."""
    known = ErrorRate()
    first, known = inspect_references(np.arange(60) < 30, 0.02, known, b"first")
    assert first.rejected
    released = 0
    for batch in range(10):
        tally, known = inspect_references(np.zeros(60, dtype=np.bool_), 0.02, known, batch.to_bytes(4))
        released += tally.released
    assert released > 300


def test_before_the_first_audit_nothing_is_known() -> None:
    assert error_rates([], ["S1"]) == {"S1": ErrorRate()}


def test_wrong_answers_are_counted() -> None:
    rate = error_rates([AuditCount("S1", audited=25, different=9, wrong=5)], ["S1"])["S1"]
    assert (rate.audited, rate.different, rate.wrong) == (25, 9, 5)
    assert rate.upper_95 is not None
    assert rate.upper_95 > 0.2


def test_audits_say_what_to_expect_of_a_reference() -> None:
    expected = [expected_error_rate(rate) for rate in (None, ErrorRate(audited=1, wrong=1), ErrorRate(audited=200, wrong=0))]
    assert expected[2] < expected[0] < 0.02 < expected[1] < 0.05, "one wrong audit says little"
    assert expected_error_rate(ErrorRate(audited=40, wrong=40)) > 0.4


def test_contradictions_and_lots_stand_beside_the_audits() -> None:
    lots = {"S1": {"lots": 3, "inspected": 90, "sampled": 40}, "S3": {"lots": 4, "rejected": 1}}
    rates = error_rates([AuditCount("S1", 10, 0, 0)], ["S1", "S2", "S3"], {"S2": 7}, lots)
    assert [rates[name].contradictions for name in ("S1", "S2", "S3")] == [0, 7, 0]
    counts = [(rate.lots, rate.inspected, rate.sampled, rate.rejected) for rate in rates.values()]
    assert counts == [(3, 90, 40, 0), (0, 0, 0, 0), (4, 0, 0, 1)]


def test_lots_have_the_limit_of_what_they_released_and_no_interval_over_unlike_samples() -> None:
    counts = [AuditCount(name, 278, 2, 2) for name in ("S1", "S2", "S3")]
    lots = {"S1": {"lots": 21}, "S2": {"lots": 1, "rejected": 1}, "S3": {}}
    rates = error_rates(counts, lots, lots=lots, released={"S1": 0.08})
    assert (rates["S1"].upper_95, rates["S2"].upper_95) == (0.08, None)
    assert rates["S3"].upper_95 == rate_bounds(2, 278)[1]
