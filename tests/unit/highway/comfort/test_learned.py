"""The learned evaluator: what it rates, what it refuses, and that it is what was trained."""

import inspect
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.linear_model import RidgeCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from tests.support.effort import examples

from drivecal.highway.comfort import learned, regressions
from drivecal.highway.comfort.learned import LEARNED, Learned
from drivecal.highway.comfort.reference import Manoeuvre
from drivecal.highway.comfort.regressions import arrays_of, shipped
from drivecal.highway.comfort.rocket import LENGTH, MIRROR, channels_of, features_of, rating_of
from drivecal.highway.training import comfort
from drivecal.highway.training.rated_drives import synthetic
from drivecal.plugins.arrays import DamagedArraysError
from drivecal.plugins.ports import Series, SeriesEvaluator

every_class = pytest.mark.parametrize("manoeuvre", list(Manoeuvre))


def series(seconds: float = 16.0, lateral: float = 0.0, longitudinal: float = 0.0, offset: float = 0.0) -> Series:
    """A run with one push across and one along, 3 s each, and an offset from the lane's centre."""
    time = np.arange(round(100 * seconds)) / 100.0
    push = np.where((time > 4.0) & (time < 7.0), np.sin((time - 4.0) * math.pi / 3.0), 0.0)
    dynamics = np.zeros((time.size, 5))
    dynamics[:, 0] = 30.0
    dynamics[:, 1:4] = np.column_stack([longitudinal * push, lateral * push, lateral * push / 30.0])
    return Series(dynamics, np.full(round(10 * seconds), offset))


def rate(manoeuvre: Manoeuvre, run: Series) -> float:
    assert isinstance(LEARNED, SeriesEvaluator)
    rating = LEARNED.rate_series(manoeuvre, run)
    assert rating.score == math.floor(rating.rating + 0.5)
    assert 0.0 <= rating.rating <= 7.0
    return rating.rating


def test_its_version_follows_its_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    changed = replace(shipped()[Manoeuvre.LANE_CHANGE], intercept=np.array([1.0]))
    other = shipped() | {Manoeuvre.LANE_CHANGE: changed}
    before = Learned().version
    assert before == LEARNED.version
    monkeypatch.setattr(learned, "shipped", lambda: other)
    assert Learned().version != before


@every_class
def test_a_drive_straight_on_is_comfortable_and_a_violent_one_is_not(manoeuvre: Manoeuvre) -> None:
    calm, violent = rate(manoeuvre, series()), rate(manoeuvre, series(lateral=4.0, longitudinal=-5.0, offset=0.9))
    assert calm > 4.5, "which is a score of 5"
    assert violent < 2.0


@every_class
@settings(max_examples=examples(20), deadline=None)
@given(
    seconds=st.floats(10.0, 30.0),
    lateral=st.floats(-50.0, 50.0),
    longitudinal=st.floats(-50.0, 50.0),
    offset=st.floats(-9.0, 9.0),
)
def test_whatever_the_drive_the_rating_is_on_the_scale_and_blind_to_sides(
    manoeuvre: Manoeuvre, seconds: float, lateral: float, longitudinal: float, offset: float
) -> None:
    seconds = round(seconds, 1)
    here = rate(manoeuvre, series(seconds, lateral, longitudinal, offset))
    assert rate(manoeuvre, series(seconds, -lateral, longitudinal, -offset)) == here


def test_the_mirror_image_of_a_run_has_mirrored_channels() -> None:
    run, mirrored = series(lateral=2.0, longitudinal=1.0, offset=0.3), series(lateral=-2.0, longitudinal=1.0, offset=-0.3)
    seen = channels_of(run.dynamics, run.offset)
    assert seen.shape == (6, LENGTH)
    assert np.abs(seen).max(axis=1).min() > 0
    np.testing.assert_array_equal(seen * MIRROR, channels_of(mirrored.dynamics, mirrored.offset))


def test_channels_are_in_256ths_of_their_units_and_cut_at_8_units() -> None:
    run = series(offset=0.25)
    run.dynamics[:, 1], run.dynamics[:, 3] = 1.5, 99.0
    seen = channels_of(run.dynamics, run.offset)
    assert set(seen[0]) == {384}
    assert set(seen[2]) == {0}
    assert set(seen[4]) == {2047}
    assert set(seen[5]) == {256}


def test_a_run_without_its_series_cannot_be_rated() -> None:
    with pytest.raises(ValueError, match="lane_change"):
        LEARNED.rate(Manoeuvre.LANE_CHANGE, {"peak_lateral_acceleration_mps2": 1.0})


@pytest.mark.parametrize("seconds", [9.9, 30.1, 0.0])
def test_a_run_of_a_length_it_never_saw_is_refused(seconds: float) -> None:
    with pytest.raises(ValueError, match="10 to 30 s"):
        rate(Manoeuvre.LANE_CHANGE, series(seconds))


@pytest.mark.parametrize("broken", [math.nan, math.inf])
def test_a_series_that_is_not_finite_is_refused(broken: float) -> None:
    run = series()
    run.dynamics[100, 2] = broken
    with pytest.raises(ValueError, match="finite"):
        rate(Manoeuvre.LANE_CHANGE, run)


@pytest.mark.slow
@every_class
def test_it_rates_as_the_training_framework_does(manoeuvre: Manoeuvre) -> None:
    """Ridge regression by scikit-learn on standardised features, against the weights that are stored for it."""
    drives = [drive for number in range(40) if (drive := synthetic(manoeuvre, number, seed=5)) is not None]
    panel = comfort.rated_by_panel(drives)
    fitted = comfort.fit(drives, panel, seed=2)
    features = np.array([features_of(fitted, drive.channels) for drive in drives])
    ridge = make_pipeline(StandardScaler(), RidgeCV(alphas=comfort.PENALTIES)).fit(features, panel)
    theirs = np.clip(ridge.predict(features), 0.0, 7.0)
    ours = [rating_of(fitted, drive.channels).rating for drive in drives]
    assert ours == pytest.approx(theirs.tolist(), abs=1e-6)
    assert np.std(ours) > 0.5


def test_training_again_gives_the_same_bits() -> None:
    drives = [drive for number in range(8) if (drive := synthetic(Manoeuvre.LANE_KEEPING, number, seed=5)) is not None]
    once, again = (comfort.fit(drives, comfort.rated_by_panel(drives), seed=2) for _ in range(2))
    for name in ("channels", "biases", "weights", "intercept"):
        np.testing.assert_array_equal(getattr(once, name), getattr(again, name))


def waves() -> str:
    """The ratings of a drive to and fro, in hexadecimal."""
    time = np.arange(1600) / 100.0
    dynamics = np.column_stack([30 + 0 * time] + [np.sin(k * time) for k in (0.5, 0.7, 0.9, 1.1)])
    run = Series(dynamics, np.cos(time[::10]))
    assert isinstance(LEARNED, SeriesEvaluator)
    return " ".join(LEARNED.rate_series(manoeuvre, run).rating.hex() for manoeuvre in Manoeuvre)


PROGRAM = f"""
import sys, numpy as np
from drivecal.highway.comfort.reference import Manoeuvre
from drivecal.plugins.ports import Series, SeriesEvaluator
from drivecal.highway.comfort.learned import LEARNED
{inspect.getsource(waves)}
LEARNED.version
assert not {{"numba", "scipy", "sklearn"}} & set(sys.modules), "the coordinator would load too much"
print(waves(), end="")
assert not {{"aeon", "sklearn", "pandas"}} & set(sys.modules), "the worker would load too much"
"""


@pytest.mark.slow
def test_a_fresh_process_agrees_in_every_bit_and_loads_little() -> None:
    assert subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True).stdout == waves()


def test_a_damaged_file_is_refused_and_nothing_is_rated_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "learned.npz"
    path.write_bytes(regressions.FILE.read_bytes()[:-100])
    monkeypatch.setattr(learned, "shipped", lambda: regressions.shipped(path))
    evaluator = Learned()
    with pytest.raises(DamagedArraysError, match=r"learned\.npz"):
        evaluator.version  # noqa: B018  reading it is what fails
    with pytest.raises(DamagedArraysError):
        evaluator.rate_series(Manoeuvre.LANE_CHANGE, series())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("dilations", [1, 2, 7, 20]),
        ("dilations", [0, 2, 7, 19]),
        ("per_dilation", [6, 6, 6, 7]),
        ("n_channels", [1] * 336),
        ("weights", [0.5]),
    ],
)
def test_arrays_that_do_not_fit_together_never_reach_the_kernels(tmp_path: Path, name: str, value: list[float]) -> None:
    arrays = arrays_of(shipped())
    kind = arrays[f"lane_change_{name}"].dtype
    arrays[f"lane_change_{name}"] = np.array(value, dtype=kind)
    np.savez(tmp_path / "learned.npz", allow_pickle=False, **arrays)
    with pytest.raises(DamagedArraysError, match="channels"):
        regressions.shipped(tmp_path / "learned.npz")


def test_a_channel_that_does_not_exist_never_reaches_the_kernels() -> None:
    regression = shipped()[Manoeuvre.SPEED_CHANGE]
    with pytest.raises(ValueError, match="channels"):
        replace(regression, channels=regression.channels + 5)
