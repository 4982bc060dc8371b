"""Traffic before a run: SUMO's flows drive alone until the run's time 0, and vehicles too close to those that start then are removed.

It is simulated before each run. A state that SUMO has written would be there in a tenth of the time, but not always with the same bits:
vehicles with SL2015 go on otherwise each time that they are restored (SUMO 1.28).
"""

from collections.abc import Callable, Sequence

import numpy as np

from drivecal.domain.roads import Floats
from drivecal.highway import sumo
from drivecal.highway.drive.routes import LANE_CHANGE_SECONDS
from drivecal.highway.geometry import hit

STANDING_GAP, HEADWAY, BRAKING, BESIDE = 2.0, 1.0, 3.0, 0.5
"""A vehicle that starts has room: 2 m and 1 s of driving of the vehicle behind, and the way in which that one brakes to the speed of the
one ahead at 3 m/s². A vehicle that is less than 0.5 m beside its way has to leave it."""


def drive_alone(steps: int, instruct: Callable[[str, float], None]) -> None:
    """Simulates the traffic, just loaded, until time 0. Raises one of `sumo.SUMO_ERRORS`.

    `instruct`: tells a vehicle that enters, at a speed (m/s), what it may do.
    """
    for _ in range(steps):
        sumo.STEP()
        if sumo.DEPARTED():
            for name in sumo.simulation.getDepartedIDList():
                instruct(name, sumo.GET_SPEED(name))


def too_close(
    others: Floats, outlines: Floats, starting: int, ego: Floats, outline: Floats, sideways: Sequence[float]
) -> list[int]:
    """Returns the rows of the vehicles that leave no room for one that starts: the first `starting` rows, and the ego vehicle.

    `others`, `outlines`: as in `drive.geometry`; `ego`, `outline`: rows of the ego vehicle of the same form, shape (6,); `sideways`: speeds
    to the left (m/s) of all rows. A vehicle that changes lanes is in the way at all places that it reaches until the change is done.
    """
    starts, rectangles = np.vstack([others[:starting], ego]), np.vstack([outlines[:starting], outline])
    return [
        row
        for row in range(starting, len(others))
        if hit(rectangles, outlines[row, :3], outlines[row, 3:5]) >= 0 or _hinders(others[row], starts, sideways[row])
    ]


def _hinders(vehicle: Floats, starts: Floats, sideways: float) -> bool:
    """Returns whether a vehicle is too close to one that starts, all as in `others`. NaN, on another level, hinders nothing."""
    way = LANE_CHANGE_SECONDS * (sideways if vehicle[2] >= 0.0 else -sideways)  # to the left of the route
    right, left = vehicle[1] + min(way, 0.0), vehicle[1] + max(way, 0.0)
    beside = np.maximum(right - starts[:, 1], starts[:, 1] - left).clip(0.0) - 0.5 * (starts[:, 5] + vehicle[5])
    gap = np.abs(starts[:, 0] - vehicle[0]) - 0.5 * (starts[:, 4] + vehicle[4])
    is_behind = vehicle[0] < starts[:, 0]
    rear, front = np.where(is_behind, vehicle[2], starts[:, 2]), np.where(is_behind, starts[:, 2], vehicle[2])
    needed = STANDING_GAP + HEADWAY * np.maximum(rear, 0.0) + np.maximum(rear - front, 0.0) ** 2 / (2.0 * BRAKING)
    return bool(np.any((beside < BESIDE) & (gap < needed)))
