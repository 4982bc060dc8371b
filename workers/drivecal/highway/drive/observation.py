"""The observation of a controller: names of the signals in the order of the compiled code."""

from drivecal.bundles.highway_catalogue import FAR

NAMES: tuple[str, ...] = (
    "time",
    "speed",
    "own_acceleration",
    "lateral_acceleration",
    "yaw_rate",
    "side_slip",
    "steering_angle",
    "position",
    "lane",
    "lane_offset",
    "heading_error",
    "lane_width",
    "lane_end",
    "route_end",
    "limit",
    "limit_ahead",
    "road_curvature",
    "curvature_1s",
    "curvature_2s",
    "curvature_4s",
    *(
        f"{name}"
        for name in ("gap", "leader_speed", "leader_acceleration", "rear_gap", "follower_speed", "follower_acceleration")
    ),
    *(
        f"{side}_{name}"
        for side in ("left", "right")
        for name in (
            "lane_exists",
            "gap",
            "leader_speed",
            "leader_acceleration",
            "rear_gap",
            "follower_speed",
            "follower_acceleration",
        )
    ),
    "leader_exists",
    "relative_speed",
)
"""Names of `geometry.observe`'s signals."""
FRAMED = 40
"""Signals, from the first on, in the binary frames of a program that names none: programs may have been compiled for that many."""
SPEED, LIMIT_AHEAD, GAP, LEADER_SPEED = (NAMES.index(name) for name in ("speed", "limit_ahead", "gap", "leader_speed"))

TIME_HEADWAY, STANDSTILL_GAP, ACCELERATION, DECELERATION = 1.5, 2.0, 1.5, 2.0
"""The built-in speed keeper: the intelligent driver model (Treiber et al. 2000) with these values and the limit ahead as desired speed."""


def keeper_acceleration(signals: "memoryview[float] | list[float]") -> float:
    """Returns the acceleration (m/s²) of the built-in speed keeper, for controllers that do not output one."""
    speed, limit, gap = signals[SPEED], max(signals[LIMIT_AHEAD], 1.0), max(signals[GAP], 0.1)
    free = 1.0 - (speed / limit) ** 4
    wanted = STANDSTILL_GAP + max(
        0.0, speed * TIME_HEADWAY + speed * (speed - signals[LEADER_SPEED]) / (2.0 * (ACCELERATION * DECELERATION) ** 0.5)
    )
    return ACCELERATION * (free - (wanted / gap) ** 2 if gap < FAR else free)
