"""Whatever a predictor does, the errors released stay below the limit in the mean, for each prediction in a lot."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from tests.support.inspected import inspect
from tests.support.scales import COST

from drivecal.reduction.prediction import Bools, Floats, Predictions, ScenarioLearner
from drivecal.reduction.regression_forest import predictor_on

REPLAYS = 1000
BATCHES, CELLS = 4, 60


class Fake:
    """Claims to be certain and never wrong. Subclasses choose the scores."""

    def __init__(self, generator: np.random.Generator) -> None:
        self.generator = generator

    def fit(self, features: Floats, scores: Floats, ratings: Floats) -> None:
        del features, scores, ratings

    def known_errors(self) -> tuple[Floats, Bools]:
        return np.ones(500), np.zeros(500, dtype=np.bool_)

    def weights(self, features: Floats) -> Floats:
        return np.empty(len(features))

    def scores(self, features: Floats) -> Floats:
        """Constant."""
        return np.full(len(features), 3.0)

    def predict(self, features: Floats) -> Predictions:
        scores, certain = self.scores(features), np.ones(len(features))
        return Predictions(scores, scores, certain, scores, np.zeros(len(features)))


class Random(Fake):
    def scores(self, features: Floats) -> Floats:
        return self.generator.integers(0, 8, len(features)).astype(np.float64)


class OverConfident(Fake):
    """Wrong in a share of cells that drifts from replay to replay."""

    def scores(self, features: Floats) -> Floats:
        share = self.generator.choice([0.02, 0.05, 0.1, 0.2, 0.4])
        scores: Floats = true_scores(features, 0) + (self.generator.random(len(features)) < share)
        return scores


class Right(Fake):
    """Right as long as the simulator does not change its mind."""

    def scores(self, features: Floats) -> Floats:
        return true_scores(features, 0)


def true_scores(features: Floats, batch: int) -> Floats:
    del batch
    scores: Floats = np.floor(features[:, 0] * 8.0)
    return scores


def changed_in_the_middle(features: Floats, batch: int) -> Floats:
    """From the third batch on, a seventh of the sets has another score."""
    return true_scores(features, batch) + (batch >= BATCHES // 2) * (features[:, 1] < 1 / 7)


@pytest.mark.parametrize("limit", [0.05, 0.02])
@pytest.mark.parametrize(
    ("predictor", "simulator"),
    [(Fake, true_scores), (Random, true_scores), (OverConfident, true_scores), (Right, changed_in_the_middle)],
)
def test_a_thousand_replays_of_a_sabotaged_predictor_release_few_errors(
    predictor: type[Fake], simulator: Callable[[Floats, int], Floats], limit: float
) -> None:
    generator = np.random.default_rng(5)
    shares: list[float] = []
    released = 0
    for number in range(REPLAYS):
        learner = ScenarioLearner(lambda: predictor(generator), 0.0)
        first = generator.random((100, 2))
        learner.learn(first, simulator(first, 0), np.zeros(100))
        for batch in range(BATCHES):
            features = generator.random((CELLS, 2))
            tally = inspect(
                learner, features, simulator(features, batch), np.zeros(CELLS), limit, number.to_bytes(4) + batch.to_bytes(4)
            )
            released += tally.released
            if tally.inspected:
                shares.append(tally.different / tally.inspected)
    assert len(shares) >= REPLAYS, "every replay has a lot at the least, or nothing was tried"
    assert np.mean(shares) <= limit + 3.0 * np.std(shares) / np.sqrt(len(shares))
    assert (released > 0) == (predictor in {OverConfident, Right}), "hopeless ones are rejected"


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
