"""Replays of drives: the ego vehicle, the others near it and its route, in the coordinates of the network."""

from collections.abc import Sequence
from math import ceil

import numpy as np

from drivecal.contracts.evaluation import ReplayAnswer, ReplayEgo, ReplayVehicle
from drivecal.domain.roads import Floats
from drivecal.highway.drive.geometry import moved_on
from drivecal.highway.drive.measures import Record
from drivecal.highway.drive.surfaces import line_of, route_surface, rows_between
from drivecal.highway.drive.traffic import Traffic
from drivecal.roads.corridor import Corridor

REACH = 250.0
"""Distance (m) from the ego vehicle up to which vehicles and roads are recorded: more than a view shows."""
PERIOD = 0.1
"""Shortest time (s) between two recorded moments, but for the last."""
MOST_MOMENTS, MOST_POSES = 10_000, 150_000
"""Limits of the recorded moments and of the poses of other vehicles. Longer and fuller runs are recorded at fewer moments."""
LENGTHS, ANGLES = 2, 4
"""Digits of lengths (m) and angles (rad)."""
Moment = tuple[list[str], Floats]
"""Names and outlines of the vehicles near the ego vehicle."""
EGO = ("x_m", "y_m", "heading_rad", "speed_mps", "position_m", "offset_m")


class DriveRecorder:
    """The watcher of one run, whose memory is bounded."""

    def __init__(self, step: float) -> None:
        """`step`: time (s) between two moments."""
        self._every = max(1, ceil(PERIOD / step - 1e-9))
        """Number of steps between two kept moments. It doubles whenever these reach a limit."""
        self._moments: list[Moment] = []
        """The moments 0, `_every`, 2 `_every`, ... of the start and after each step of the traffic."""
        self._newest: Moment = [], np.zeros((0, 7))
        self._seen = self._poses = 0
        """Number of all moments so far, and of the poses in the kept ones."""

    def __call__(self, traffic: Traffic, pose: Floats, plan: Floats | None) -> None:
        del plan
        names, outlines = traffic.names, traffic.outlines
        near = np.flatnonzero(np.hypot(outlines[:, 0] - pose[0], outlines[:, 1] - pose[1]) <= REACH)
        self._newest = [names[row] for row in near.tolist()], outlines[near]
        if self._seen % self._every == 0:
            self._moments.append(self._newest)
            self._poses += len(near)
            while len(self._moments) > 1 and (len(self._moments) > MOST_MOMENTS or self._poses > MOST_POSES):
                self._every *= 2
                self._moments = self._moments[::2]
                self._poses = sum(len(kept) for kept, _ in self._moments)
        self._seen += 1

    def replay(self, record: Record, length: float, corridor: Corridor) -> ReplayAnswer | None:
        """Returns the run on its route; None if the vehicle has no place at two moments. `length` is the ego vehicle's (m)."""
        ego = np.column_stack([record.column(name) for name in EGO])
        count = int(np.argmin(np.append(np.isfinite(ego).all(axis=1), False)))  # an unstable vehicle may have no place
        if count < 2:
            return None
        times, ego = record.column("time_s")[:count], ego[:count]
        moments = dict(zip(range(0, count, self._every), self._moments, strict=False))
        if self._seen == count:
            moments[count - 1] = self._newest
        elif self._seen < count:  # the run ended within a step of the traffic
            names, outlines = self._newest
            moments[count - 1] = names, moved_on(outlines, times.item(-1) - times.item(self._seen - 1))
        shown = list(moments)
        if len(shown) < 2:
            return None
        position = ego[:, EGO.index("position_m")]
        rows = rows_between(corridor, position.min() - REACH, position.max() + REACH)
        columns = {
            name: ego[shown, place].round(ANGLES if name == "heading_rad" else LENGTHS).tolist()
            for place, name in enumerate(EGO)
        }
        return ReplayAnswer(
            time_s=times[shown].round(ANGLES).tolist(),
            line=line_of(corridor, rows),
            route=route_surface(corridor, rows),
            ego=ReplayEgo(length_m=length, width_m=record.width, **columns),
            others=_vehicles(list(moments.values())),
        )


def _vehicles(moments: Sequence[Moment]) -> list[ReplayVehicle]:
    """Returns each vehicle for each time that it is there without a gap."""
    vehicles: list[ReplayVehicle] = []
    here: dict[str, ReplayVehicle] = {}
    for number, (names, outlines) in enumerate(moments):
        before, here = here, {}
        poses = np.column_stack([outlines[:, :2].round(LENGTHS), outlines[:, 2].round(ANGLES)]).tolist()
        for name, (x, y, heading), (half_length, half_width) in zip(names, poses, outlines[:, 3:5].tolist(), strict=True):
            vehicle = before.get(name)
            if vehicle is None:
                size = {"length_m": 2.0 * half_length, "width_m": 2.0 * half_width}
                vehicle = ReplayVehicle(id=name, first=number, x_m=[], y_m=[], heading_rad=[], **size)
                vehicles.append(vehicle)
            here[name] = vehicle
            vehicle.x_m.append(x)
            vehicle.y_m.append(y)
            vehicle.heading_rad.append(heading)
    return vehicles
