"""The reference line against closed forms, and the way between Cartesian and Frenet coordinates there and back."""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import fresnel

from drivecal.domain.errors import InvalidInputError
from drivecal.domain.roads import Motion, pose_on, project, reference_line, to_cartesian, to_frenet
from drivecal.domain.scenarios import CurvatureKnot, Road


def road(*knots: tuple[float, float], length: float = 600.0) -> Road:
    return Road(length, 2, 3.75, tuple(CurvatureKnot(s, curvature) for s, curvature in knots))


CURVY = road((100.0, 0.0), (180.3, 1 / 250), (260.1, 1 / 250), (333.3, -1 / 180), (600.0, -1 / 180))


def test_a_straight_road_is_straight() -> None:
    line = reference_line(road((0.0, 0.0), length=100.2), 0.5)
    assert line.shape == (202, 5)
    assert line[-1].tolist() == [100.5, pytest.approx(100.5, abs=1e-12), 0.0, 0.0, 0.0]
    np.testing.assert_allclose(np.diff(line[:, 0]), 0.5)


@pytest.mark.parametrize("radius", [60.0, -60.0, 400.0])
def test_constant_curvature_is_an_arc(radius: float) -> None:
    s, x, y, heading, curvature = reference_line(road((0.0, 1 / radius))).T
    np.testing.assert_allclose(x, radius * np.sin(s / radius), atol=1e-10)
    np.testing.assert_allclose(y, radius * (1 - np.cos(s / radius)), atol=1e-10)
    np.testing.assert_allclose(heading, s / radius, atol=1e-12)
    np.testing.assert_allclose(curvature, 1 / radius)


def test_linear_curvature_is_a_clothoid() -> None:
    parameter = 150.0
    s, x, y, heading, _ = reference_line(road((0.0, 0.0), (600.0, 600.0 / parameter**2))).T
    scale = parameter * sqrt(pi)
    sine, cosine = fresnel(s / scale)
    np.testing.assert_allclose(x, scale * cosine, atol=1e-9)
    np.testing.assert_allclose(y, scale * sine, atol=1e-9)
    np.testing.assert_allclose(heading, s**2 / (2 * parameter**2), rtol=1e-12, atol=1e-15)


def test_knots_between_the_rows_cost_no_accuracy() -> None:
    fine, coarse = reference_line(CURVY, 0.125), reference_line(CURVY, 2.0)
    np.testing.assert_allclose(coarse[:, :4], fine[::16, :4], atol=1e-9)


@pytest.mark.parametrize(
    "wrong", [road(), road((10.0, 0.0), (10.0, 0.1)), road((0.0, 0.0), length=0.0), road((0.0, 0.0), length=float("nan"))]
)
def test_a_road_that_makes_no_line_is_refused(wrong: Road) -> None:
    with pytest.raises(InvalidInputError, match="road"):
        reference_line(wrong)


@given(st.floats(0.0, 600.0))
def test_the_line_between_its_rows_follows_the_finer_line(s: float) -> None:
    coarse, fine = reference_line(CURVY, 0.5), reference_line(CURVY, 0.01)
    x, y, heading, curvature, _ = pose_on(coarse, s)
    row = round(s / 0.01)
    shift = s - fine[row, 0]
    # between rows 0.5 m apart the heading is off by up to 0.5**2 / 8 times the curvature's slope
    assert x == pytest.approx(fine[row, 1] + shift * cos(fine[row, 3]), abs=5e-6)
    assert y == pytest.approx(fine[row, 2] + shift * sin(fine[row, 3]), abs=5e-6)
    assert heading == pytest.approx(fine[row, 3] + shift * fine[row, 4], abs=5e-6)
    assert curvature == pytest.approx(fine[row, 4], abs=2e-5)


LINE = reference_line(CURVY)


@given(st.floats(-20.0, 620.0), st.floats(-6.0, 12.0), st.floats(-15.0, 15.0))
def test_projection_undoes_to_cartesian(s: float, d: float, guess_error: float) -> None:
    x, y, _ = to_cartesian(LINE, s, d)
    found_s, found_d = project(LINE, x, y, s + guess_error)
    # The line's own second derivative jumps by some 1e-8 between rows: the foot point is that sharp.
    assert found_s == pytest.approx(s, abs=1e-6)
    assert found_d == pytest.approx(d, abs=1e-9)


@pytest.mark.parametrize(("x", "near"), [(float("nan"), 10.0), (10.0, float("inf")), (900.0, 10.0)])
def test_a_point_without_a_foot_point_nearby_is_refused(x: float, near: float) -> None:
    with pytest.raises(ValueError, match="closer"):
        project(LINE, x, 0.0, near)


def test_motion_matches_differences_of_the_cartesian_path() -> None:
    s0, d0, step = 220.0, 2.0, 1e-3

    def point(t: float) -> npt.NDArray[np.float64]:
        return np.array(to_cartesian(LINE, s0 + 30.0 * t + 0.7 * t * t, d0 + 1.1 * t - 0.4 * t * t)[:2])

    velocity = (point(step) - point(-step)) / (2 * step)
    acceleration = (point(step) - 2 * point(0.0) + point(-step)) / step**2
    x, y = point(0.0)
    motion = to_frenet(LINE, (x, y), (velocity[0], velocity[1]), (acceleration[0], acceleration[1]), s0 + 5.0)
    assert motion == pytest.approx(Motion(s0, 30.0, 1.4, d0, 1.1, -0.8), rel=1e-4)
