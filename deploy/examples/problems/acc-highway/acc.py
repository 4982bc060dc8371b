"""An adaptive cruise control that gives accelerations only; drivecal's lane keeper steers."""


def accelerate(observation: dict, parameters: dict) -> float:
    """Returns the acceleration (m/s²): the smaller of what keeps the set speed and what keeps the time gap."""
    speed, gap = observation["speed"], observation["gap"]
    cruise = parameters["speed_gain"] * (parameters["set_speed"] - speed)
    wanted = 4.0 + parameters["time_gap"] * speed
    closing = observation["leader_speed"] - speed
    follow = parameters["gap_gain"] * (gap - wanted) + parameters["closing_gain"] * closing
    if gap < 200.0:
        cruise = min(cruise, follow)
    return min(max(cruise, -parameters["strongest_braking"]), 2.0)
