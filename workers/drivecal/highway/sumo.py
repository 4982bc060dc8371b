"""SUMO in this process. The only module that imports libsumo, whose simulation is global: a process runs one at a time.

`GET_POSITION` and the like are the compiled functions behind `libsumo`, without its Python wrappers, which take a third of a call: a run
has thousands. The namespaces `vehicle`, `edge`, `lane` and `simulation` are libsumo's own, for everything else.
"""

import os
import re
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from typing import Any, NamedTuple

from drivecal.domain.errors import UnavailableError

try:
    import libsumo
    from libsumo import _libsumo as compiled
except ImportError as error:
    raise UnavailableError(f"the SUMO simulator cannot be used: {error}; install libsumo") from error

vehicle, edge, lane, simulation = libsumo.vehicle, libsumo.edge, libsumo.lane, libsumo.simulation
GET_POSITION, GET_SPEED = compiled.vehicle_getPosition, compiled.vehicle_getSpeed
GET_ANGLE, GET_ROAD = compiled.vehicle_getAngle, compiled.vehicle_getRoadID
GET_LANE_POSITION = compiled.vehicle_getLanePosition
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
ABSENT = "authority"
"""SUMO's class of police cars and the like, which no vehicle here has."""
MOST_MESSAGES = 3
"""Messages of SUMO in an error; the first names the cause."""
MOST_WRITTEN = 1 << 16
"""Bytes of SUMO's messages among which its errors are searched: a damaged network can give one for each line."""
QUICK_SECONDS = 3.0
"""Longest refused load that is repeated: a start has at most 60 s, and `simulator.timeout` may be less."""
WITHOUT_CAUSE = "Process Error"
"""SUMO's exception if only its messages name the cause."""
_ERROR = re.compile(r"^Error: (.*(?:\n +.*)*)", re.MULTILINE)
_FOLDER = re.compile(r"'[^'\n]*/([^'/\n]+)'")


class Start(NamedTuple):
    """A vehicle at its start: id, also of its type; route; lane; position of the front along it (m); speed (m/s); offset from the lane's
    centre (m, left positive)."""

    name: str
    route: str
    lane: str
    position: float
    speed: float
    offset: float = 0.0


def options(network: str, route_file: str, step: float, seed: int) -> list[str]:
    """Returns the command line options that all simulations share. `step`: seconds.

    SUMO does not look for collisions and teleports no vehicles: drivecal checks the ego vehicle's collisions itself.
    """
    values = {
        "net-file": network,
        "route-files": route_file,
        "step-length": repr(step),
        "seed": str(seed),
        "collision.action": "none",
        "time-to-teleport": "-1",
        "no-step-log": "true",
        "no-warnings": "true",
        "duration-log.disable": "true",
        "xml-validation": "never",
        "xml-validation.net": "never",
        "xml-validation.routes": "never",
    }
    return [text for name, value in values.items() for text in (f"--{name}", value)]


_loads = count(1)
_current = 0


def load(arguments: Sequence[str]) -> int:
    """Starts SUMO, or loads it again if it runs already; returns the number of this load.

    Raises one of `SUMO_ERRORS`, with SUMO's own words, if it refuses its files. SUMO writes most of them to standard error only. They stay
    there, where they also name the cause of a crash or hang; what is refused within `QUICK_SECONDS` is loaded once more for them.
    """
    global _current  # noqa: PLW0603  # a process holds one simulation, too
    _current = next(_loads)
    start = time.monotonic()
    try:
        _load(arguments)
    except SUMO_ERRORS as refusal:
        if (seconds := time.monotonic() - start) > QUICK_SECONDS:
            hint = f"SUMO refused its files after {seconds:.0f} s; `sumo -n NETWORK -r ROUTES` prints all its messages"
            raise type(refusal)(f"{_shown(str(refusal))} ({hint})") from refusal
        said: list[str] = []
        try:
            with _errors(said):
                _load(arguments)
        except SUMO_ERRORS as error:
            own = [] if str(error) == WITHOUT_CAUSE and said else [_shown(str(error))]
            raise type(error)("; ".join(dict.fromkeys(own + said[:MOST_MESSAGES]))) from error
    return _current


def _load(arguments: Sequence[str]) -> None:
    if libsumo.isLoaded():
        libsumo.load(list(arguments))
    else:
        libsumo.start(["sumo", *arguments])


@contextmanager
def _errors(said: list[str]) -> Iterator[None]:
    """Adds the different errors to `said` that SUMO writes to the descriptor of standard error meanwhile. What other threads write in this
    time goes to standard error afterwards."""
    own = os.dup(2)
    with tempfile.TemporaryFile() as written:
        os.dup2(written.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(own, 2)
            os.close(own)
            written.seek(0)
            text = written.read(MOST_WRITTEN).decode(errors="replace")
            said += dict.fromkeys(map(_shown, _ERROR.findall(text)))
            sys.stderr.write(_ERROR.sub("", text).lstrip("\n"))


def _shown(message: str) -> str:
    """Returns a message of SUMO as one line, without the folders of files."""
    return _FOLDER.sub(r"'\1'", " ".join(message.split()))


def is_current(load: int) -> bool:
    """Returns whether SUMO still runs as of this load: the process's other simulator may have loaded another network since."""
    return load == _current and bool(libsumo.isLoaded())


def forbid_lane_changes() -> None:
    """Forbids lane changes on all lanes; `moveTo` goes on to change them.

    SUMO asks its lane change model for the wish of any vehicle that a lane allows to change, even if its lane change mode forbids all
    changes: half of a step's time, and vehicles brake for wishes (decision 052).
    """
    for name in lane.getIDList():
        for direction in (libsumo.LANECHANGE_LEFT, libsumo.LANECHANGE_RIGHT):
            lane.setChangePermissions(name, [ABSENT], direction)


def clear() -> None:
    """Removes all vehicles."""
    for name in vehicle.getLoadedIDList():
        vehicle.remove(name)


def place(starts: Sequence[Start]) -> list[str]:
    """Adds vehicles, the ego vehicle's speed and lane free of SUMO's models.

    Returns vehicles that SUMO left out, which it does not report.
    """
    for name, route, lane_id, position, speed, offset in starts:
        vehicle.add(name, route, typeID=name)
        vehicle.moveTo(name, lane_id, position)
        vehicle.setPreviousSpeed(name, speed)
        if offset:
            vehicle.setLateralLanePosition(name, offset)
    vehicle.setLaneChangeMode(EGO, NO_LANE_CHANGES)
    vehicle.setSpeedMode(EGO, FREE)
    return sorted({start.name for start in starts} - set(vehicle.getIDList()))


def positions(names: Sequence[str], xs: Any, ys: Any) -> None:
    """Writes x and y (m) of each vehicle's front to memoryviews, which assign single items several times faster than numpy."""
    position = GET_POSITION
    for row, name in enumerate(names):
        xs[row], ys[row] = position(name)
