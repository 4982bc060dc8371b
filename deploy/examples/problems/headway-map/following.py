"""A car follows another one at a time gap from a map over its speed and its closing speed; the other one may brake at any moment."""

from bisect import bisect_right
from math import sqrt

X = [0, 5, 10, 15, 20, 25, 30, 35]
Y = [-4, -2, -1, 0, 1, 2, 4, 8]
"""Support points of the map as in problem.yaml: speed and closing speed, m/s."""
SPEEDS = [4, 8, 12, 16, 20, 24, 28, 32]
"""Speeds of the operating points, m/s."""
REACTION, BRAKING, BRAKING_AHEAD = 0.6, 6.0, 7.0
"""Reaction time, s, and decelerations of the car and of the vehicle ahead, m/s²."""


def place(axis: list, value: float) -> tuple[int, float]:
    """Returns the support point below a value, and the share of the way to the next one."""
    value = min(max(value, axis[0]), axis[-1])
    lower = min(bisect_right(axis, value), len(axis) - 1) - 1
    return lower, (value - axis[lower]) / (axis[lower + 1] - axis[lower])


def looked_up(values: list, x: float, y: float) -> float:
    """Returns the value of the map, linear between support points."""
    (i, a), (j, b) = place(X, x), place(Y, y)
    near, far = ((1 - b) * values[row][j] + b * values[row][j + 1] for row in (i, i + 1))
    return (1 - a) * near + a * far


def needed(speed: float, closing: float) -> float:
    """Returns the time gap (s) from which both cars can stop without a collision."""
    ahead = max(0.0, speed - closing)
    return max(0.0, REACTION + speed / (2 * BRAKING) - ahead**2 / (2 * BRAKING_AHEAD * speed))


def evaluate(parameters: dict, scenario: dict) -> dict:
    """Returns the mean time gap, which costs room on the road, and the root mean square of what it lacks to stop."""
    points = [(speed, closing) for closing in scenario["closing"] for speed in SPEEDS]
    gaps = [looked_up(parameters["headway"], *point) for point in points]
    lacking = [max(0.0, needed(*point) - gap) for point, gap in zip(points, gaps, strict=True)]
    return {"mean_gap_s": sum(gaps) / len(gaps), "rms_shortfall_s": sqrt(sum(each**2 for each in lacking) / len(lacking))}
