"""Table 8, and what follows from its values in closed form."""

import math

import pytest
from tests.support.values import faults_of
from tests.unit.highway.vehicle.driving import critical_speed

from drivecal.highway.vehicle.parameters import NOMINAL, TABLE_8, SingleTrackParameters, understeer_gradient

NOMINAL_VALUES = {parameter.name: parameter.nominal for parameter in TABLE_8}


def test_nominal_values_lie_inside_their_bounds() -> None:
    assert all(parameter.minimum < parameter.nominal < parameter.maximum for parameter in TABLE_8)


def test_the_nominal_vehicle_understeers_by_the_value_worked_out_by_hand() -> None:
    # 2060 / 3.21 (1.55 / 75000 - 1.66 / 150000) = 641.745 (2.06667e-5 - 1.10667e-5)
    assert understeer_gradient(NOMINAL) == pytest.approx(641.745 * 0.96e-5, rel=1e-5)
    assert critical_speed(NOMINAL) is None


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_a_value_that_is_no_positive_number_is_refused_by_name(value: float) -> None:
    assert faults_of(SingleTrackParameters.of, NOMINAL_VALUES | {"mass": value})[0].field == "vehicle.parameters.mass"


def test_missing_and_unknown_parameters_are_refused_by_name() -> None:
    values = {name: value for name, value in NOMINAL_VALUES.items() if name != "yaw_inertia"} | {"colour": 3.0}
    assert [problem.field for problem in faults_of(SingleTrackParameters.of, values)] == [
        "vehicle.parameters.yaw_inertia",
        "vehicle.parameters.colour",
    ]
