"""Records of drives for replays: the ego vehicle, and the others near it."""

from collections.abc import Sequence

import numpy as np

from drivecal.contracts.evaluation import ReplayAnswer, ReplayEgo, ReplayVehicle
from drivecal.domain.roads import Floats
from drivecal.highway.drive.measures import Record
from drivecal.highway.drive.replay.surfaces import NeighbouringLane, line_of, route_surface, rows_between, surface_beside
from drivecal.roads.corridor import Corridor

REACH = 250.0
"""Distance (m) from the ego vehicle up to which vehicles and roads are recorded: more than a view shows."""
PERIOD = 0.1
"""Shortest time (s) between two recorded moments."""
MOST_MOMENTS, MOST_POSES = 10_000, 150_000
"""Recorded moments, and poses of other vehicles; longer and fuller runs are recorded at fewer moments."""
LENGTHS, ANGLES = 2, 4
"""Digits of lengths (m) and angles (rad)."""
EGO = ("x_m", "y_m", "heading_rad", "speed_mps", "position_m", "offset_m")


class DriveRecorder:
    """The onlooker of one run."""

    def __init__(self) -> None:
        self._moments: list[tuple[list[str], Floats]] = []
        """Names and outlines of the vehicles near the ego vehicle, at the start and after each step of the traffic."""

    def __call__(self, names: list[str], outlines: Floats, pose: Floats) -> None:
        near = np.flatnonzero(np.hypot(outlines[:, 0] - pose[0], outlines[:, 1] - pose[1]) <= REACH)
        self._moments.append(([names[row] for row in near.tolist()], outlines[near]))

    def replay(
        self, record: Record, length: float, corridor: Corridor, beside: Sequence[NeighbouringLane]
    ) -> ReplayAnswer | None:
        """Returns the run on its roads; None if the vehicle has no place at two moments. `length`: of the ego vehicle (m)."""
        ego = np.column_stack([record.column(name) for name in EGO])
        count = int(np.argmin(np.append(np.isfinite(ego).all(axis=1), False)))  # an unstable vehicle may have no place
        if count < 2:
            return None
        times, ego = record.column("time_s")[:count], ego[:count]
        moments = self._moments[:count]
        if len(moments) < count:  # the run ended within a step of the traffic
            moments = [*moments, _moved_on(*moments[-1], times.item(-1) - times.item(len(moments) - 1))]
        shown = _shown(times, moments)
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
            beside=surface_beside(beside, corridor, rows),
            ego=ReplayEgo(length_m=length, width_m=record.width, **columns),
            others=_vehicles([moments[row] for row in shown]),
        )


def _moved_on(names: list[str], outlines: Floats, seconds: float) -> tuple[list[str], Floats]:
    """Returns vehicles at a later time, straight on at their speeds."""
    moved = outlines.copy()
    ways = seconds * outlines[:, 5]
    moved[:, 0] += ways * np.cos(outlines[:, 2])
    moved[:, 1] += ways * np.sin(outlines[:, 2])
    return names, moved


def _shown(times: Floats, moments: Sequence[tuple[list[str], Floats]]) -> list[int]:
    """Returns the moments of the replay: equally spaced ones, and the last one."""
    poses = sum(len(names) for names, _ in moments)
    every = max(
        1,
        round(PERIOD / (times.item(1) - times.item(0))),
        -(-len(times) // MOST_MOMENTS),
        -(-poses // MOST_POSES),
    )
    return sorted({*range(0, len(times), every), len(times) - 1})


def _vehicles(moments: Sequence[tuple[list[str], Floats]]) -> list[ReplayVehicle]:
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
