"""The processes of the surrogate search, against scikit-learn's."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Matern

from drivecal.optimizers.surrogate.gaussian_process import SAMPLED, Encoding, GaussianProcess, Hyperparameters, Points, fitted
from drivecal.optimizers.surrogate.models import FEWEST, MOST, ScenarioModel, Warp
from drivecal.plugins.ports import Floats

NONE = Points(np.empty((0, 6)), np.empty(0, dtype=np.int64))
ENCODING = Encoding(np.array([101, 51, 4], dtype=np.int64), ("grid", "integer", "choice"))


def drawn(count: int, seed: int) -> tuple[Floats, Floats]:
    """Returns features and targets of mean 0."""
    generator = np.random.default_rng(seed)
    features = ENCODING(generator.integers(0, [101, 51, 4], size=(count, 3)))
    targets = np.sin(5 * features[:, 0]) + features[:, 1] ** 2 + features[:, 2]
    return features, targets - targets.mean()


class Seeded(Matern):  # type: ignore[misc]  # scikit-learn ships no types
    """The covariance of answers whose seeds are the last column."""

    def __init__(self, length_scale: Floats, luck: float) -> None:
        super().__init__(length_scale, nu=2.5)
        self.luck = luck

    def __call__(self, X: Floats, Y: Floats | None = None) -> Floats:  # noqa: N803  # its names
        others = X if Y is None else Y
        alike = (X[:, -1:] == others[:, -1]) & (X[:, -1:] > 1)
        result: Floats = super().__call__(X[:, :-1], others[:, :-1]) + self.luck * alike
        return result


@settings(max_examples=20, deadline=None)
@given(
    count=st.integers(3, 60),
    seed=st.integers(0, 99),
    lengths=st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3),
    noise=st.floats(-9, -2),
    luck=st.none() | st.floats(-5, 1),
)
def test_means_and_deviations_are_those_of_scikit_learn(
    count: int, seed: int, lengths: list[float], noise: float, luck: float | None
) -> None:
    features, targets = drawn(count, seed)
    seeds = np.random.default_rng(seed).integers(1, 4, count)
    tuned = Hyperparameters(np.array(lengths), noise, luck)
    process = GaussianProcess(Points(features, seeds), targets, ENCODING.owners, tuned, NONE)
    kernel = Seeded(np.exp(lengths)[ENCODING.owners], 0.0 if luck is None else np.exp(luck))
    oracle = GaussianProcessRegressor(kernel, alpha=np.exp(noise) + 1e-8, optimizer=None)
    oracle.fit(np.column_stack([features, seeds]), targets)
    others, _ = drawn(20, seed + 1)
    means, deviations = process.predict(others, pending=False)
    unknown = np.column_stack([others, np.full(20, -1)])  # without luck
    expected_means, expected_deviations = oracle.predict(unknown, return_std=True)  # of the diagonal of a Matérn kernel, 1
    np.testing.assert_allclose(means, expected_means, atol=1e-5)
    np.testing.assert_allclose(deviations, np.sqrt(process.variance) * expected_deviations, atol=2e-4)


def under(features: Floats, seed: int = 1) -> Points:
    """Returns points under one seed."""
    return Points(features, np.full(len(features), seed))


def test_fitted_lengths_tell_what_matters() -> None:
    features, _ = drawn(60, 1)
    targets = np.sin(6 * features[:, 0])
    tuned = fitted(under(features), targets - targets.mean(), ENCODING.owners, Hyperparameters.usual(3))
    assert tuned.lengths[0] < min(tuned.lengths[1:]) - 1
    assert tuned.noise < -6


@pytest.mark.parametrize(("common", "alone"), [(0.5, 0.0), (0.0, 0.5)])
def test_fitted_variances_tell_the_luck_of_all_sets_from_that_of_one(common: float, alone: float) -> None:
    generator, (features, targets) = np.random.default_rng(1), drawn(60, 1)
    points = under(features).followed_by(under(features, 2))
    targets = np.tile(targets, 2) + np.repeat([common, -common], 60) + alone * generator.normal(size=120)
    tuned = fitted(points, targets - targets.mean(), ENCODING.owners, Hyperparameters.usual(3, SAMPLED), SAMPLED)
    assert tuned.luck is not None
    assert (tuned.luck > tuned.noise) == (common > alone)


def test_pending_points_shrink_the_deviation_and_not_the_mean() -> None:
    features, targets = drawn(10, 1)
    pending, _ = drawn(3, 2)
    process = GaussianProcess(under(features), targets, ENCODING.owners, Hyperparameters.usual(3), under(pending))
    means, surer = process.predict(pending, pending=True)
    same, deviations = process.predict(pending, pending=False)
    np.testing.assert_allclose(means, same, rtol=1e-9)
    assert (surer < deviations / 2).all()


@given(
    values=st.lists(st.floats(0.01, 1e3), min_size=1, max_size=30), best=st.sampled_from([0.0, 2e3, np.inf, -np.inf, np.nan])
)
def test_a_warp_is_inverted(values: list[float], best: float) -> None:
    numbers = np.array(values)
    warp = Warp.chosen(numbers, best)
    np.testing.assert_allclose(warp.undone(warp(numbers)), numbers, rtol=1e-9, atol=1e-9)


def test_skewed_costs_are_warped_and_others_are_not() -> None:
    generator = np.random.default_rng(1)
    assert Warp.chosen(np.exp(generator.normal(size=50)), 0.0).sign == 1.0
    assert Warp.chosen(5 + generator.normal(size=50), -np.inf).sign == 0.0


def scenario_model() -> ScenarioModel:
    """Returns a model of one value, a cost."""
    return ScenarioModel(1, 3, ENCODING.owners, np.array([0.0]), np.array([100.0]))


@pytest.mark.parametrize(("best", "worst"), [(0.0, 1e15), (-np.inf, 1e15), (np.nan, 1e9)])
def test_values_far_beyond_all_others_hide_no_differences_of_these(best: float, worst: float) -> None:
    model = ScenarioModel(1, 3, ENCODING.owners, np.array([best]), np.array([np.inf]))
    features, targets = drawn(80, 3)
    values = 5 + targets + np.where(features[:, 0] > 0.6, worst * features[:, 0], 0.0)
    model.learn(under(features), values[:, np.newaxis], np.zeros(80, dtype=np.bool_), NONE)
    others, truth = drawn(200, 4)
    near = others[:, 0] < 0.5
    predicted = model.predict(others[near], pending=False).means[:, 0]
    assert np.corrcoef(predicted, truth[near])[0, 1] > 0.55


def test_the_noise_of_a_random_simulator_is_estimated() -> None:
    generator, (features, targets) = np.random.default_rng(3), drawn(60, 1)
    points, means = under(features).followed_by(under(features[:30], 2)), 10 + np.append(targets, targets[:30])[:, np.newaxis]
    for noise in (0.1, 0.5):
        model = ScenarioModel(1, 3, ENCODING.owners, np.array([-np.inf]), np.array([100.0]), random=True)
        model.learn(points, means + noise * generator.normal(size=(90, 1)), np.zeros(90, dtype=np.bool_), NONE)
        runs = model.runs(features[:1], generator.normal(size=(500, 1, 1)), np.ones((500, 1)))
        assert runs.std() == pytest.approx(noise, rel=0.5)
        assert abs(model.expected(points.features) - means).mean() < noise


def test_random_failures_count_by_their_share_which_is_drawn_where_it_is_unknown() -> None:
    features, failed = drawn(6, 1)[0], np.random.default_rng(1).random(240) < 0.25
    points = Points(np.repeat(features, 40, axis=0), np.tile(np.arange(40), 6))
    model = ScenarioModel(1, 3, ENCODING.owners, np.array([0.0]), np.array([100.0]), random=True)
    model.learn(points, np.where(failed, 100.0, 5.0)[:, np.newaxis], failed, NONE)
    assert model.expected(features).mean() == pytest.approx(5 + 0.25 * 95, abs=10)
    belief = model.predict(np.append(features, 1 - features, axis=0), pending=False)
    known, unknown = np.ptp(model.values(belief, np.zeros((1, 1, 1)), np.array([[0.02], [0.98]])), axis=0).reshape(2, 6)
    assert known.max() < 30 < unknown.min()


def test_failures_are_a_class_of_their_own() -> None:
    features, targets = drawn(80, 3)
    failed = features[:, 0] > 0.6
    values = np.where(failed, 100.0, 5 + targets)[:, np.newaxis]
    model = scenario_model()
    model.learn(under(features), values, failed, NONE)
    others, _ = drawn(200, 4)
    others = others[np.abs(others[:, 0] - 0.6) > 0.15]
    prediction = model.predict(others, pending=False)
    assert (prediction.failing[others[:, 0] > 0.6] > 0.7).all()
    assert (prediction.failing[others[:, 0] < 0.6] < 0.3).all()
    draws = model.values(prediction, np.zeros((1, 1, 1)), np.full((1, 1), 0.5))
    np.testing.assert_array_equal(draws[0, others[:, 0] > 0.6, 0], 100.0)
    assert draws[0, others[:, 0] < 0.6, 0].max() < 10


def test_sets_under_way_that_may_fail_count_as_failed_for_the_next_ones() -> None:
    features = drawn(40, 3)[0]
    failed = features[:, 0] > 0.6
    model, asked = scenario_model(), ENCODING(np.array([[50, 20, 1], [10, 20, 1]]))
    model.learn(under(features), np.where(failed, 100.0, 5.0)[:, np.newaxis], failed, under(asked))
    before, after = (model.predict(asked, pending=pending).failing for pending in (False, True))
    assert before[0] < 0.5 < after[0]
    assert after[1] < 0.3
    model.learn(under(features[failed]), np.full((failed.sum(), 1), 100.0), np.ones(failed.sum(), dtype=np.bool_), under(asked))
    before, after = (model.predict(asked, pending=pending).failing for pending in (False, True))
    assert (after > before).all()


def test_limited_measures_that_blow_up_to_either_side_hide_no_differences() -> None:
    model = ScenarioModel(1, 3, ENCODING.owners, np.array([np.nan]), np.array([np.nan]))
    features, targets = drawn(80, 3)
    values = targets + np.where(features[:, 0] > 0.8, 1e15, np.where(features[:, 0] < 0.2, -1e15, 0.0))
    model.learn(under(features), values[:, np.newaxis], np.zeros(80, dtype=np.bool_), NONE)
    others, truth = drawn(200, 4)
    near = np.abs(others[:, 0] - 0.5) < 0.2
    assert np.corrcoef(model.predict(others[near], pending=False).means[:, 0], truth[near])[0, 1] > 0.4


def test_rare_sound_answers_are_not_forgotten() -> None:
    features, failed = drawn(MOST + 120, 5)[0] / 20, np.ones(MOST + 120, dtype=np.bool_)
    features[:5], failed[:5] = 0.9 + features[:5], False
    model = scenario_model()
    model.learn(under(features), np.where(failed, 100.0, 6.0)[:, np.newaxis], failed, NONE)
    assert model.predict(features[:5], pending=False).failing.max() < 0.2


@pytest.mark.parametrize("count", [0, 1, FEWEST, MOST + 50])
def test_any_number_of_answers_is_learned(count: int) -> None:
    features, targets = drawn(count, 5) if count else (np.empty((0, len(ENCODING.owners))), np.empty(0))
    model = scenario_model()
    model.learn(under(features), 5 + targets[:, np.newaxis], np.zeros(count, dtype=np.bool_), NONE)
    prediction = model.predict(drawn(5, 6)[0], pending=True)
    assert np.isfinite([prediction.means, prediction.deviations]).all()


def test_saved_hyperparameters_are_restored() -> None:
    features, targets = drawn(30, 7)
    known = (under(features), 5 + targets[:, np.newaxis], np.zeros(30, dtype=np.bool_), NONE)
    model, other = scenario_model(), scenario_model()
    model.learn(*known)
    other.restore(model.to_json())
    other.learn(*known)
    points, _ = drawn(10, 8)
    np.testing.assert_array_equal(model.predict(points, pending=False).means, other.predict(points, pending=False).means)
