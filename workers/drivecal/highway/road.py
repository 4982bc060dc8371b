"""The corridor of a scenario as the arrays of `geometry`, and places on it."""

from math import atan, cos, sin

import numpy as np

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.roads import Floats, pose_on
from drivecal.roads.corridor import Corridor, LanePiece

SMOOTHING = 5.0
"""Distance (m) to both sides over which the slope of a lane's centre is taken."""


class Road:
    """A corridor with everything that is looked up in each step. Arrays as in `geometry`."""

    def __init__(self, corridor: Corridor) -> None:
        self.corridor = corridor
        line = corridor.line
        self.line: Floats = np.ascontiguousarray(np.column_stack([line, np.cos(line[:, 3]), np.sin(line[:, 3])]))
        self.lanes: Floats = np.ascontiguousarray(
            np.stack([corridor.centres, corridor.widths, corridor.limits, _slopes(line, corridor.centres)], axis=-1)
        )
        self.ends: Floats = np.array([track.end for track in corridor.tracks])
        self.length = float(line[-1, 0])

    def start(self, s: float, d: float) -> tuple[float, float, float]:
        """Returns x, y and heading of a vehicle at (s, d) that drives along its lane."""
        x, y, heading, curvature, _ = pose_on(self.corridor.line, s)
        track = self.corridor.lane_at(s, d)
        row = min(int(s / self.line[1, 0]), len(self.line) - 1)
        slope = 0.0 if track is None else float(np.nan_to_num(self.lanes[row, track, 3]))
        return x - d * sin(heading), y + d * cos(heading), heading + atan(slope / (1.0 - curvature * d))

    def lane_of(self, s: float, lane: int, field: str) -> LanePiece:
        """Returns the piece of a lane at s. Raises InvalidInputError naming `field` if the road has no such lane there."""
        if not 0.0 <= s <= self.length:
            message = f"s = {s:g} m is not on the route, which is {self.length:.1f} m long"
            raise InvalidInputError(Problem(f"{field}.s", message, f"give 0 to {self.length:.1f}"))
        here = [piece for track in self.corridor.tracks for piece in track.lanes if piece.begin <= s <= piece.end]
        plain = [piece for piece in here if not piece.edge.startswith(":")]
        if here and not plain:
            message = f"s = {s:g} m is inside of a junction"
            raise InvalidInputError(Problem(f"{field}.s", message, "move the vehicle by some metres"))
        for piece in plain:
            if piece.index == lane:
                return piece
        known = ", ".join(map(str, sorted({piece.index for piece in plain})))
        message = f"there is no lane {lane} for passenger cars on the route at s = {s:g} m"
        raise InvalidInputError(Problem(f"{field}.lane", message, f"give one of {known}" if known else "give another s"))


def _slopes(line: Floats, centres: Floats) -> Floats:
    """Returns the change of each centre per metre, 0 at rows that have no neighbours."""
    reach = max(1, round(SMOOTHING / line[1, 0]))
    padded = np.pad(centres, ((reach, reach), (0, 0)), mode="edge")
    rise = padded[2 * reach :] - padded[: -2 * reach]
    slopes: Floats = np.where(np.isnan(centres), np.nan, np.nan_to_num(rise / (2 * reach * line[1, 0])))
    return slopes
