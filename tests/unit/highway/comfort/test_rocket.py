"""MiniRocket features against aeon's transform."""

import numpy as np
import pytest

from drivecal.highway.comfort import rocket
from drivecal.highway.comfort.reference import Manoeuvre
from drivecal.highway.comfort.regressions import Regression, shipped
from drivecal.highway.comfort.rocket import LENGTH
from drivecal.plugins.ports import Floats


def some_series(seed: int) -> rocket.Integers:
    """Six channels that drift, as a run's do; some of them at the largest value."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(0.0, 60.0, (6, LENGTH)), axis=1)
    return np.clip(np.rint(walk), -2047, 2047).astype(np.int32)


def ours(regression: Regression, series: rocket.Integers) -> Floats:
    names = ("dilations", "per_dilation", "n_channels", "channels", "biases")
    features: Floats = rocket.transform(series, rocket.KERNELS, *(getattr(regression, name) for name in names))
    return features


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
