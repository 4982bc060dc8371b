"""Table 8, and what follows from its values in closed form."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import faults_of, present
from tests.unit.highway.vehicle.driving import critical_speed

from drivecal.highway.vehicle.parameters import NOMINAL, TABLE_8, SingleTrackParameters, understeer_gradient
from drivecal.plugins.ports import Floats

NOMINAL_VALUES = {parameter.name: parameter.nominal for parameter in TABLE_8}

boxes = st.builds(SingleTrackParameters, *(st.floats(parameter.minimum, parameter.maximum) for parameter in TABLE_8))


def dynamics_matrix(p: SingleTrackParameters, v: float) -> Floats:
    """Returns the system matrix of side-slip angle and yaw rate, from the balance of forces and moments (not the kernel's coefficients)."""
    lateral = np.array([[-p.cornering_stiffness_front, -p.cornering_stiffness_front * p.distance_front / v]])
    rear = np.array([[-p.cornering_stiffness_rear, p.cornering_stiffness_rear * p.distance_rear / v]])
    force = lateral + rear
    moment = p.distance_front * lateral - p.distance_rear * rear
    return np.vstack([force / (p.mass * v) - np.array([[0.0, 1.0]]), moment / p.yaw_inertia])


def grows_fastest_at(p: SingleTrackParameters, v: float) -> float:
    return float(np.linalg.eigvals(dynamics_matrix(p, v)).real.max())


def test_nominal_values_lie_inside_their_bounds() -> None:
    assert all(parameter.minimum < parameter.nominal < parameter.maximum for parameter in TABLE_8)


def test_the_nominal_vehicle_understeers_by_the_value_worked_out_by_hand() -> None:
    # 2060 / 3.21 (1.55 / 75000 - 1.66 / 150000) = 641.745 (2.06667e-5 - 1.10667e-5)
    assert understeer_gradient(NOMINAL) == pytest.approx(641.745 * 0.96e-5, rel=1e-5)
    assert critical_speed(NOMINAL) is None


def test_the_heavy_tail_of_the_box_oversteers_with_a_critical_speed_on_motorways() -> None:
    tail_heavy = SingleTrackParameters(2600.0, 90_000.0, 120_000.0, 2.0, 1.0, 4500.0)
    assert understeer_gradient(tail_heavy) < 0.0
    speed = present(critical_speed(tail_heavy))
    assert 20.0 < speed < 30.0


@given(boxes)
def test_the_critical_speed_is_where_an_eigenvalue_crosses_zero(p: SingleTrackParameters) -> None:
    speed = critical_speed(p)
    if speed is None:
        assert all(grows_fastest_at(p, v) <= 1e-9 for v in (5.0, 20.0, 60.0, 200.0))
    else:
        assert grows_fastest_at(p, 0.99 * speed) < 0.0 < grows_fastest_at(p, 1.01 * speed)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_a_value_that_is_no_positive_number_is_refused_by_name(value: float) -> None:
    assert faults_of(SingleTrackParameters.of, NOMINAL_VALUES | {"mass": value})[0].field == "vehicle.parameters.mass"


def test_missing_and_unknown_parameters_are_refused_by_name() -> None:
    values = {name: value for name, value in NOMINAL_VALUES.items() if name != "yaw_inertia"} | {"colour": 3.0}
    assert [problem.field for problem in faults_of(SingleTrackParameters.of, values)] == [
        "vehicle.parameters.yaw_inertia",
        "vehicle.parameters.colour",
    ]
