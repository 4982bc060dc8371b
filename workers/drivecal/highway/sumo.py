"""SUMO in this process. The only module that imports libsumo, whose simulation is global: a process runs one at a time.

`GET_POSITION` and the like are the compiled functions behind `libsumo`, without its Python wrappers, which take a third of a call: a run
has thousands. The namespaces `vehicle`, `edge`, `lane` and `simulation` are libsumo's own, for everything else.
"""

from collections.abc import Sequence

from drivecal.domain.errors import UnavailableError

try:
    import libsumo
    from libsumo import _libsumo as compiled
except ImportError as error:
    raise UnavailableError(f"the SUMO simulator cannot be used: {error}; install libsumo") from error

vehicle, edge, lane, simulation = libsumo.vehicle, libsumo.edge, libsumo.lane, libsumo.simulation
GET_POSITION, GET_SPEED = compiled.vehicle_getPosition, compiled.vehicle_getSpeed
GET_ROAD, GET_LANE_POSITION = compiled.vehicle_getRoadID, compiled.vehicle_getLanePosition
MOVE_TO_XY, SET_SPEED = compiled.vehicle_moveToXY, compiled.vehicle_setSpeed
STEP, DEPARTED, ARRIVED = compiled.simulation_step, compiled.simulation_getDepartedNumber, compiled.simulation_getArrivedNumber
SUMO_ERRORS = (libsumo.TraCIException, libsumo.FatalTraCIError)

EGO = "ego"
"""Id and type of the ego vehicle."""
MAPPED_ANYWHERE = 2
"""moveToXY's `keepRoute`: places the vehicle at exactly these coordinates."""
MAPPED_WITHIN = 10.0
"""moveToXY's `matchThreshold` (m): SUMO's search radius for the lane."""
FREE, FREE_BUT_SAFE, MODEL = 0, 1, 31
"""Speed modes: the speed that is set, whatever happens; that speed, but no collision with a leader; the model's speed."""
NO_LANE_CHANGES = 0
"""Lane change mode."""


def options(network: str, route_file: str, step: float, seed: int) -> list[str]:
    """Returns the command line options that all simulations share. `step`: seconds.

    SUMO only warns of collisions and teleports no vehicles: drivecal checks the ego vehicle's collisions itself.
    """
    values = {
        "net-file": network,
        "route-files": route_file,
        "step-length": repr(step),
        "seed": str(seed),
        "collision.action": "warn",
        "time-to-teleport": "-1",
        "no-step-log": "true",
        "no-warnings": "true",
        "duration-log.disable": "true",
        "xml-validation": "never",
        "xml-validation.net": "never",
        "xml-validation.routes": "never",
    }
    return [text for name, value in values.items() for text in (f"--{name}", value)]


def load(arguments: Sequence[str]) -> None:
    """Starts SUMO, or loads it anew if it runs already. Raises one of `SUMO_ERRORS` if it refuses its files."""
    if libsumo.isLoaded():
        libsumo.load(list(arguments))
    else:
        libsumo.start(["sumo", *arguments])
