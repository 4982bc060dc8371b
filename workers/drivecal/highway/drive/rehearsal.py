"""A run of drivecal's own code before a user's is loaded. Kernels are compiled and stored until then, and stay as they are afterwards.

A worker and its later sessions run what is stored: a controller that could change it would run as the worker, or answer for others.
"""

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numba

from drivecal.adapters.confinement import confine, ruleset
from drivecal.bundles.highway import HighwaySimulator
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.highway.drive.control import CommandControl
from drivecal.highway.drive.controllers import Checked, ControllerError, FunctionController
from drivecal.highway.drive.loop import Loop
from drivecal.highway.drive.measures import measures
from drivecal.highway.drive.traffic import Traffic, TrafficError
from drivecal.highway.vehicle.model import SingleTrackModel


def rehearse(simulator: HighwaySimulator, traffic: Traffic, model: SingleTrackModel) -> None:
    """Drives the scenario once without the user's code and the warm-up, straight on.

    Raises InvalidInputError and TrafficError.
    """
    controller = simulator.controller
    period = simulator.step if controller.period is None else controller.period
    straight = FunctionController(lambda *_: [0.0] * len(controller.output), controller.output, {})
    loop = Loop(traffic, model, CommandControl(Checked(straight, controller.output), period))
    loop.prepare()
    with suppress(ControllerError, TrafficError):  # the user's run tells of what is wrong
        measures(loop.run({}, is_warm=False).record, model.parameters.mass)


def hold(writable: Sequence[str], scratch: Path) -> None:
    """Confines this process to the folders that it may still change, and lets numba store a user's own kernels in the `scratch` folder.

    Call it before a user's code is loaded. Does nothing where the kernel has no Landlock. It holds for this thread and its later
    threads. Raises InvalidInputError if there are others: a user's code could let them write.
    """
    rules = ruleset(writable)
    if rules is None:
        return
    if len(list(Path("/proc/self/task").iterdir())) > 1:
        os.close(rules)
        remedy = "kind highway takes 1 (OPENBLAS_NUM_THREADS)"
        raise InvalidInputError(Problem("simulator.environment", "numpy has several threads", remedy))
    confine(rules)
    os.close(rules)
    folder = scratch / "kernels"
    folder.mkdir(exist_ok=True)
    numba.config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = str(folder)
