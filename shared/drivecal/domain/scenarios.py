"""Scenarios: a road, its traffic and the task of the ego vehicle. Pure data; SI units throughout.

Positions are Frenet coordinates on the road's reference line, the centre line of the rightmost lane: s along it, d to its left,
both in metres. Lane i (0 = rightmost) has its centre at d = i * lane width.
"""

from dataclasses import asdict, dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from drivecal.domain.setups import canonical_json, digest


@dataclass(frozen=True, slots=True)
class SpeedKnot:
    """A speed (m/s) that holds from arc length `s` until the next knot."""

    s: float
    speed: float


@dataclass(frozen=True, slots=True, eq=False)
class Road:
    """A motorway carriageway of equal lanes, as its network has it: `drivecal.roads.carriageway` measures it.

    `line`, shape (n, 5): the reference line, as in `domain.roads`; `length` is the length of the route along it.
    """

    line: npt.NDArray[np.float64]
    length: float
    lanes: int
    lane_width: float
    limits: tuple[SpeedKnot, ...] = ()
    """Speed limits, the first at s = 0. The other vehicles obey them."""

    @property
    def right_edge(self) -> float:
        """Offset d of the right boundary."""
        return -0.5 * self.lane_width

    @property
    def left_edge(self) -> float:
        """Offset d of the left boundary."""
        return (self.lanes - 0.5) * self.lane_width


@dataclass(frozen=True, slots=True)
class EgoStart:
    """Start of the ego vehicle: s, d (m), speed (m/s), heading relative to the road (rad), and its outline.

    The ego vehicle's position is its centre of mass, assumed to be the centre of the outline of `length` times `width` metres.
    """

    s: float
    d: float
    speed: float
    heading: float = 0.0
    length: float = 4.9
    width: float = 1.9


@dataclass(frozen=True, slots=True)
class Task:
    """Task of the ego vehicle: to be in the target lane at the desired speed.

    The task is missed unless, over the last `hold` seconds, the ego vehicle stays within `lane_tolerance` metres of the target lane's
    centre and within `speed_tolerance` m/s of the desired speed.
    """

    start_lane: int
    target_lane: int
    speeds: tuple[SpeedKnot, ...]
    """Desired speed along the road; each holds until the next knot."""
    lane_change_after: float = 0.0
    """Time (s) from which the target lane is wanted."""
    hold: float = 1.0
    lane_tolerance: float = 0.8
    speed_tolerance: float = 2.0


@dataclass(frozen=True, slots=True)
class TrafficVehicle:
    """Another vehicle: start of its centre, desired speed, parameters of SUMO's IDM, and drift."""

    id: str
    lane: int
    s: float
    speed: float
    desired_speed: float
    length: float = 4.6
    width: float = 1.9
    acceleration: float = 1.5
    deceleration: float = 3.0
    time_headway: float = 1.2
    drift: tuple[tuple[float, float], ...] = ()
    """Lateral movement inside its lane: (time in s, offset from the lane centre in m), linear between."""
    sigma: float = 0.0
    """Imperfection of SUMO's model of Krauss, which drives it then in the place of the IDM."""
    speed_deviation: float = 0.0
    """Standard deviation of both speeds over seeds, as a share of them."""
    departure_deviation: float = 0.0
    """Standard deviation (s) over seeds of the time at which it passes its start."""


FARTHEST = 2.0
"""Standard deviations that a start or a speed of the traffic differs at most."""


@dataclass(frozen=True)
class Scenario:
    """A scenario of a catalogue."""

    id: str
    title: str
    rated_as: str
    """Class that evaluators rate its runs as; each catalogue has its own."""
    duration: float
    step: float
    network: bytes
    """Content of the SUMO network file."""
    route: tuple[str, ...]
    """Edges of the network that the ego vehicle and the traffic drive, in order."""
    road: Road
    """The route's road, measured from `network`."""
    ego: EgoStart
    task: Task
    traffic: tuple[TrafficVehicle, ...] = ()
    seed: int = 1

    @cached_property  # a robustness study makes hundreds of setups of each scenario
    def digest(self) -> str:
        """Content hash of everything that decides a run: the network's bytes, but not the road, which follows from them, nor the title."""
        document = asdict(self) | {"network": digest(self.network)}
        del document["title"], document["road"]
        document["manoeuvre"] = document.pop("rated_as")  # its name in the digests of stored runs
        for vehicle in document["traffic"]:
            for name in ("sigma", "speed_deviation", "departure_deviation"):
                if not vehicle[name]:  # stored runs have none
                    del vehicle[name]
        return digest(canonical_json(document).encode())
