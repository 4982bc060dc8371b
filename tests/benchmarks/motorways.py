"""What does a run of the simulator `highway` cost? `tests/benchmarks/run.py motorways [--runs 60]`.

A run of 20 s with 3 and 10 other vehicles, against SUMO that steps the same scene with the ego vehicle as one of its own; and a step of
each kind of controller and of vehicle, beside SUMO in the same process. Every case has a process of its own. Shown are least times.
Writes `.drivecal/bench/motorways.json`.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

from tests.support.motorways import CONTROLLERS, PARAMETERS, compile_fmu, compile_program, drive, motorway
from tests.support.vehicles import VEHICLES, write_vehicles

TARGET = Path(".drivecal/bench/motorways.json")
MOST_MICROSECONDS = 50.0
"""Wanted cost of a step of a program."""
RANDOM = {"model": "Krauss", "sigma": 0.3, "lane_change": "LC2013"}


def traffic(count: int, **driver: Any) -> list[dict[str, Any]]:
    """Vehicles on both lanes, from 50 m ahead of the ego vehicle on."""
    return [{"s": 150 + 25 * number, "lane": number % 2, "speed": 30.0} | driver for number in range(count)]


CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "3 others": ("python", drive(traffic(3))),
    "10 others": ("python", drive(traffic(10))),
    "10 others, loaded anew": ("python", drive(traffic(10, **RANDOM))),
    "3 others, binary": ("process", drive(traffic(3))),
    "3 others, json": ("json", drive(traffic(3))),
    "3 others, fmu": ("fmu", drive(traffic(3))),
    **{f"3 others, vehicle {kind}": ("python", drive(traffic(3))) for kind in VEHICLES},
}
"""Kind of the controller and scenario. The last ones have a vehicle of the user's."""


def least(function: Callable[[], object], runs: int) -> float:
    """Least wall-clock time in milliseconds."""
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return 1000 * min(times)


def measured(
    folder: Path, kind: str, data: Mapping[str, Any], runs: int, vehicle: Mapping[str, Any] | None
) -> dict[str, float]:
    """Milliseconds of a run, of bare stepping and of a reset; microseconds of a step of the controller, or of the user's vehicle."""
    import libsumo

    from drivecal.highway.drive import driver, loop
    from drivecal.highway.drive.controllers import Checked
    from drivecal.highway.drive.plants import UserVehicleModel
    from drivecal.highway.sumo import EGO
    from drivecal.plugins import setups

    made: list[loop.Loop] = []

    class Kept(loop.Loop):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            made.append(self)

    scratch = tempfile.mkdtemp(dir=folder.parent)
    settings = {
        "folder": str(folder), "work": str(folder), "scratch": scratch, "scenario": "S", "data": dict(data), "kernels": None,
        "simulator": {"kind": "highway", "controller": CONTROLLERS[kind], "vehicle": vehicle or "single_track"},
        "measures": ["min_ttc_s"], "series": [], "sumo": setups.sumo(),
        "changeable": None, "parameters": {},
    }  # fmt: skip
    with mock.patch.object(loop, "Loop", Kept):
        evaluate = driver.prepare(settings)
    current = made[-1]  # the first rehearses
    others = current._traffic

    def bare() -> None:
        others.reset()
        libsumo.vehicle.setSpeedMode(EGO, 31)
        for _ in range(200):
            libsumo.simulationStep()

    request = {"id": 1, "parameters": PARAMETERS}
    run = least(lambda: evaluate(request), runs)
    control = current._controller
    assert isinstance(control, Checked)
    control.begin(PARAMETERS)
    signals = current._signals.tolist()
    step = least(lambda: [control.step(signals) for _ in range(200)], runs) / 200
    if isinstance(current._vehicle, UserVehicleModel):
        plant = current._vehicle.plant
        plant.begin(PARAMETERS, 30.0)
        step = least(lambda: [plant.step(0.0, 0.0) for _ in range(200)], runs) / 200
    return {"run": run, "bare": least(bare, runs), "reset": least(others.reset, runs), "step": 1000 * step}


def main(arguments: Sequence[str]) -> int:
    """Measures, prints and writes; 0 if a step of a program is cheap enough."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=60)
    parser.add_argument("--case", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.case is not None:
        print(
            json.dumps(
                measured(
                    options.folder, *CASES[options.case], options.runs, VEHICLES.get(options.case.partition(" vehicle ")[2])
                )
            )
        )
        return 0
    figures: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = motorway(Path(name) / "bundle")
        compile_program(folder)
        compile_fmu(folder)
        write_vehicles(folder)
        print(f"{'':24} {'run':>9} {'SUMO alone':>11} {'times':>6} {'reset':>9} {'controller':>12}")
        for case in CASES:
            command = [sys.executable, __file__, "--runs", str(options.runs), "--case", case, "--folder", str(folder)]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            row = figures[case] = json.loads(done.stdout.splitlines()[-1])
            print(
                f"{case:24} {row['run']:6.2f} ms {row['bare']:8.2f} ms {row['run'] / row['bare']:6.2f} {row['reset']:6.2f} ms"
                f" {row['step']:7.1f} µs/step"
            )
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(figures, indent=1))
    worst = max(figures[f"3 others, {kind}"]["step"] for kind in ("binary", "json", "vehicle process"))
    print(f"a step of a program costs {worst:.1f} µs at most (wanted: {MOST_MICROSECONDS:g})")
    return int(worst > MOST_MICROSECONDS)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
