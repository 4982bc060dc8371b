"""Units by name of what the simulator `highway` observes, takes, measures and records; `highway.md` has the meanings and their sources."""

from collections.abc import Mapping
from types import MappingProxyType

FAILURES = ("collision", "off_road", "unstable")
"""Failures of the controlled vehicle: it hits another one, leaves its road's lanes by more than 0.5 m, or exceeds 9.81 m/s² sideways."""
FAR = 1000.0
"""Gap (m) that is observed without a vehicle, and the reach of all observations of other vehicles."""
LONGEST = 100.0
"""Largest time to collision and time headway (s), also the value of a run without a leader."""


COMMANDS: Mapping[str, str] = MappingProxyType({"acceleration": "m/s²", "curvature": "1/m", "steering": "rad"})
"""Outputs of a controller: acceleration, and curvature or steering."""
PLANNER_PARAMETERS = tuple(f"P{number}" for number in range(1, 12))
"""Parameters of the built-in planner."""

_OWN = {
    "time": "s",
    "speed": "m/s",
    "own_acceleration": "m/s²",
    "lateral_acceleration": "m/s²",
    "yaw_rate": "rad/s",
    "side_slip": "rad",
    "steering_angle": "rad",
    "position": "m",
    "lane": "1",
    "lane_offset": "m",
    "heading_error": "rad",
    "lane_width": "m",
    "lane_end": "m",
    "route_end": "m",
    "limit": "m/s",
    "limit_ahead": "m/s",
    "road_curvature": "1/m",
    "curvature_1s": "1/m",
    "curvature_2s": "1/m",
    "curvature_4s": "1/m",
}
_NEIGHBOURS = {
    "gap": "m",
    "leader_speed": "m/s",
    "leader_acceleration": "m/s²",
    "rear_gap": "m",
    "follower_speed": "m/s",
    "follower_acceleration": "m/s²",
}
_BESIDE = {"lane_exists": "1"} | _NEIGHBOURS
SIGNALS: Mapping[str, str] = MappingProxyType(
    _OWN
    | _NEIGHBOURS
    | {f"{side}_{name}": unit for side in ("left", "right") for name, unit in _BESIDE.items()}
    | {"leader_exists": "1", "relative_speed": "m/s"}
)
"""Observations of a controller in each of its steps, in the order of the loop."""

MEASURES: Mapping[str, str] = MappingProxyType(
    {
        "min_ttc_s": "s",
        "time_exposed_ttc_s": "s",
        "min_headway_s": "s",
        "mean_headway_s": "s",
        "min_gap_m": "m",
        "mean_gap_m": "m",
        "max_drac_mps2": "m/s²",
        "min_rear_ttc_s": "s",
        "duration_s": "s",
        "distance_m": "m",
        "mean_speed_mps": "m/s",
        "progress": "1",
        "max_speed_excess_mps": "m/s",
        "energy_kwh": "kWh",
        "max_acceleration_mps2": "m/s²",
        "max_deceleration_mps2": "m/s²",
        "rms_acceleration_mps2": "m/s²",
        "p95_acceleration_mps2": "m/s²",
        "p95_lateral_acceleration_mps2": "m/s²",
        "max_lateral_acceleration_mps2": "m/s²",
        "rms_jerk_mps3": "m/s³",
        "p95_jerk_mps3": "m/s³",
        "p95_lateral_jerk_mps3": "m/s³",
        "max_lane_offset_m": "m",
        "rms_lane_offset_m": "m",
        "lane_departures": "1",
        "lane_changes": "1",
    }
)
"""Measures of every run, stored whether a manifest declares them or not. Gaps are read after SUMO's steps, accelerations every 0.01 s."""

SERIES: Mapping[str, str] = MappingProxyType(
    {
        "time_s": "s",
        "x_m": "m",
        "y_m": "m",
        "heading_rad": "rad",
        "position_m": "m",
        "offset_m": "m",
        "lane": "1",
        "speed_mps": "m/s",
        "acceleration_mps2": "m/s²",
        "lateral_acceleration_mps2": "m/s²",
        "steering_rad": "rad",
        "limit_mps": "m/s",
        "gap_m": "m",
        "leader_speed_mps": "m/s",
        "rear_gap_m": "m",
        "follower_speed_mps": "m/s",
        "lane_width_m": "m",
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
