"""A car brakes before an obstacle."""


def evaluate(parameters: dict[str, float], scenario: dict[str, float]) -> dict[str, object]:
    """Returns the measures of one run, or a failure of the system under test."""
    gap, speed, deceleration, time, dt = scenario["gap"], scenario["speed"], 0.0, 0.0, 0.01
    braking = False
    while speed > 0:
        braking = braking or gap / speed <= parameters["trigger_ttc"]
        target = parameters["deceleration"] if braking else 0.0
        deceleration += min(target - deceleration, parameters["jerk"] * dt)
        speed -= deceleration * dt
        gap -= max(speed, 0.0) * dt
        time += dt
        if gap <= 0:
            return {"failure": "collision", "measures": {}}
    return {"gap_m": gap, "peak": deceleration, "time_s": time}
