"""A car stops before a line, with a deceleration that depends on its speed."""

import numpy as np

AXIS = [0, 3, 6, 12, 20, 30]
"""Support points of the curve, m/s, as in problem.yaml."""
DT = 0.01


def evaluate(parameters: dict, scenario: dict) -> dict:
    """Returns the measures of a stop. The jolt is the deceleration that ends at once when the car stands."""
    speed, left, deceleration = scenario["speed"], scenario["distance"], 0.0
    peak = time = 0.0
    while speed > 0:
        wanted = float(np.interp(speed, AXIS, parameters["deceleration"]))
        change = parameters["jerk"] * DT
        deceleration += min(change, max(-change, wanted - deceleration))
        speed, left, time = speed - deceleration * DT, left - speed * DT, time + DT
        peak = max(peak, deceleration)
        if left < 0:
            return {"failure": "crossed", "measures": {}}
    return {"peak": peak, "jolt": deceleration, "time_s": time, "left_m": left}
