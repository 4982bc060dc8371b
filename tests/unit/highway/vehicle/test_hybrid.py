"""The hybrid vehicle: its residual against the training framework, its range and bounds, symmetries, and what happens to damaged files."""

import inspect
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.neural_network import MLPRegressor
from tests.support.effort import examples
from tests.unit.highway.vehicle.driving import lane_change

from drivecal.highway.training import vehicle as training
from drivecal.highway.training.vehicle import Drives
from drivecal.highway.vehicle import plugin, residual, single_track
from drivecal.highway.vehicle.model import HybridModel, SingleTrackModel
from drivecal.highway.vehicle.parameters import NOMINAL, TABLE_8, SingleTrackParameters
from drivecal.highway.vehicle.plugin import HYBRID, Hybrid
from drivecal.highway.vehicle.residual import Residual, shipped
from drivecal.plugins.arrays import DamagedArraysError
from drivecal.plugins.ports import Floats

boxes = st.builds(SingleTrackParameters, *(st.floats(parameter.minimum, parameter.maximum) for parameter in TABLE_8))
inputs = st.tuples(*([st.floats(-1.0, 1.0)] * 6))


def packed(model: Residual, parameters: SingleTrackParameters = NOMINAL) -> Floats:
    return np.concatenate([single_track.pack_plant(parameters), model.pack(parameters)])


def outputs(model: Residual, shares: Floats) -> Floats:
    """The residual at this share of the range, shape (2,)."""
    x = shares * model.limits
    return np.array(single_track.residual_outputs(tuple(x[:4].tolist()), float(x[4]), float(x[5]), packed(model)))


def framework(model: Residual) -> MLPRegressor:
    """The same weights in scikit-learn's network: lateral inputs times (1, speed, pull), then (1, speed, pull)."""
    network = MLPRegressor(hidden_layer_sizes=(len(model.hidden),), activation="tanh", max_iter=1)
    rng = np.random.default_rng(0)
    network.fit(rng.normal(size=(20, 15)), rng.normal(size=(20, 2)))
    network.coefs_ = [model.hidden.T.copy(), model.output.copy()]
    network.intercepts_ = [np.zeros(len(model.hidden)), np.zeros(2)]
    return network


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
def test_the_residual_is_that_of_the_training_framework() -> None:
    model, network = shipped(), framework(shipped())
    rng = np.random.default_rng(3)
    points = rng.uniform(-1.0, 1.0, (200, 6))
    ours = np.array([outputs(model, point) for point in points])
    x = points * model.limits
    even = np.column_stack([np.ones(200), x[:, 4], x[:, 5]])
    odd = np.hstack([x[:, :4] * even[:, [k]] for k in range(3)])
    theirs = network.predict(np.hstack([odd, even])) - network.predict(np.hstack([-odd, even]))
    assert ours == pytest.approx(np.clip(theirs, -model.bounds, model.bounds), abs=1e-6)
    assert np.abs(ours).max(axis=0).min() > 1e-3


@given(inputs)
def test_the_residual_of_a_mirrored_motion_is_mirrored(shares: tuple[float, ...]) -> None:
    here = np.array(shares)
    mirrored = here * np.array([-1.0, -1.0, -1.0, -1.0, 1.0, 1.0])
    assert outputs(shipped(), mirrored).tolist() == (-outputs(shipped(), here)).tolist()


@given(inputs, st.floats(0.0, 5.0))
def test_the_residual_is_bounded_and_ends_where_its_range_does(shares: tuple[float, ...], stretch: float) -> None:
    magnitudes = np.abs(outputs(shipped(), stretch * np.array(shares)))
    assert (magnitudes <= shipped().bounds).all()
    if stretch * max(abs(share) for share in shares) >= 1.0 + single_track.FADE:
        assert magnitudes.tolist() == [0.0, 0.0]


def test_it_fades_without_a_jump() -> None:
    direction = np.array([1.0, 0.4, 0.2, 0.1, 0.3, 0.1])
    along = np.array([outputs(shipped(), direction * share) for share in np.linspace(0.9, 1.2, 3001)])
    assert np.abs(np.diff(along, axis=0)).max() < 5e-3 * np.abs(along).max()


def drive(model: SingleTrackModel, path: Floats) -> tuple[Floats, Floats, bool]:
    """Dynamics, the last pose, and whether it went well."""
    steps = path.shape[0] - 1
    model.start(*(float(value) for value in path[0, [1, 2, 3, 5]]))
    dynamics = np.zeros((10 * steps, 5))
    stable = [model.follow(path, k * 0.1, 0.1, dynamics[10 * k : 10 * k + 10]) for k in range(steps)]
    return dynamics, model.pose.copy(), all(stable)


def outside(model: HybridModel) -> float:
    return model.metrics["outside_training_range_s"]


def test_a_lane_change_is_inside_the_range_and_not_that_of_the_plain_vehicle() -> None:
    path = lane_change(30.0, 5.0, 8.0)
    model = HybridModel(NOMINAL, shipped())
    ours, pose, stable = drive(model, path)
    plain, plain_pose, _ = drive(SingleTrackModel(NOMINAL), path)
    assert stable
    assert outside(model) == 0.0
    assert 0.02 < np.abs(ours[:, 2] - plain[:, 2]).max() < 1.0
    assert np.hypot(*(pose[:2] - plain_pose[:2])) < 0.3


def test_outside_the_range_it_is_the_plain_vehicle_and_counts_the_time() -> None:
    path = lane_change(48.0, 5.0, 8.0)
    model = HybridModel(NOMINAL, shipped())
    ours, _, _ = drive(model, path)
    np.testing.assert_array_equal(ours, drive(SingleTrackModel(NOMINAL), path)[0])
    assert outside(model) == pytest.approx(8.0)
    drive(model, lane_change(30.0, 5.0, 8.0))
    assert outside(model) == 0.0


@settings(max_examples=examples(40), deadline=None)
@given(parameters=boxes, speed=st.floats(16.0, 38.0), takes=st.floats(4.0, 8.0))
def test_whatever_the_vehicle_of_table_8_a_lane_change_goes_well(
    parameters: SingleTrackParameters, speed: float, takes: float
) -> None:
    path = lane_change(speed, takes, 10.0)
    if drive(SingleTrackModel(parameters), path)[2]:
        dynamics, pose, stable = drive(HybridModel(parameters, shipped()), path)
        assert stable
        assert np.isfinite(dynamics).all()
        assert abs(pose[1] - path[-1, 2]) < 1.0


def test_the_residual_of_a_vehicle_is_scaled_by_its_loads() -> None:
    """A vehicle twice as heavy in everything moves alike."""
    loads = ("mass", "cornering_stiffness_front", "cornering_stiffness_rear", "yaw_inertia")
    heavy = replace(NOMINAL, **{name: 2.0 * getattr(NOMINAL, name) for name in loads})
    state = np.array([0.0, 0.0, 0.0, 30.0, -0.01, 0.05, 0.0, 0.0, 0.02, 0.0])
    here = single_track.residual_accelerations(state, 0.01, 0.5, packed(shipped()))
    there = single_track.residual_accelerations(state, 0.01, 0.5, packed(shipped(), heavy))
    assert here[2]
    assert there[:2] == pytest.approx(here[:2], rel=1e-12)
    assert abs(here[0]) > 1e-3


def test_its_version_follows_its_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    other = replace(shipped(), bounds=2.0 * shipped().bounds)
    before = Hybrid().version
    assert before == HYBRID.version
    monkeypatch.setattr(plugin, "shipped", lambda: other)
    assert Hybrid().version != before


def wave() -> str:
    """The dynamics of a drive to and fro, in hexadecimal."""
    model = HYBRID.create({parameter.name: parameter.nominal for parameter in HYBRID.parameters})
    time = np.arange(81) * 0.1
    path = np.column_stack([time, 30 * time, np.sin(time), np.cos(time) / 30, -np.sin(time) / 900, 30 + 0 * time, 0 * time])
    dynamics = np.zeros((600, 5))
    model.start(0.0, 0.0, 0.0, 30.0)
    model.follow(path, 0.0, 6.0, dynamics)
    return dynamics.tobytes().hex()


PROGRAM = f"""
import sys, numpy as np
from drivecal.highway.vehicle.plugin import HYBRID
{inspect.getsource(wave)}
HYBRID.version
assert not {{"numba", "scipy", "sklearn"}} & set(sys.modules), "the coordinator would load too much"
print(wave(), end="")
assert not {{"sklearn", "vehiclemodels"}} & set(sys.modules), "the worker would load too much"
"""


@pytest.mark.slow
def test_a_fresh_process_agrees_in_every_bit_and_loads_little() -> None:
    assert subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True).stdout == wave()


def test_a_damaged_file_is_refused_and_no_vehicle_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "hybrid.npz"
    path.write_bytes(residual.FILE.read_bytes()[:-50])
    monkeypatch.setattr(plugin, "shipped", lambda: residual.shipped(path))
    vehicle = Hybrid()
    with pytest.raises(DamagedArraysError, match=r"hybrid\.npz"):
        vehicle.version  # noqa: B018  reading it is what fails
    with pytest.raises(DamagedArraysError):
        vehicle.create({parameter.name: parameter.nominal for parameter in TABLE_8})


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("hidden", np.zeros((3, 15)), "3 hidden"),
        ("output", np.zeros((0, 2)), "0 output"),
        ("limits", np.zeros(6), "positive"),
        ("hidden", np.zeros((8, 14)), "shape"),
    ],
)
def test_arrays_that_do_not_fit_together_never_reach_the_kernels(tmp_path: Path, name: str, value: Floats, reason: str) -> None:
    np.savez(tmp_path / "hybrid.npz", allow_pickle=False, **(dict(shipped().arrays) | {name: value}))
    with pytest.raises(DamagedArraysError, match=reason):
        residual.shipped(tmp_path / "hybrid.npz")


@pytest.mark.slow
def test_training_again_gives_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """On one machine; a drive and a few steps of the search represent all of them."""
    monkeypatch.setattr(training, "ITERATIONS", 3)
    trained = []
    for _ in range(2):
        drives = Drives.of(training.record_all(("slalom",), 1, seed=9))
        fitted = training.fit_residual(drives, training.fit_baseline(drives))
        trained.append({name: array.tobytes() for name, array in fitted.arrays.items()})
    assert trained[0] == trained[1]
