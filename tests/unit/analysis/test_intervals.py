"""The interval over base sets: coverage by simulation with alike variants, limits in closed form, invariance."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples, tries

from drivecal.analysis.validation import mean_interval

VARIANTS = 30
REPLAYS = tries(150, 300)


def drawn(rate: float, alike: float, bases: int, seed: int) -> npt.NDArray[np.float64]:
    """Shares of wrong variants by replay and base, shape (REPLAYS, bases): beta-binomial with the intraclass correlation `alike`."""
    generator = np.random.default_rng([seed, bases])
    spread = 1 / alike - 1
    rates = generator.beta(rate * spread, (1 - rate) * spread, (REPLAYS, bases))
    return generator.binomial(VARIANTS, rates) / VARIANTS


@pytest.mark.faults("60")
@pytest.mark.parametrize("bases", [20, 60])
@pytest.mark.parametrize("alike", [0.01, 0.14, 0.4])
@pytest.mark.parametrize("rate", [0.005, 0.05])
def test_the_interval_over_bases_covers_the_rate_at_least_as_often_as_it_says(rate: float, alike: float, bases: int) -> None:
    replays = drawn(rate, alike, bases, seed=1)
    assert np.mean([lower <= rate <= upper for lower, upper in map(mean_interval, replays)]) >= 0.95


@pytest.mark.parametrize("bases", [1, 20, 200, 20_000])
def test_without_an_error_the_upper_limit_follows_from_the_number_of_bases(bases: int) -> None:
    lower, upper = mean_interval(np.zeros(bases))
    assert lower == 0.0
    assert upper == pytest.approx(1 - 0.025 ** (1 / bases))
    assert mean_interval(np.ones(bases)) == pytest.approx((1 - upper, 1.0))


@settings(max_examples=examples(50), deadline=None)
@given(st.lists(st.floats(0, 1), min_size=1, max_size=60))
def test_the_interval_holds_the_mean_whatever_the_order_and_mirrors_with_its_shares(shares: list[float]) -> None:
    lower, upper = mean_interval(np.array(shares))
    assert 0.0 <= lower <= np.mean(shares) + 1e-9
    assert np.mean(shares) - 1e-9 <= upper <= 1.0
    assert mean_interval(np.array(sorted(shares))) == pytest.approx((lower, upper), abs=1e-9)
    assert mean_interval(1 - np.array(shares)) == pytest.approx((1 - upper, 1 - lower), abs=1e-9)


def test_no_base_leaves_everything_open_and_a_share_beyond_one_is_refused() -> None:
    assert mean_interval(np.empty(0)) == (0.0, 1.0)
    for share in (-0.1, 1.1, np.nan):
        with pytest.raises(ValueError, match="between 0 and 1"):
            mean_interval(np.array([0.5, share]))
