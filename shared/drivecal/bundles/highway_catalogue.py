"""Quantities that the simulator `highway` observes, takes, measures and records: names, units and meanings."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

FAILURES = ("collision", "off_road", "unstable")
"""Failures of the controlled vehicle: it hits another one, leaves its road's lanes by more than 0.5 m, or exceeds 9.81 m/s² sideways."""
FAR = 1000.0
"""Gap (m) that is observed without a vehicle, and the reach of all observations of other vehicles."""
LONGEST = 100.0
"""Largest time to collision and time headway (s), also the value of a run without a leader."""


class Quantity(NamedTuple):
    """A named quantity. `source` cites its definition if that is not obvious."""

    unit: str
    meaning: str
    source: str = ""


COMMANDS: Mapping[str, Quantity] = MappingProxyType(
    {
        "acceleration": Quantity("m/s²", "acceleration that drive and brakes shall reach, cut off at -9 and 4"),
        "curvature": Quantity("1/m", "curvature of the path, positive to the left; a yaw rate controller steers"),
        "steering": Quantity("rad", "angle of the front wheels, positive to the left, cut off at ±0.5"),
    }
)
"""Outputs of a controller: acceleration, and curvature or steering."""
PLANNER_PARAMETERS = tuple(f"P{number}" for number in range(1, 12))
"""Parameters of the built-in planner."""

_OWN = {
    "time": Quantity("s", "time since the start of the run"),
    "speed": Quantity("m/s", "own speed"),
    "own_acceleration": Quantity("m/s²", "own longitudinal acceleration"),
    "lateral_acceleration": Quantity("m/s²", "own lateral acceleration, positive to the left"),
    "yaw_rate": Quantity("rad/s", "own yaw rate, positive to the left"),
    "side_slip": Quantity("rad", "own side-slip angle: course over ground minus heading"),
    "steering_angle": Quantity("rad", "angle of the front wheels"),
    "position": Quantity("m", "distance along the route, of the centre of mass, from the begin of its first edge"),
    "lane": Quantity("1", "number of the own track, counted from the right, from 0"),
    "lane_offset": Quantity("m", "distance from the lane's centre, positive to the left"),
    "heading_error": Quantity("rad", "own heading minus the direction of the lane"),
    "lane_width": Quantity("m", "width of the own lane"),
    "lane_end": Quantity("m", f"distance to the end of the own lane, at most {FAR:g}"),
    "route_end": Quantity("m", "distance to the end of the route"),
    "limit": Quantity("m/s", "speed limit here"),
    "limit_ahead": Quantity("m/s", "least speed limit of the own lane in the next 3 s of driving, or 50 m"),
    "road_curvature": Quantity("1/m", "curvature of the own lane here, positive to the left"),
    "curvature_1s": Quantity("1/m", "curvature of the own lane at the place reached in 1 s"),
    "curvature_2s": Quantity("1/m", "curvature of the own lane at the place reached in 2 s"),
    "curvature_4s": Quantity("1/m", "curvature of the own lane at the place reached in 4 s"),
}
_OF = {"": "in the own lane", "left_": "in the lane to the left", "right_": "in the lane to the right"}


def _neighbours(prefix: str, place: str) -> dict[str, Quantity]:
    exists = {f"{prefix}lane_exists": Quantity("1", f"1 if there is a lane to the {prefix[:-1]}, else 0")} if prefix else {}
    return exists | {
        f"{prefix}gap": Quantity("m", f"distance from the own front to the rear of the leader {place}; {FAR:g} without one"),
        f"{prefix}leader_speed": Quantity("m/s", f"speed of the leader {place}; the own speed without one"),
        f"{prefix}leader_acceleration": Quantity("m/s²", f"acceleration of the leader {place}; 0 without one"),
        f"{prefix}rear_gap": Quantity(
            "m", f"distance from the own rear to the front of the follower {place}; {FAR:g} without one"
        ),
        f"{prefix}follower_speed": Quantity("m/s", f"speed of the follower {place}; the own speed without one"),
        f"{prefix}follower_acceleration": Quantity("m/s²", f"acceleration of the follower {place}; 0 without one"),
    }


SIGNALS: Mapping[str, Quantity] = MappingProxyType(
    _OWN
    | {name: quantity for prefix, place in _OF.items() for name, quantity in _neighbours(prefix, place).items()}
    | {
        "leader_exists": Quantity("1", f"1 if there is a leader in the own lane, at a gap below {FAR:g} m, else 0"),
        "relative_speed": Quantity("m/s", "speed of the leader in the own lane minus the own speed; 0 without one"),
    }
)
"""Observations of a controller in each of its steps, in the order of the loop."""

OWN_DEFINITION = "own definition"
_TIME_GAP = "ISO 15622, time gap"
_SSM = "Minderhoud and Bovy, Accident Analysis and Prevention 33 (2001)"
MEASURES: Mapping[str, Quantity] = MappingProxyType(
    {
        "min_ttc_s": Quantity("s", f"least gap / closing speed to the leader in the own lane, at most {LONGEST:g}", _SSM),
        "time_exposed_ttc_s": Quantity("s", "time during which the time to collision is below 3 s", _SSM),
        "min_headway_s": Quantity("s", f"least gap / own speed, at most {LONGEST:g}", _TIME_GAP),
        "mean_headway_s": Quantity(
            "s", f"mean of gap / own speed over the time with a leader; {LONGEST:g} without one", _TIME_GAP
        ),
        "min_gap_m": Quantity("m", f"least gap to the leader, at most {FAR:g}", "ISO 15622, clearance"),
        "mean_gap_m": Quantity(
            "m", f"mean gap to the leader over the time with one; {FAR:g} without one", "ISO 15622, clearance"
        ),
        "max_drac_mps2": Quantity(
            "m/s²",
            "largest deceleration that avoids a collision: closing speed² / (2 gap)",
            "Cooper and Ferguson (1976), deceleration rate to avoid a crash",
        ),
        "min_rear_ttc_s": Quantity("s", f"least time to collision of the follower in the own lane, at most {LONGEST:g}", _SSM),
        "duration_s": Quantity(
            "s", "simulated time, which ends early at the end of the route and at a failure", OWN_DEFINITION
        ),
        "distance_m": Quantity("m", "integral of the own speed", OWN_DEFINITION),
        "mean_speed_mps": Quantity("m/s", "distance_m / duration_s", OWN_DEFINITION),
        "progress": Quantity(
            "1", "way along the route over that of a drive at the speed limit for the scenario's whole duration", OWN_DEFINITION
        ),
        "max_speed_excess_mps": Quantity("m/s", "largest own speed above the limit of the lane, at least 0", OWN_DEFINITION),
        "energy_kwh": Quantity(
            "kWh",
            "integral of P/0.9 for P > 0 and 0.6 P for P < 0, P = (1.05 m a + 0.01 m g + 0.39 v²) v: battery electric, level road",
            f"{OWN_DEFINITION}: rolling resistance 0.01, drag area 0.65 m², air 1.2 kg/m³, rotating masses 5 %, drive 90 %,"
            " recuperation 60 %",
        ),
        "max_acceleration_mps2": Quantity("m/s²", "largest longitudinal acceleration, at least 0", OWN_DEFINITION),
        "max_deceleration_mps2": Quantity("m/s²", "largest longitudinal deceleration, at least 0", OWN_DEFINITION),
        "rms_acceleration_mps2": Quantity("m/s²", "root mean square of the longitudinal acceleration", OWN_DEFINITION),
        "p95_acceleration_mps2": Quantity(
            "m/s²", "95th percentile of the longitudinal acceleration's magnitude", OWN_DEFINITION
        ),
        "p95_lateral_acceleration_mps2": Quantity(
            "m/s²", "95th percentile of the lateral acceleration's magnitude", OWN_DEFINITION
        ),
        "max_lateral_acceleration_mps2": Quantity("m/s²", "largest magnitude of the lateral acceleration", OWN_DEFINITION),
        "rms_jerk_mps3": Quantity(
            "m/s³", "root mean square of the longitudinal jerk (a(t) - a(t - 0.5 s)) / 0.5 s", OWN_DEFINITION
        ),
        "p95_jerk_mps3": Quantity("m/s³", "95th percentile of that jerk's magnitude", OWN_DEFINITION),
        "p95_lateral_jerk_mps3": Quantity(
            "m/s³", "95th percentile of the lateral jerk's magnitude, over 0.5 s", OWN_DEFINITION
        ),
        "max_lane_offset_m": Quantity(
            "m", "largest distance from the centre of the lane that holds the vehicle's centre", OWN_DEFINITION
        ),
        "rms_lane_offset_m": Quantity("m", "root mean square of that distance", OWN_DEFINITION),
        "lane_departures": Quantity(
            "1", "number of times that the vehicle's side crosses a marking of the lane that holds its centre", OWN_DEFINITION
        ),
        "lane_changes": Quantity("1", "number of times that the vehicle's centre enters another lane", OWN_DEFINITION),
    }
)
"""Measures of every run, stored whether a manifest declares them or not; each has a source. Gaps are read after each step of the traffic,
accelerations every 0.01 s."""

SERIES: Mapping[str, Quantity] = MappingProxyType(
    {
        "time_s": Quantity("s", "time since the start"),
        "x_m": Quantity("m", "own position in the network's coordinates"),
        "y_m": Quantity("m", "own position in the network's coordinates"),
        "heading_rad": Quantity("rad", "own heading"),
        "position_m": Quantity("m", "distance along the route"),
        "offset_m": Quantity("m", "distance from the lane's centre, positive to the left"),
        "lane": Quantity("1", "number of the own track"),
        "speed_mps": Quantity("m/s", "own speed"),
        "acceleration_mps2": Quantity("m/s²", "own longitudinal acceleration"),
        "lateral_acceleration_mps2": Quantity("m/s²", "own lateral acceleration"),
        "steering_rad": Quantity("rad", "angle of the front wheels"),
        "limit_mps": Quantity("m/s", "speed limit"),
        "gap_m": Quantity("m", f"gap to the leader in the own lane, {FAR:g} without one"),
        "leader_speed_mps": Quantity("m/s", "speed of the leader in the own lane, the own speed without one"),
        "rear_gap_m": Quantity("m", f"gap to the follower in the own lane, {FAR:g} without one"),
        "follower_speed_mps": Quantity("m/s", "speed of the follower in the own lane, the own speed without one"),
        "lane_width_m": Quantity("m", "width of the own lane"),
    }
)
"""Time series that a manifest may declare: a value at the start and after each step of the traffic."""

_MODELS = "accel decel emergencyDecel apparentDecel tau minGap sigma sigmaStep delta stepping startupDelay actionStepLength impatience"
_EIDM = "tpreview tPersDrive tPersEstimate treaction ccoolness sigmaleader sigmagap sigmaerror jerkmax epsilonacc taccmax Mflatness Mbegin"
_ACC = (
    "speedControlGain gapClosingControlGainSpeed gapClosingControlGainSpace gapControlGainSpeed gapControlGainSpace"
    " collisionAvoidanceGainSpeed collisionAvoidanceGainSpace speedControlGainCACC gapClosingControlGainGap gapClosingControlGainGapDot"
    " gapControlGainGap gapControlGainGapDot collisionAvoidanceGainGap collisionAvoidanceGainGapDot tauCACCToACC"
)
_LANE_CHANGES = (
    "lcStrategic lcCooperative lcSpeedGain lcKeepRight lcContRight lcOvertakeRight lcOpposite lcLookaheadLeft lcSpeedGainRight"
    " lcSpeedGainLookahead lcSpeedGainRemainTime lcSpeedGainUrgency lcOvertakeDeltaSpeedFactor lcKeepRightAcceptanceTime"
    " lcCooperativeSpeed lcCooperativeHelpTime lcAssertive lcImpatience lcTimeToImpatience lcSigma lcSublane lcPushy lcPushyGap lcAccelLat"
    " lcMaxSpeedLatStanding lcMaxSpeedLatFactor lcMaxDistLatStanding lcLaneDiscipline lcStrategicLookahead maxSpeedLat minGapLat"
)
TYPE_PARAMETERS = frozenset(
    f"{_MODELS} {_EIDM} {_ACC} {_LANE_CHANGES}".split() + [f"cc{number}" for number in range(1, 10)]  # Wiedemann 99
)
"""Numeric attributes of SUMO's vehicle types that `parameters` of a vehicle may set; SUMO ignores misspelt ones in silence."""
