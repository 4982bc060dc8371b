"""Designs of roads against closed forms."""

from math import pi, sqrt

import numpy as np
import pytest
from scipy.special import fresnel

from drivecal.domain.errors import InvalidInputError
from drivecal.highway.scenarios.designs import CurvatureKnot, RoadDesign, line_of


def road(*knots: tuple[float, float], length: float = 600.0) -> RoadDesign:
    return RoadDesign(length, 2, 3.75, tuple(CurvatureKnot(s, curvature) for s, curvature in knots))


CURVY = road((100.0, 0.0), (180.3, 1 / 250), (260.1, 1 / 250), (333.3, -1 / 180), (600.0, -1 / 180))


@pytest.mark.parametrize("radius", [60.0, -60.0, 400.0])
def test_constant_curvature_is_an_arc(radius: float) -> None:
    s, x, y, heading, curvature = line_of(road((0.0, 1 / radius))).T
    np.testing.assert_allclose(x, radius * np.sin(s / radius), atol=1e-10)
    np.testing.assert_allclose(y, radius * (1 - np.cos(s / radius)), atol=1e-10)
    np.testing.assert_allclose(heading, s / radius, atol=1e-12)
    np.testing.assert_allclose(curvature, 1 / radius)


def test_linear_curvature_is_a_clothoid() -> None:
    parameter = 150.0
    s, x, y, heading, _ = line_of(road((0.0, 0.0), (600.0, 600.0 / parameter**2))).T
    scale = parameter * sqrt(pi)
    sine, cosine = fresnel(s / scale)
    np.testing.assert_allclose(x, scale * cosine, atol=1e-9)
    np.testing.assert_allclose(y, scale * sine, atol=1e-9)
    np.testing.assert_allclose(heading, s**2 / (2 * parameter**2), rtol=1e-12, atol=1e-15)


def test_knots_between_the_rows_cost_no_accuracy() -> None:
    fine, coarse = line_of(CURVY, 0.125), line_of(CURVY, 2.0)
    np.testing.assert_allclose(coarse[:, :4], fine[::16, :4], atol=1e-9)


@pytest.mark.parametrize(
    "wrong", [road(), road((10.0, 0.0), (10.0, 0.1)), road((0.0, 0.0), length=0.0), road((0.0, 0.0), length=float("nan"))]
)
def test_a_road_that_makes_no_line_is_refused(wrong: RoadDesign) -> None:
    with pytest.raises(InvalidInputError, match=r"length|knots"):
        line_of(wrong)
