"""The simulator `highway` in a manifest: a controlled vehicle in SUMO's traffic on a road network of the bundle.

`HighwaySimulator` is the section `simulator`; `HighwayScenario` is the data of a scenario. `highway_checks` checks the whole.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, StringConstraints, Tag, model_validator
from pydantic_core import to_jsonable_python

from drivecal.bundles.highway_actions import Action, Lane, Position, Speed, VehicleId
from drivecal.bundles.simulators import Command, File, SimulatorEntry
from drivecal.contracts.specification import Model
from drivecal.contracts.strict_json import ONE_LINE, Choice, Identifier, Number
from drivecal.domain.roads import Road
from drivecal.domain.setups import canonical_json, digest

CommandName = Literal["acceleration", "curvature", "steering"]
Outputs = Annotated[list[CommandName], Field(min_length=1, max_length=2)]
SignalName = Annotated[str, StringConstraints(min_length=1, max_length=64)]
Edge = Annotated[str, StringConstraints(min_length=1, max_length=255, pattern=r"^[^\s\x00-\x1f\x7f]+$")]
"""Id of an edge of the network."""
Route = Annotated[list[Edge], Field(min_length=1, max_length=10_000)]
SpeedLimit = Annotated[float, Field(ge=0.5, le=150)]
"""Metres per second."""
Duration = Annotated[float, Field(gt=0, le=3600)]
Metres = Annotated[float, Field(gt=0, le=50)]
Variable = Annotated[str, StringConstraints(min_length=1, max_length=255)]
"""Name of a variable of an FMU."""
Constant = (
    Annotated[float, Field(ge=-1e300, le=1e300)]
    | bool
    | Annotated[str, StringConstraints(min_length=1, max_length=255, pattern=ONE_LINE)]
)
"""A value of an FMU's variable, which may be in any unit; its type has closer limits (`bundles.fmus.checks`)."""
Constants = Annotated[dict[Variable, Constant], Field(max_length=200)]
ParameterName = Annotated[str, StringConstraints(min_length=1, max_length=255, pattern=r"^[^\x00-\x1f\x7f]+$")]
Coordinate = Annotated[float, Field(ge=-1e8, le=1e8)]
Seed = Annotated[int, Field(ge=0, le=2**31 - 1)]
CLASSES: Mapping[str, tuple[float, float, float]] = {
    "passenger": (5.0, 1.8, 0.1),
    "truck": (7.1, 2.4, 0.05),
    "trailer": (16.5, 2.55, 0.05),
    "bus": (12.0, 2.5, 0.0),
    "coach": (14.0, 2.6, 0.05),
    "delivery": (6.5, 2.16, 0.05),
    "motorcycle": (2.2, 0.9, 0.1),
}
"""SUMO's length (m), width (m) and speed deviation by class of vehicles."""


class ControllerEntry(Model):
    """Fields of every controller: `output`, the commands that it gives, and its `period` (s), by default the simulator's step."""

    output: Outputs
    period: Annotated[float, Field(gt=0, le=60)] | None = None


class PythonController(ControllerEntry):
    """A function of observation and parameters, or a class made of parameters and scenario for each run, with `step(observation)`."""

    kind: Literal["python"]
    file: File
    function: Identifier = "control"
    wheels: File | None = None


class ProcessController(ControllerEntry):
    """A program that answers a line of commands for each line of `signals`, both JSON, started once per worker and scenario."""

    kind: Literal["process"]
    command: Command
    signals: Annotated[list[SignalName], Field(min_length=1, max_length=100)] | None = None


class FmuController(ControllerEntry):
    """An FMI 2 or 3 co-simulation FMU. Each of its inputs needs a signal, a parameter of the same name, or a constant."""

    kind: Literal["fmu"]
    file: File
    """The FMU."""
    signals: Annotated[dict[SignalName, Variable], Field(max_length=200)]
    """Its variable for each observed signal and each command."""
    constants: Constants | None = None
    """Values of further inputs and parameters, for all runs."""
    reset: bool = True
    """Between runs the FMU is reset; false: each run has a new process, for FMUs whose reset is missing or leaves something."""


class PlannerController(ControllerEntry):
    """The planner of the built-in motorway, or another installed driving function, in scenarios with a task.

    Each of the planner's parameters, P1 to P11, is a parameter of the problem or has a value in `values`.
    """

    kind: Literal["planner"]
    driving_function: Identifier = "frenet"
    output: Annotated[list[CommandName], Field(max_length=0, default_factory=list)]
    values: Annotated[dict[Identifier, Number], Field(default_factory=dict)]


AnyController = Annotated[PythonController | ProcessController | FmuController | PlannerController, Field(discriminator="kind")]


class VehicleEntry(Model):
    """The controlled vehicle: the single-track model with values that replace the paper's."""

    model: Literal["single_track"] = "single_track"
    mass: Annotated[float, Field(ge=300, le=60_000)] | None = None
    cornering_stiffness_front: Annotated[float, Field(ge=1e4, le=1e7)] | None = None
    cornering_stiffness_rear: Annotated[float, Field(ge=1e4, le=1e7)] | None = None
    distance_front: Annotated[float, Field(ge=0.3, le=10)] | None = None
    distance_rear: Annotated[float, Field(ge=0.3, le=10)] | None = None
    yaw_inertia: Annotated[float, Field(ge=100, le=1e6)] | None = None

    @property
    def changes(self) -> dict[str, float]:
        """Values that differ from the nominal ones."""
        return self.model_dump(exclude={"model"}, exclude_none=True)


class HighwaySimulator(SimulatorEntry):
    """A controlled vehicle among SUMO's vehicles. The traffic moves in steps of `step` (s), a multiple of 0.01, evenly within a step."""

    kind: Literal["highway"]
    controller: AnyController
    vehicle: Annotated[
        Annotated[Literal["single_track"], Tag("name")] | Annotated[VehicleEntry, Tag("values")],
        Discriminator(lambda given: "values" if isinstance(given, (dict, VehicleEntry)) else "name"),
    ] = "single_track"
    step: Annotated[float, Field(ge=0.01, le=0.5)] = 0.1

    @property
    def renews(self) -> bool:
        """True if each run has a new process."""
        return not getattr(self.controller, "reset", True)


class Placed(Model):
    """A vehicle's place and speed at its start.

    `s` (m) is the position of its centre along `edge`, or along the scenario's route if `edge` is missing. `lane` is SUMO's index of the
    lane there. `offset` is the distance (m) of its centre from the lane's centre, positive to the left.
    """

    lane: Lane = 0
    s: Position
    speed: Speed
    edge: Edge | None = None
    offset: Annotated[float, Field(ge=-50, le=50)] = 0.0


class Ego(Placed):
    """The controlled vehicle's start and size."""

    length: Metres = 4.7
    width: Metres = 1.9


class TrafficBehaviour(Model):
    """Behaviour of a vehicle of the traffic; missing fields have SUMO's defaults, without randomness.

    A `constant` one always keeps its speed. `desired_speed` (m/s) ignores the speed limit; without it, a vehicle wants the lane's limit
    times `speed_factor`, at most `max_speed`. `length` and `width` default to a passenger car's, or to SUMO's for another `vehicle_class`.
    `parameters` holds further numeric attributes of SUMO's vehicle type, e.g. `lcAssertive`.
    """

    model: Literal["IDM", "Krauss", "EIDM", "ACC", "CACC", "W99", "constant"] = "IDM"
    lane_change: Literal["none", "LC2013", "SL2015"] = "none"
    vehicle_class: Literal["passenger", "truck", "trailer", "bus", "coach", "delivery", "motorcycle"] = "passenger"
    length: Metres = 4.7
    width: Metres = 1.9
    route: Route | None = None
    desired_speed: Annotated[float, Field(gt=0, le=100)] | None = None
    max_speed: Annotated[float, Field(gt=0, le=200)] | None = None
    speed_factor: Annotated[float, Field(gt=0, le=10)] = 1.0
    speed_deviation: Annotated[float, Field(ge=0, le=1)] = 0.0
    time_headway: Annotated[float, Field(gt=0, le=60)] | None = None
    min_gap: Annotated[float, Field(ge=0, le=1000)] | None = None
    acceleration: Annotated[float, Field(gt=0, le=50)] | None = None
    deceleration: Annotated[float, Field(gt=0, le=50)] | None = None
    sigma: Annotated[float, Field(ge=0, le=1)] = 0.0
    parameters: Annotated[
        dict[Identifier, Annotated[float, Field(ge=-1e6, le=1e6)]], Field(max_length=50, default_factory=dict)
    ]

    @model_validator(mode="before")
    @classmethod
    def _sized(cls, data: Any) -> Any:
        """Adds the size of the class of vehicles, if it is missing."""
        vehicle_class = data.get("vehicle_class", "passenger") if isinstance(data, dict) else "passenger"
        if vehicle_class == "passenger" or not isinstance(vehicle_class, str) or vehicle_class not in CLASSES:
            return data
        length, width, _ = CLASSES[vehicle_class]
        return {"length": length, "width": width} | data


class TrafficEntry(Placed, TrafficBehaviour):
    """A vehicle that exists from the start. `id` defaults to `vehicle0` and so on.

    With a `path`, its centre follows these points (x, y, m, in the network's coordinates) instead of a lane, straight on after the last.
    `s` counts along the path. Riders and pedestrians have such paths. Its model is `constant`, and SUMO's vehicles do not see it.
    """

    id: VehicleId | None = None
    path: (
        Annotated[list[Annotated[tuple[Coordinate, Coordinate], Field(strict=False)]], Field(min_length=2, max_length=10_000)]
        | None
    ) = None
    actions: Annotated[list[Action], Field(max_length=50, default_factory=list)]


class Surroundings(Model):
    """The surroundings of the controlled vehicle."""

    routes: File | None = None
    """A SUMO route file (`.rou.xml`), whose vehicles and flows join the others."""
    default_limit: SpeedLimit | None = None
    """The speed limit of lanes for which the OpenDRIVE file has none, m/s; without it, a route over them is refused."""
    begin: Annotated[float, Field(ge=0, le=1e9)] = 0.0
    """The route file's time at the run's time 0, s."""
    warm_up: Annotated[float, Field(ge=0, le=3600)] = 0.0
    """Duration (s) of the traffic before the run's time 0: the route file's vehicles drive alone. Each run simulates it again."""
    traffic: Annotated[list[TrafficEntry], Field(max_length=2000, default_factory=list)]
    seed: Seed = 1
    data: Annotated[dict[Identifier, Any], Field(default_factory=dict)]


class HighwayScenario(Surroundings):
    """The data of a scenario. `network`: a SUMO network or OpenDRIVE file of the bundle; `route`: its edges, in the order of the drive."""

    network: File
    route: Route
    duration: Duration
    ego: Ego
    crossings: bool = False
    """The route may lead over crossings without traffic lights; no vehicle gives way there."""


def _ordered(knots: list[tuple[float, float]]) -> list[tuple[float, float]]:
    for (before, _), (place, _) in pairwise(knots):
        if place < before:
            raise ValueError(f"{place:g} lies before {before:g}; sort the pairs by their first number")
    return knots


IN_ORDER = AfterValidator(_ordered)
Knot = Annotated[tuple[Number, Number], Field(strict=False)]
SpeedFrom = Annotated[tuple[Number, SpeedLimit], Field(strict=False)]


class Task(Model):
    """The task of the planner: to be in the target lane at the desired speed at the end. Lanes count from the right, from 0."""

    start_lane: Lane
    target_lane: Lane
    speeds: Annotated[list[SpeedFrom], Field(min_length=1, max_length=100), IN_ORDER]
    """Pairs of arc length (m), which does not fall, and desired speed (m/s): the speed applies beyond that point of the road."""
    lane_change_after: Annotated[float, Field(ge=0, le=3600)] = 0.0
    """Earliest time (s) at which the vehicle wants the target lane."""
    hold: Annotated[float, Field(gt=0, le=3600)] = 1.0
    """Duration (s) at the end of the run: the tolerances must hold throughout."""
    lane_tolerance: Metres = 0.8
    speed_tolerance: Metres = 2.0


class EgoStart(Model):
    """The planner's vehicle at its start, in Frenet coordinates on the centre line of the rightmost lane.

    Its position is its centre of mass, assumed to be the centre of the outline of `length` times `width` metres.
    """

    s: Position
    d: Number
    speed: Speed
    heading: Annotated[float, Field(ge=-1.5, le=1.5)] = 0.0
    length: Metres = 4.9
    width: Metres = 1.9


FARTHEST = 2.0
"""Standard deviations that a start or a speed of the traffic differs at most."""


class TrafficVehicle(Model):
    """Another vehicle, which keeps its lane by the Intelligent Driver Model, except for its `drift` inside of the lane.

    The seed of a run decides three things that are random, each only if it is not 0, and none by more than `FARTHEST` deviations.
    """

    id: VehicleId
    lane: Lane
    s: Position
    speed: Speed
    desired_speed: Annotated[float, Field(gt=0, le=100)]
    length: Metres = 4.6
    width: Metres = 1.9
    acceleration: Annotated[float, Field(gt=0, le=50)] = 1.5
    deceleration: Annotated[float, Field(gt=0, le=50)] = 3.0
    time_headway: Annotated[float, Field(gt=0, le=60)] = 1.2
    drift: Annotated[list[Knot], Field(max_length=1000, default_factory=list), IN_ORDER]
    """Pairs of time (s), which does not fall, and offset (m, to the left of the lane's centre), linear between."""
    sigma: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Imperfection of SUMO's model of Krauss, which drives the vehicle then: it falls below its speed at random moments."""
    speed_deviation: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """Standard deviation of `speed` and `desired_speed`, as a share of them; two of them are the most."""
    departure_deviation: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Standard deviation (s) of the time at which it passes its start."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """A scenario of a catalogue: a road, its traffic and the task of the ego vehicle.

    Positions are Frenet coordinates on the road's reference line, the centre line of the rightmost lane: s along it, d to its left,
    both in metres. Lane i (0 = rightmost) has its centre at d = i * lane width.
    """

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
    ego: EgoStart
    task: Task
    traffic: tuple[TrafficVehicle, ...] = ()
    seed: int = 1

    @cached_property  # only runs need it
    def road(self) -> Road:
        """The route's road, measured from `network`. Raises InvalidInputError if it is no carriageway."""
        from drivecal.roads.carriageway import carriageway  # scipy takes long to import, and coordinators drive nothing

        return carriageway(self.network, self.route, f"{self.id}.net.xml")

    @cached_property  # a robustness study makes hundreds of setups of each scenario
    def digest(self) -> str:
        """Content hash of everything that decides a run, without the title."""
        document = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "title"}
        return digest(canonical_json(to_jsonable_python(document | {"network": digest(self.network)})).encode())


class TaskScenario(Model):
    """The data of a scenario with a task, which drivecal's planner drives in the worker's own process."""

    title: str = ""
    """For readers."""
    rated_as: Identifier
    """Class of the scenario. Evaluators choose their rating by it."""
    network: File
    route: Route
    duration: Duration
    step: Annotated[float, Field(ge=0.01, le=0.5)] = 0.1
    ego: EgoStart
    task: Task
    traffic: Annotated[list[TrafficVehicle], Field(max_length=2000, default_factory=list)]
    seed: Seed = 1


class OpenScenario(Surroundings):
    """The data of a scenario that an OpenSCENARIO file describes.

    `parameters` has values for its ParameterDeclarations, and `ego` the name of the entity that the controller drives. By default,
    `network` is the file's LogicFile, `route` follows the road of the vehicles, and `duration` is the file's StopTrigger.
    """

    openscenario: File
    parameters: Annotated[dict[ParameterName, Number | bool | Choice], Field(default_factory=dict)]
    ego: Annotated[str, StringConstraints(min_length=1, max_length=255)] = "Ego"
    network: File | None = None
    route: Route | None = None
    duration: Duration | None = None


Described = HighwayScenario | OpenScenario
"""Scenarios for a controller of any kind, which files may complete."""
Declared = Described | TaskScenario
