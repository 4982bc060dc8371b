"""Rows of reference lines, and what lies between them."""

from math import cos, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.roads import CurvatureKnot, RoadDesign, line_of
from tests.support.values import faults_of

from drivecal.domain.roads import Road, pose_on, reference_line, resampled

KNOTS = ((100.0, 0.0), (180.3, 1 / 250), (260.1, 1 / 250), (333.3, -1 / 180), (600.0, -1 / 180))
CURVY = RoadDesign(600.0, 2, 3.75, tuple(CurvatureKnot(s, curvature) for s, curvature in KNOTS))
LINE = line_of(CURVY)


def test_rows_at_other_distances_are_on_the_same_line() -> None:
    fine, coarse = line_of(CURVY, 0.1), resampled(line_of(CURVY, 0.5), CURVY.length, 4.0)
    assert coarse[-1, 0] == 600.0
    np.testing.assert_allclose(coarse[:, :3], fine[::40, :3], atol=1e-5)
    np.testing.assert_allclose(np.diff(coarse[:, 3]), 4.0 * 0.5 * (coarse[1:, 4] + coarse[:-1, 4]))


def test_a_line_with_the_rows_wanted_stays_what_it_is() -> None:
    assert resampled(LINE, CURVY.length, 0.5) is LINE
    assert reference_line(Road(LINE, CURVY.length, 2, 3.75)) is LINE


@pytest.mark.parametrize(("length", "spacing"), [(0.0, 0.5), (float("nan"), 0.5), (600.0, 0.0)])
def test_a_line_without_length_or_rows_is_refused(length: float, spacing: float) -> None:
    assert [problem.field for problem in faults_of(resampled, LINE, length, spacing)] == ["road.length"]


@given(st.floats(0.0, 600.0))
def test_the_line_between_its_rows_follows_the_finer_line(s: float) -> None:
    coarse, fine = line_of(CURVY, 0.5), line_of(CURVY, 0.01)
    x, y, heading, curvature, _ = pose_on(coarse, s)
    row = round(s / 0.01)
    shift = s - fine[row, 0]
    # between rows 0.5 m apart the heading is off by up to 0.5**2 / 8 times the curvature's slope
    assert x == pytest.approx(fine[row, 1] + shift * cos(fine[row, 3]), abs=5e-6)
    assert y == pytest.approx(fine[row, 2] + shift * sin(fine[row, 3]), abs=5e-6)
    assert heading == pytest.approx(fine[row, 3] + shift * fine[row, 4], abs=5e-6)
    assert curvature == pytest.approx(fine[row, 4], abs=2e-5)
