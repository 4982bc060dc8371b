"""Boxes of vehicles, the three conditions, and the degree of robustness found by growing boxes and by bisection."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples

from drivecal.analysis.robustness import (
    Robustness,
    RobustnessStudy,
    deviation,
    directions,
    failing_at_most,
    holds,
    undetected_share,
    vehicles,
)
from drivecal.contracts.specification import RobustnessSpecification
from drivecal.domain.vehicles import VehicleParameter
from drivecal.plugins.ports import Floats

TABLE_8 = (
    VehicleParameter("mass", "kg", 2060.0, 1200.0, 2600.0),
    VehicleParameter("front", "N/rad", 75000.0, 55000.0, 90000.0),
    VehicleParameter("distance", "m", 1.66, 1.0, 2.0),
)
NOMINAL = {item.name: item.nominal for item in TABLE_8}
EDGE = NOMINAL | {"mass": 1200.0}


@given(radius=st.floats(0.001, 0.5), seed=st.integers(0, 1000), box=st.integers(1, 20), at_edge=st.booleans())
@settings(max_examples=examples(60))
def test_every_vehicle_lies_in_the_box_and_within_the_bounds(radius: float, seed: int, box: int, at_edge: bool) -> None:
    nominal = EDGE if at_edge else NOMINAL
    for vehicle in vehicles(TABLE_8, nominal, radius, directions(3, 30, seed, box)):
        for item in TABLE_8:
            assert item.minimum <= vehicle[item.name] <= item.maximum
            away = abs(vehicle[item.name] - nominal[item.name]) / (item.maximum - item.minimum)
            assert away <= radius * (1 + 1e-9)


def test_boxes_and_seeds_have_directions_of_their_own_which_repeat() -> None:
    assert np.array_equal(directions(3, 10, 7, 2), directions(3, 10, 7, 2))
    assert not np.array_equal(directions(3, 10, 7, 2), directions(3, 10, 7, 3))
    assert not np.array_equal(directions(3, 10, 7, 2), directions(3, 10, 8, 2))


@pytest.mark.parametrize(
    ("condition", "eta", "expected"),
    [
        ("max", 1.0, False), ("max", 2.0, True),
        ("mean", 0.25, False), ("mean", 0.2501, True),
    ],
)  # fmt: skip
def test_the_conditions_compare_what_the_paper_says(condition: Any, eta: float, expected: bool) -> None:
    chosen = RobustnessSpecification(condition=condition, eta=eta)
    scores = np.array([[5.0, 2.0], [5.0, 4.0]])
    assert holds(deviation(np.array([5.0, 4.0]), scores, chosen.condition), np.array([5.0, 4.0]), chosen) is expected


def test_one_point_is_still_robust_and_a_relative_bound_is_strict() -> None:
    assert holds(np.array([1.0]), np.array([6.0]), RobustnessSpecification(eta=1))
    assert not holds(np.array([0.2]), np.array([6.0]), RobustnessSpecification(condition="mean", eta=0.2))


def test_a_score_of_zero_divides_by_one() -> None:
    assert deviation(np.array([0.0]), np.array([[2.0], [0.0]]), "mean").tolist() == [1.0]


def test_no_change_of_a_score_of_zero_without_a_tolerance_is_robust() -> None:
    scores = np.array([[0.0, 1.0], [0.0, 0.0]])
    assert deviation(np.zeros(2), scores, "mean", 0.0).tolist() == [0.0, np.inf]


@pytest.mark.parametrize("condition", ["max", "mean"])
def test_a_vehicle_without_a_result_cannot_be_vouched_for(condition: Any) -> None:
    chosen = RobustnessSpecification(condition=condition, eta=100.0)
    away = deviation(np.array([5.0, 4.0]), np.array([[5.0, 4.0], [5.0, np.nan]]), chosen.condition)
    assert not holds(away, np.array([5.0, 4.0]), chosen)


def run(limits: list[float], chosen: RobustnessSpecification) -> tuple[RobustnessStudy, int]:
    """Solutions that keep their score up to a half width of their own, and lose two points beyond."""
    nominal = np.full((len(limits), 2), 6.0)
    study = RobustnessStudy(nominal, ("S1", "S2"), TABLE_8, NOMINAL, chosen)
    driven = 0
    while (box := study.ask()) is not None:
        scores: dict[int, Floats] = {}
        assert len(box.vehicles) == chosen.samples
        for solution in box.solutions:
            scores[solution] = np.full((chosen.samples, 2), 6.0)
            if box.radius > limits[solution]:
                scores[solution][0, 1] = 4.0
            driven += chosen.samples
        study.tell(scores)
    return study, driven


def test_the_degree_is_the_largest_multiple_up_to_which_the_condition_holds() -> None:
    study, driven = run([0.005, 0.035, 0.0999, 5.0], RobustnessSpecification(samples=4, eta=1))
    result = study.result()
    assert [item.degree for item in result] == [0, 3, 9, 10]
    assert [entry.at_least for entry in result] == [False, False, False, True]
    assert [element.radius for element in result] == pytest.approx([0.0, 0.03, 0.09, 0.1])
    assert driven == 4 * (1 + 4 + 10 + 10)  # a set whose condition failed is driven no further


def test_a_study_that_is_told_the_same_goes_on_as_the_first() -> None:
    chosen = RobustnessSpecification(samples=3, eta=1)
    nominal = np.array([[6.0, 5.0], [4.0, 4.0]])
    first, boxes = RobustnessStudy(nominal, ("S1", "S2"), TABLE_8, NOMINAL, chosen), []
    while (box := first.ask()) is not None:
        boxes.append(box)
        first.tell({each: np.round(nominal[each] - 60 * box.radius) + np.zeros((3, 2)) for each in box.solutions})
    second = RobustnessStudy(nominal, ("S1", "S2"), TABLE_8, NOMINAL, chosen)
    for box in boxes:
        assert second.ask() == box
        assert second.ask() == box
        second.tell({each: np.round(nominal[each] - 60 * box.radius) + np.zeros((3, 2)) for each in box.solutions})
    assert second.ask() is None
    assert second.result() == first.result()


def test_nothing_to_examine_is_no_study() -> None:
    assert RobustnessStudy(np.zeros((0, 6)), [], TABLE_8, NOMINAL, RobustnessSpecification()).ask() is None


def test_telling_before_asking_is_refused() -> None:
    with pytest.raises(RuntimeError, match="ask first"):
        RobustnessStudy(np.zeros((1, 6)), [], TABLE_8, NOMINAL, RobustnessSpecification()).tell({})


def test_vehicles_that_hold_leave_the_share_open_that_they_would_miss_once_in_twenty() -> None:
    assert undetected_share(30) == pytest.approx(0.095, abs=1e-3)
    for samples in (1, 30, 1000):
        assert (1 - undetected_share(samples)) ** samples == pytest.approx(0.05)
    assert undetected_share(30, 20) == pytest.approx(0.181, abs=1e-3), "the recommended one of 20 sets"
    held, broken = Robustness(2, False, 0.02, ()), Robustness(0, False, 0.0, ())
    assert failing_at_most(held, RobustnessSpecification(), 20) == undetected_share(30, 20)
    assert failing_at_most(broken, RobustnessSpecification(), 20) is None
    assert failing_at_most(held, RobustnessSpecification(condition="mean"), 20) is None
