"""The simulator `highway` in a manifest: a controlled vehicle in SUMO's traffic on a road network of the bundle.

`HighwaySimulator` is the section `simulator`; `HighwayScenario` is the data of a scenario. `highway_checks` checks the whole.
"""

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, StringConstraints, Tag

from drivecal.bundles.simulators import Command, File, SimulatorEntry
from drivecal.contracts.specification import Identifier, Model

CommandName = Literal["acceleration", "curvature", "steering"]
Outputs = Annotated[list[CommandName], Field(min_length=1, max_length=2)]
SignalName = Annotated[str, StringConstraints(min_length=1, max_length=64)]
Edge = Annotated[str, StringConstraints(min_length=1, max_length=255, pattern=r"^[^\s\x00-\x1f\x7f]+$")]
"""Id of an edge of the network."""
Route = Annotated[list[Edge], Field(min_length=1, max_length=10_000)]
VehicleId = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_-]+$")]
Lane = Annotated[int, Field(ge=0, le=30)]
"""Index of a lane as in SUMO: 0 is the rightmost."""
Position = Annotated[float, Field(ge=0, le=1e6)]
Speed = Annotated[float, Field(ge=0, le=100)]
Seconds = Annotated[float, Field(ge=0, le=100_000)]
Metres = Annotated[float, Field(gt=0, le=50)]
Positive = Annotated[float, Field(gt=0, le=1e6)]
Seed = Annotated[int, Field(ge=0, le=2**31 - 1)]


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
    """A program that answers a frame of commands for each frame of `signals`, started once per worker and scenario.

    `frames`: `json`, a JSON object per line, or `binary`, doubles in the machine's byte order.
    """

    kind: Literal["process"]
    command: Command
    signals: Annotated[list[SignalName], Field(min_length=1, max_length=100)] | None = None
    frames: Literal["json", "binary"] = "json"


class FmuController(ControllerEntry):
    """An FMI 2 or 3 co-simulation FMU. `signals`: its variable for each observed signal and each command; parameters have its own names."""

    kind: Literal["fmu"]
    file: File
    signals: Annotated[dict[SignalName, Annotated[str, StringConstraints(min_length=1, max_length=255)]], Field(max_length=200)]


AnyController = Annotated[PythonController | ProcessController | FmuController, Field(discriminator="kind")]


class VehicleEntry(Model):
    """The controlled vehicle: the single-track model, with other values than those of Table 8."""

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


def _form(value: object) -> str:
    return "values" if isinstance(value, (dict, VehicleEntry)) else "name"


class HighwaySimulator(SimulatorEntry):
    """A controlled vehicle among SUMO's vehicles. `step`: of the traffic (s), a multiple of 0.01; longer ones would miss collisions."""

    kind: Literal["highway"]
    controller: AnyController
    vehicle: Annotated[
        Annotated[Literal["single_track"], Tag("name")] | Annotated[VehicleEntry, Tag("values")], Discriminator(_form)
    ] = "single_track"
    step: Annotated[float, Field(ge=0.01, le=0.5)] = 0.1


class Placed(Model):
    """A vehicle's place and speed at its start.

    `s`: of its centre (m), along `edge`, or along the scenario's route if no edge is given. `lane`: as in SUMO, of the edge there.
    """

    lane: Lane = 0
    s: Position
    speed: Speed
    edge: Edge | None = None


class Ego(Placed):
    """The controlled vehicle's start and size."""

    length: Metres = 4.7
    width: Metres = 1.9


class Driver(Model):
    """Driver of a vehicle or flow of the traffic; missing fields have SUMO's defaults, without randomness.

    `constant` keeps its speed whatever happens. `desired_speed` (m/s) holds whatever the limit is; without it, a vehicle wants the lane's
    limit times `speed_factor`. `parameters`: further numeric attributes of SUMO's vehicle type, e.g. `lcAssertive`.
    """

    model: Literal["IDM", "Krauss", "EIDM", "ACC", "CACC", "W99", "constant"] = "IDM"
    lane_change: Literal["none", "LC2013", "SL2015"] = "none"
    vehicle_class: Literal["passenger", "truck", "trailer", "bus", "coach", "delivery", "motorcycle"] = "passenger"
    length: Metres = 4.7
    width: Metres = 1.9
    route: Route | None = None
    desired_speed: Annotated[float, Field(gt=0, le=100)] | None = None
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


class Trigger(Model):
    """Begin of an action: at a `time` (s), or when the ego vehicle is within `gap` (m, between bumpers), or at `s` (m) of the
    scenario's route.
    """

    time: Seconds | None = None
    gap: Annotated[float, Field(ge=0, le=1000)] | None = None
    s: Position | None = None


class Brake(Trigger):
    """The vehicle brakes, or accelerates, to `speed` at `rate` (m/s²), and holds it for `hold` seconds, by default to the end."""

    do: Literal["brake"]
    speed: Speed = 0.0
    rate: Annotated[float, Field(gt=0, le=20)] = 4.0
    hold: Seconds | None = None


class CutIn(Trigger):
    """The vehicle changes to `lane` of its edge in `seconds`, whatever the gap."""

    do: Literal["cut_in"]
    lane: Lane
    seconds: Annotated[float, Field(gt=0, le=60)] = 3.0


class Drift(Trigger):
    """The vehicle drifts to `offset` (m, to the left of its lane's centre) in `seconds`."""

    do: Literal["drift"]
    offset: Annotated[float, Field(ge=-5, le=5)]
    seconds: Annotated[float, Field(gt=0, le=600)] = 3.0


Action = Annotated[Brake | CutIn | Drift, Field(discriminator="do")]


class TrafficEntry(Placed, Driver):
    """A vehicle that exists from the start. `id`: by default `vehicle0` and so on."""

    id: VehicleId | None = None
    actions: Annotated[list[Action], Field(max_length=50, default_factory=list)]


class FlowEntry(Driver):
    """Vehicles that enter at the begin of `edge`, by default of the scenario's route: `per_hour`, evenly, from `begin` to `end` (s).

    `random`: they come at random with this mean, as the seed decides.
    """

    id: VehicleId | None = None
    edge: Edge | None = None
    lane: Lane = 0
    speed: Speed | None = None
    per_hour: Annotated[float, Field(gt=0, le=10_000)]
    begin: Seconds = 0.0
    end: Seconds | None = None
    random: bool = False


class HighwayScenario(Model):
    """The data of a scenario. `network`: a SUMO network or OpenDRIVE file of the bundle; `route`: its edges, in the order of the drive."""

    network: File
    route: Route
    duration: Annotated[float, Field(gt=0, le=3600)]
    ego: Ego
    traffic: Annotated[list[TrafficEntry], Field(max_length=500, default_factory=list)]
    flows: Annotated[list[FlowEntry], Field(max_length=100, default_factory=list)]
    seed: Seed = 1
    data: Annotated[dict[Identifier, Any], Field(default_factory=dict)]
