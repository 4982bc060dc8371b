"""Judgement of a soak: flat or growing."""

import pytest
from tests.benchmarks.soak import Course, verdicts

SECONDS = 4 * 3600.0


def course(*values: float, unit: str = "MB") -> Course:
    """A course of evenly spaced values."""
    made = Course()
    made.values["API", unit] = [(SECONDS * number / len(values), value) for number, value in enumerate(values)]
    return made


@pytest.mark.parametrize(
    ("values", "unit", "verdict"),
    [
        ([300.0] * 100, "MB", "flat"),
        ([300.0 + number % 3 for number in range(100)], "MB", "flat"),
        ([300.0] * 90 + [900.0] * 10, "MB", "flat"),  # a peak
        ([min(200.0 + 5 * number, 300.0) for number in range(100)], "MB", "flat"),  # caches fill
        ([300.0 + number for number in range(100)], "MB", "grows"),
        ([40.0 + number / 10 for number in range(100)], "handles", "grows"),
        ([40.0 + number / 50 for number in range(100)], "handles", "flat"),
    ],
)
def test_only_lasting_growth_is_growth(values: list[float], unit: str, verdict: str) -> None:
    [row] = verdicts(course(*values, unit=unit), SECONDS)
    assert row["verdict"] == verdict


def test_a_slope_is_that_of_an_hour() -> None:
    [row] = verdicts(course(*(300.0 + number for number in range(100))), SECONDS)
    assert row["per_hour"] == pytest.approx(25)
