"""A follower with a gain curve of eight points over its speed, behind a lead vehicle."""

import math
import random
from typing import Any

STEP = 0.05
SPEEDS = 6.0
"""Distance of the curve's points, m/s."""


def gain(curve: list[float], speed: float) -> float:
    """Returns the curve's value at a speed."""
    point = min(max(int(speed // SPEEDS), 0), 6)
    share = min(max((speed - SPEEDS * point) / SPEEDS, 0), 1)
    return curve[point] + (curve[point + 1] - curve[point]) * share


def lead_speed(scenario: dict[str, Any], time: float) -> float:
    """Returns the speed of the lead vehicle, m/s."""
    speed: float = scenario["v0"]
    change: float = scenario["a"]
    target: float = scenario.get("v1", 0.0)
    if scenario["kind"] == "brake":
        return max(target, speed - change * max(time - 5, 0)) if time > 5 else speed
    if scenario["kind"] == "sine":
        return speed + change * math.sin(0.3 * time)
    return min(target, speed + change * max(time - 3, 0))


def evaluate(parameters: dict[str, Any], scenario: dict[str, Any]) -> dict[str, Any]:
    """Returns the measures of one run, or `{"failure": ...}`."""
    noise = random.Random(1)
    curve = [parameters[f"k{point}"] for point in range(8)]
    headway, damping, filtering = parameters["headway"], parameters["kd"], parameters["tau"]
    strongest, weakest = (1.2, -3.5) if parameters["mode"] == "comfort" else (2.5, -6.0)
    friction, slope = scenario.get("mu", 1.0), scenario.get("slope", 0.0)
    speed = scenario["v0"] + scenario.get("dv", 0)
    gap = 5 + scenario.get("thw", 1.5) * speed
    acceleration = lag = 0.0
    seen_gap, seen_speed = gap, scenario["v0"]
    jerks = errors = energy = peak = time = 0.0
    least_headway, least_ttc, steps = 9.0, 20.0, 0
    while time < scenario.get("T", 40):
        ahead = lead_speed(scenario, time)
        measured_gap = gap + noise.gauss(0, scenario.get("noise", 0.3))
        measured_speed = ahead + noise.gauss(0, 0.15)
        seen_gap += (measured_gap - seen_gap) * STEP / (filtering + STEP)
        seen_speed += (measured_speed - seen_speed) * STEP / (filtering + STEP)
        error = seen_gap - 5 - headway * speed
        wanted = gain(curve, speed) * 0.25 * error + damping * (seen_speed - speed)
        lag += (min(max(wanted, weakest), strongest) - lag) * STEP / 0.25
        reached = min(max(lag - 9.81 * slope * 0.3, -9.81 * friction), 9.81 * friction)
        jerk, acceleration = (reached - acceleration) / STEP, reached
        speed = max(speed + acceleration * STEP, 0)
        gap += (ahead - speed) * STEP
        if gap <= 0:
            return {"failure": "collision", "measures": {}}
        least_headway = min(least_headway, gap / max(speed, 2))
        if speed > ahead:
            least_ttc = min(least_ttc, gap / (speed - ahead))
        jerks += jerk * jerk
        errors += (gap - 5 - 1.4 * speed) ** 2
        energy += max(acceleration, 0) * speed * STEP
        peak = min(peak, acceleration)
        steps += 1
        time += STEP
    return {
        "rms_jerk": math.sqrt(jerks / steps),
        "rms_gap": math.sqrt(errors / steps),
        "min_thw": least_headway,
        "min_ttc": least_ttc,
        "peak_dec": -peak,
        "energy": energy,
    }
