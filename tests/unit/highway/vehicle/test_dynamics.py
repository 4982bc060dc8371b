"""The equations of motion and their integration: closed forms, order of convergence, consistency at the switch of models."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.unit.highway.vehicle.driving import critical_speed

from drivecal.highway.vehicle import single_track
from drivecal.highway.vehicle.parameters import NOMINAL, TABLE_8, SingleTrackParameters, understeer_gradient
from drivecal.plugins.ports import Floats

CORNERS = [SingleTrackParameters(*corner) for corner in itertools.product(*((p.minimum, p.maximum) for p in TABLE_8))]

boxes = st.builds(SingleTrackParameters, *(st.floats(parameter.minimum, parameter.maximum) for parameter in TABLE_8))


def state_at(speed: float, steering_angle: float = 0.0) -> Floats:
    return np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0, 0.0, steering_angle])


def run(
    state: Floats,
    seconds: float,
    parameters: SingleTrackParameters = NOMINAL,
    steering_rate: float = 0.0,
    acceleration: float = 0.0,
    step: float = single_track.STEP,
) -> Floats:
    state, plant = state.copy(), single_track.pack_plant(parameters)
    for _ in range(round(seconds / step)):
        single_track.advance(state, steering_rate, acceleration, plant, step)
    return state


@settings(max_examples=examples(60), deadline=None)
@given(boxes, st.floats(8.0, 40.0))
def test_steady_cornering_has_the_yaw_rate_gain_of_the_understeer_gradient(p: SingleTrackParameters, v: float) -> None:
    critical = critical_speed(p)
    if critical is not None and v > 0.8 * critical:
        return  # takes for ever to settle, or never does
    delta = 0.002
    end = run(state_at(v, delta), 40.0, p)
    curvature = delta / (p.wheelbase + understeer_gradient(p) * v**2)
    assert end[5] == pytest.approx(v * curvature, rel=1e-6)
    assert end[7] == pytest.approx(v**2 * curvature, rel=1e-6)
    slip_gradient = p.mass * p.distance_front / (p.cornering_stiffness_rear * p.wheelbase)
    assert end[4] == pytest.approx((p.distance_rear - slip_gradient * v**2) * curvature, rel=1e-6, abs=1e-9)


def test_the_integration_converges_with_order_four() -> None:
    def end(step: float) -> Floats:
        return run(state_at(30.0), 1.0, steering_rate=0.03, acceleration=-2.0, step=step)[:6]

    exact = end(1.0 / 6400)
    errors = [np.abs(end(1.0 / n) - exact).max() for n in (25, 50, 100)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert orders == pytest.approx([4.0, 4.0], abs=0.25)
    assert errors[-1] < 1e-6


@pytest.mark.parametrize("speed", [3.5, 4.0, 4.5, 4.99])
def test_between_the_models_steady_cornering_lies_between_theirs(speed: float) -> None:
    delta = 0.05
    end = run(state_at(speed, delta), 20.0)
    dynamic = speed * delta / (NOMINAL.wheelbase + understeer_gradient(NOMINAL) * speed**2)
    assert dynamic < end[5] < speed * delta / NOMINAL.wheelbase


@pytest.mark.parametrize("corner", CORNERS)
def test_braking_through_the_switch_of_models_leaves_no_jump(corner: SingleTrackParameters) -> None:
    state, plant = run(state_at(8.0, 0.03), 10.0, corner), single_track.pack_plant(corner)
    yaw_rates, slips = [state[5]], [state[4]]
    while state[3] > 0.5:
        single_track.advance(state, 0.0, -2.0, plant, single_track.STEP)
        yaw_rates.append(state[5])
        slips.append(state[4])
    # Steady curvature times 2 m/s^2 is 0.02 to 0.05 rad/s^2; a step lasts 0.01 s.
    assert np.abs(np.diff(yaw_rates)).max() < 1.5e-3
    assert np.abs(np.diff(slips)).max() < 5e-4
    assert np.abs(np.diff(yaw_rates, 2)).max() < 1e-4


def test_a_standing_vehicle_stays_where_it_is() -> None:
    assert run(state_at(0.0, 0.1), 5.0)[:4].tolist() == [0.0, 0.0, 0.0, 0.0]
