"""MiniRocket features: against the definition, and against aeon's transform."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples

from drivecal.highway.comfort import rocket
from drivecal.highway.comfort.reference import Manoeuvre
from drivecal.highway.comfort.regressions import Regression, shipped
from drivecal.highway.comfort.rocket import LENGTH
from drivecal.plugins.ports import Floats


def some_series(seed: int, length: int = LENGTH) -> rocket.Integers:
    """Six channels that drift, as a run's do; some of them at the largest value."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(0.0, 60.0, (6, length)), axis=1)
    return np.clip(np.rint(walk), -2047, 2047).astype(np.int32)


def ours(regression: Regression, series: rocket.Integers) -> Floats:
    names = ("dilations", "per_dilation", "n_channels", "channels", "biases")
    features: Floats = rocket.transform(series, rocket.KERNELS, *(getattr(regression, name) for name in names))
    return features


def naive(regression: Regression, series: rocket.Integers) -> Floats:
    """The definition, written out."""
    n = series.shape[1]
    features: list[float] = []
    places = np.concatenate([[0], np.cumsum(regression.n_channels)])
    combination = 0
    for d, dilation in enumerate(regression.dilations):
        wide = np.pad(series, ((0, 0), (4 * dilation, 4 * dilation)))
        for k, twos in enumerate(rocket.KERNELS):
            weights = np.full(9, -1)
            weights[twos] = 2
            used = regression.channels[places[combination] : places[combination + 1]]
            convolution = sum(
                weights[tap] * wide[used, tap * dilation : tap * dilation + n].sum(axis=0, dtype=np.int64) for tap in range(9)
            )
            assert isinstance(convolution, np.ndarray)
            selected = convolution[4 * dilation : n - 4 * dilation] if (d + k) % 2 else convolution
            for _ in range(regression.per_dilation[d]):
                features.append(float((selected > regression.biases[len(features)]).mean()))
            combination += 1
    return np.array(features)


@pytest.mark.parametrize("manoeuvre", list(Manoeuvre))
@settings(max_examples=examples(5), deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_features_are_those_of_the_definition(manoeuvre: Manoeuvre, seed: int) -> None:
    series = some_series(seed)
    np.testing.assert_array_equal(ours(shipped()[manoeuvre], series), naive(shipped()[manoeuvre], series))


def test_features_are_shares() -> None:
    features = ours(shipped()[Manoeuvre.LANE_CHANGE], some_series(1))
    assert features.min() >= 0.0
    assert features.max() <= 1.0
    assert features.std() > 0.0


@pytest.mark.parametrize("manoeuvre", list(Manoeuvre))
def test_features_are_those_of_aeon(manoeuvre: Manoeuvre) -> None:
    """Its transform is in single precision with any order of summation; of whole numbers that is exact. Run as Python: compiling it takes
    longer than all the rest of this folder."""
    from aeon.transformations.collection.convolution_based import _minirocket

    regression = shipped()[manoeuvre]
    series = np.array([some_series(seed) for seed in range(5)])
    parameters = (
        regression.n_channels,
        regression.channels,
        regression.dilations,
        regression.per_dilation,
        regression.biases.astype(np.float32),
    )
    theirs = _minirocket._static_transform_multi.py_func(series.astype(np.float32), parameters, _minirocket.MiniRocket._indices)
    features = np.array([ours(regression, row) for row in series])
    np.testing.assert_array_equal(features.astype(np.float32), theirs)
