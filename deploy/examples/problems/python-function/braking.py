"""Emergency braking before an obstacle."""

from math import sqrt

DELAYS = {"none": 0.0, "sound": 0.6, "belt": 0.3}
"""Lead of a warning before the system brakes, s; a warned driver brakes gently."""
DT = 0.005
FRAME = 0.05


def evaluate(parameters: dict, scenario: dict) -> dict:
    """Returns the measures of one run, or `{"failure": ...}`."""
    gap, speed, obstacle = scenario["gap"], scenario["speed"], scenario["obstacle"]
    strongest = min(parameters["deceleration"], 9.81 * scenario["friction"])
    lead = DELAYS[parameters["warning"]]
    wait = parameters["confirmations"] * FRAME
    deceleration, critical, braking = 0.0, 0.0, 0.0
    smallest, peak, jerks, time = gap, 0.0, 0.0, 0.0
    while time < 15.0 and speed > obstacle:
        ttc = gap / (speed - obstacle)
        if ttc <= scenario["passing"]:
            break
        critical = critical + DT if critical >= wait or ttc <= parameters["trigger_ttc"] else 0.0
        driver = 2.0 if lead and ttc <= parameters["trigger_ttc"] + lead else 0.0
        wanted = min(strongest, max(driver, strongest if critical >= wait else 0.0))
        change = min(wanted - deceleration, parameters["jerk"] * DT)
        deceleration += change
        jerks += change * change / DT
        braking += DT if deceleration > 0.5 else 0.0
        speed -= deceleration * DT
        gap -= (speed - obstacle) * DT
        smallest, peak, time = min(smallest, gap), max(peak, deceleration), time + DT
        if gap <= 0.0:
            return {"failure": "collision", "measures": {}}
    return {"min_gap_m": smallest, "peak_deceleration": peak, "rms_jerk": sqrt(jerks / max(time, DT)), "braking_s": braking}
