"""The child of simulator kind `highway`: loads the network, SUMO and the controller, and serves runs.

Until it calls `hold`, it may change the compiled kernels that workers execute. So it reads nothing until then that an earlier child of the
session, which ran a user's code, could have left.
"""

import json
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivecal.adapters.driver import Evaluate, described, serve
from drivecal.adapters.pipes import LONGEST_LINE
from drivecal.domain.errors import UnavailableError
from drivecal.plugins import simulators

if TYPE_CHECKING:
    from drivecal.contracts.evaluation import ReplayAnswer

LONGEST_ID = 100
"""Bytes in an answer's line for its id."""


def prepare(settings: Mapping[str, Any]) -> Evaluate:
    """Reads the network and starts SUMO and the controller. Raises UnavailableError if SUMO's version is not that of the settings."""
    # A worker replaces children for days, and libsumo may change meanwhile.
    if (installed := simulators.sumo()) != settings["sumo"]:
        raise UnavailableError(
            f"the library of SUMO was {settings['sumo']} when the worker opened this scenario, and is {installed} in its new process;"
            " install the former again, or restart the server and submit the campaign again"
        )
    from drivecal.bundles.highway import HighwaySimulator, VehicleEntry
    from drivecal.bundles.traffic.description import described_in
    from drivecal.highway.drive.control import CommandControl
    from drivecal.highway.drive.controllers import controller
    from drivecal.highway.drive.loop import Loop
    from drivecal.highway.drive.measures import measures
    from drivecal.highway.drive.rehearsal import hold, rehearse
    from drivecal.highway.drive.replay import DriveRecorder
    from drivecal.highway.drive.road import HighwayRoad
    from drivecal.highway.drive.traffic import Traffic
    from drivecal.highway.vehicle.model import SingleTrackModel
    from drivecal.highway.vehicle.parameters import TABLE_8, SingleTrackParameters
    from drivecal.roads.corridor import corridor, other_levels
    from drivecal.roads.network import network_file, read_network, unlimited

    simulator = HighwaySimulator.model_validate(settings["simulator"])
    folder, scratch, name = Path(settings["folder"]), Path(settings["scratch"]), settings["scenario"]
    description = described_in(folder, settings["data"], simulator.step)
    scenario = description.scenario
    network = folder / network_file(scenario.network)
    roads = read_network(network.read_bytes(), scenario.network)
    route = corridor(roads, scenario.route, scenario.network, scenario.default_limit, crossings=scenario.crossings)
    road = HighwayRoad(route, other_levels(roads, route), unlimited(roads))
    changes = simulator.vehicle.changes if isinstance(simulator.vehicle, VehicleEntry) else {}
    parameters = SingleTrackParameters.of({entry.name: entry.nominal for entry in TABLE_8} | changes)
    # The last message before a crash names its cause: SUMO can die of a damaged network.
    print(f"SUMO loads {scenario.network}", file=sys.stderr, flush=True)  # noqa: T201  # the last message
    traffic = Traffic(name, scenario, network, road, simulator.step, scratch, description.routes)
    vehicle = SingleTrackModel(parameters, parameters)
    rehearse(simulator, traffic, vehicle)
    if settings["changeable"] is not None:
        hold(settings["changeable"], scratch)
    os.chdir(settings["work"])
    print("the controller starts", file=sys.stderr, flush=True)  # noqa: T201  # the last message
    section = simulator.controller.model_dump(mode="json", exclude_none=True)
    checked = controller(section, folder, Path(settings["work"]), scratch, settings["data"], simulator.step)
    control = CommandControl(checked, section.get("period", simulator.step))
    loop = Loop(traffic, vehicle, control)

    def evaluate(request: Mapping[str, Any]) -> Mapping[str, Any]:
        if simulator.random:
            traffic.seed(request["seed"])
        recorder = DriveRecorder(simulator.step) if "series" in request else None
        outcome = loop.run(request["parameters"], watch=recorder)
        values = measures(outcome.record, parameters.mass)
        answer: dict[str, Any] = {"measures": {measure: values[measure] for measure in settings["measures"]}}
        if outcome.failure is not None:
            answer["failure"] = outcome.failure
        if recorder is not None:
            answer["series"] = {name: outcome.record.column(name).tolist() for name in settings["series"]}
            answer |= replay_beside(answer, lambda: recorder.replay(outcome.record, scenario.ego.length, route))
        return answer

    return evaluate


def replay_beside(answer: Mapping[str, Any], make: Callable[[], "ReplayAnswer | None"]) -> dict[str, Any]:
    """Returns the replay of an answer with time series: null if it cannot be made, or if the answer's line would be too long with it.

    `make` may raise ValueError (also of scipy and pydantic), IndexError and ArithmeticError on roads of unusual shapes. Other exceptions
    are faults of drivecal, which the answer should name.
    """
    try:
        replay = make()
    except (ValueError, IndexError, ArithmeticError) as error:
        print(f"the run has no replay: {described(error)}", file=sys.stderr, flush=True)  # noqa: T201  # the worker keeps it
        return {"replay": None}
    kept = {"replay": None if replay is None else replay.model_dump()}
    is_short = len(json.dumps({**answer, **kept})) < LONGEST_LINE - LONGEST_ID
    return kept if is_short else {"replay": None}


def begin(settings: Mapping[str, Any]) -> Evaluate:
    """Prepares the scenario, with the compiled kernels of the machine."""
    if settings["kernels"] is not None:
        os.environ["NUMBA_CACHE_DIR"] = settings["kernels"]
    return prepare(settings)


if __name__ == "__main__":
    os.chdir("/")  # numba reads `.numba_config.yaml` of the working directory, which may name a user's kernels
    serve(begin)
