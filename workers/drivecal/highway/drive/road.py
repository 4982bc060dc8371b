"""The corridor of a scenario as the arrays of `geometry`, and places on it."""

from collections.abc import Mapping, Sequence
from math import atan, cos, isnan, sin

import numpy as np

from drivecal.domain.roads import Floats, pose_on
from drivecal.highway.geometry import point, with_directions
from drivecal.highway.traffic.lanes import SumoLanes
from drivecal.roads.corridor import Corridor

SMOOTHING = 5.0
"""Distance (m) to both sides over which the slope of a lane's centre is taken."""


class HighwayRoad:
    """A corridor with everything that is looked up in each step. Arrays as in `geometry`."""

    def __init__(self, corridor: Corridor, levels: Mapping[str, tuple[float, float]], unlimited: Sequence[str] = ()) -> None:
        """`levels`: stretches of edges above or below the corridor (`roads.levels`); `unlimited`: ids of the network's lanes that get the
        scenario's `default_limit` (`roads.limits`)."""
        self.corridor, self.levels, self.unlimited = corridor, levels, unlimited
        line = corridor.line
        self.line: Floats = with_directions(line)
        self.sumo = SumoLanes(corridor, line[:, 0], joined=True)
        self.lanes: Floats = np.ascontiguousarray(
            np.stack(
                [corridor.centres, corridor.widths, corridor.limits, slopes(line, corridor.centres), self.sumo.totals], axis=-1
            )
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

    def lateral(self, s: float, d: float, at: float) -> float:
        """Returns d at another s, `at`, of the centre of the lane that holds (s, d); d itself if there is no lane, or it is not there."""
        track = self.corridor.lane_at(s, d)
        if track is None:
            return d
        row = min(max(int(at / self.line[1, 0]), 0), len(self.line) - 1)
        centre = float(self.lanes[row, track, 0])
        return d if isnan(centre) else centre

    def stretch(self, s: float, d: float) -> float:
        """Returns metres of a way through (s, d) along the road per metre of s; 1 without a place."""
        return 1.0 if isnan(s) else max(1.0 - float(point(self.line, s)[3]) * d, 0.1)


def slopes(line: Floats, centres: Floats) -> Floats:
    """Returns the change of each centre per metre, over the rows to both sides that exist; 0 at a row without neighbours."""
    spacing = line[1, 0]
    reach = max(1, round(SMOOTHING / spacing))
    result: Floats = np.full(centres.shape, np.nan)
    for track, centre in enumerate(centres.T):
        rows = np.flatnonzero(~np.isnan(centre))
        if not len(rows):
            continue
        before, after = np.maximum(rows - reach, rows[0]), np.minimum(rows + reach, rows[-1])
        result[rows, track] = (centre[after] - centre[before]) / (np.maximum(after - before, 1) * spacing)
    return result
