"""A car follows another one at a time gap that depends on its speed and on how fast it comes closer."""

from bisect import bisect_right
from math import sqrt

X = [0, 5, 10, 15, 20, 25, 30, 35]
Y = [-4, -2, -1, 0, 1, 2, 4, 8]
"""Support points of the map as in problem.yaml: speed and closing speed, m/s."""
DT = 0.05
STANDSTILL = 3.0
"""Gap to a standing vehicle, m."""


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


def evaluate(parameters: dict, scenario: dict) -> dict:
    """Returns the measures of 40 s behind a vehicle whose speed is linear between the given times."""
    times, speeds = zip(*scenario["lead"], strict=True)
    speed = scenario["speed"]
    gap = STANDSTILL + 1.6 * speed
    acceleration = squares = gaps = 0.0
    least, peak, steps = 9.0, 0.0, round(times[-1] / DT)
    for step in range(steps):
        at, share = place(list(times), step * DT)
        lead = (1 - share) * speeds[at] + share * speeds[at + 1]
        wanted = STANDSTILL + speed * looked_up(parameters["headway"], speed, speed - lead)
        command = 0.25 * (gap - wanted) + 0.9 * (lead - speed)
        acceleration += DT / 0.4 * (min(2.0, max(-8.0, command)) - acceleration)
        speed = max(0.0, speed + acceleration * DT)
        gap += (lead - speed) * DT
        if gap <= 0:
            return {"failure": "collision", "measures": {}}
        time_gap = (gap - STANDSTILL) / max(speed, 1.0)
        least, peak = min(least, time_gap), max(peak, -acceleration)
        squares, gaps = squares + acceleration**2, gaps + time_gap
    return {
        "least_gap_s": least,
        "mean_gap_s": gaps / steps,
        "rms_acceleration": sqrt(squares / steps),
        "peak_deceleration": peak,
    }
