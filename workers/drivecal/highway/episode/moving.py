"""The ego vehicle's part of a step: it follows its trajectory, and its place on the road is found.

One compiled call for the built-in vehicles, because a call costs as much as the geometry; two for vehicles of plug-ins.
"""

from typing import Protocol

from drivecal.domain.roads import Floats
from drivecal.highway import geometry as shared
from drivecal.highway.compilation import compiled_with
from drivecal.highway.traffic import geometry
from drivecal.highway.traffic.geometry import STEP, place
from drivecal.highway.vehicle import equations, kernels
from drivecal.highway.vehicle.kernels import FOLLOWED, TOO_SHORT, UNSTABLE, follow
from drivecal.highway.vehicle.model import SingleTrackModel
from drivecal.plugins.ports import VehicleModel

OFF_ROAD = 3
"""Result of a move, beside those of `kernels.follow`."""


@compiled_with(equations, kernels, shared, geometry)
def _move(
    state: Floats, plant: Floats, controller: Floats, line: Floats, along: Floats, frame: Floats, trajectory: Floats, since: float,
    index: int, motion: Floats, dynamics: Floats, ego: Floats,
) -> int:  # fmt: skip
    samples = len(dynamics) // (len(motion) - 1)
    rows = dynamics[index * samples : (index + 1) * samples]
    status = follow(state, plant, controller, trajectory, since, samples, rows)
    on_road = place(line, along, frame, state, motion[index, 0], motion[index + 1], ego)
    return OFF_ROAD if status == FOLLOWED and not on_road else status


class Mover(Protocol):
    """Moves the ego vehicle through step number `index` along a trajectory, from `since` seconds after its start.

    Returns FOLLOWED, UNSTABLE or OFF_ROAD. Writes `ego` and the step's rows of `motion` and `dynamics`, which are those of `Drive`. Other
    arrays as in `traffic.geometry`. Raises ValueError if the trajectory is too short.
    """

    def __call__(
        self, line: Floats, along: Floats, frame: Floats, trajectory: Floats, since: float, index: int, motion: Floats,
        dynamics: Floats, ego: Floats,
    ) -> int: ...  # fmt: skip


def mover(vehicle: VehicleModel) -> Mover:
    """Returns the mover of a vehicle."""
    if isinstance(vehicle, SingleTrackModel) and type(vehicle).follow is SingleTrackModel.follow:
        return _compiled_mover(vehicle)

    def move(
        line: Floats, along: Floats, frame: Floats, trajectory: Floats, since: float, index: int, motion: Floats, dynamics: Floats,
        ego: Floats,
    ) -> int:  # fmt: skip
        samples = len(dynamics) // (len(motion) - 1)
        rows = dynamics[index * samples : (index + 1) * samples]
        stable = vehicle.follow(trajectory, since, frame.item(STEP), rows)
        on_road = place(line, along, frame, vehicle.pose, motion.item(index, 0), motion[index + 1], ego)
        return (FOLLOWED if on_road else OFF_ROAD) if stable else UNSTABLE

    return move


def _compiled_mover(vehicle: SingleTrackModel) -> Mover:
    state, plant, controller = vehicle.arrays

    def move(
        line: Floats, along: Floats, frame: Floats, trajectory: Floats, since: float, index: int, motion: Floats, dynamics: Floats,
        ego: Floats,
    ) -> int:  # fmt: skip
        status: int = _move(state, plant, controller, line, along, frame, trajectory, since, index, motion, dynamics, ego)
        if status == TOO_SHORT:
            raise ValueError(f"the trajectory does not cover {since} s to {since + frame.item(STEP)} s after its start")
        return status

    return move
