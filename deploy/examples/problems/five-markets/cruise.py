"""A cruise control behind another car."""

from math import cos, pi, sqrt

DT = 0.05
LAG = 0.35
"""Lag of the drive with 1,600 kg, s: it grows with the mass."""


def evaluate(parameters: dict, scenario: dict) -> dict:
    """Returns the measures of a minute, or `{"failure": ...}`."""
    lag = LAG * parameters["mass"] / 1600
    speed = ahead = scenario["speed"]
    gap, acceleration, time = 3.0 + parameters["time_gap"] * speed, 0.0, 0.0
    least, gaps, jerks, hardest = gap, 0.0, 0.0, 0.0
    while time < 60.0:
        if scenario["cut_in"] and abs(time - 20.0) < DT / 2:
            gap = min(gap, scenario["cut_in"])
        braked = scenario["brake"] * max(0.0, 1 - abs(time - 42.0) / 5.0)
        ahead = max(0.0, scenario["speed"] - scenario["swing"] * (1 - cos(2 * pi * time / scenario["period"])) / 2 - braked)
        wanted = parameters["gap_gain"] * (gap - 3.0 - parameters["time_gap"] * speed) + parameters["speed_gain"] * (
            ahead - speed
        )
        wanted = min(2.0, max(-parameters["strongest"], wanted))
        change = (wanted - acceleration) * DT / lag
        acceleration += change
        speed = max(0.0, speed + acceleration * DT)
        gap += (ahead - speed) * DT
        if gap <= 0.0:
            return {"failure": "collision", "measures": {}}
        least, hardest, time = min(least, gap), max(hardest, abs(acceleration)), time + DT
        gaps += DT * gap / max(speed, 3.0)
        jerks += change * change / DT
    return {"least_gap_m": least, "mean_gap_s": gaps / 60.0, "jerk": sqrt(jerks / 60.0), "hardest": hardest}
