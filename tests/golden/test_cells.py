"""A handful of cells repeat their results to the last digit: no change of the numerics goes unnoticed.

drivecal finds stored results by fingerprint, so a change of results needs a new version. `FRENET.version` follows its sources, a
scenario's digest its definition. Raise `SINGLE_TRACK.version`, `REFERENCE.version` and `VERSIONS` of `drivecal.plugins.simulators`
(traffic, loop and metrics) by hand. Then write the file again: `python tests/golden/test_cells.py`.

Another kind of processor differs in the last bits, which a closed loop enlarges: up to 6e-7 of a value were seen between two kinds. So the
file is compared within a tolerance; on one machine every process must give the same bits.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from drivecal.domain.evaluations import Rating
from drivecal.highway.comfort.reference import REFERENCE
from drivecal.highway.drive.tasks import TaskRunner
from drivecal.highway.planner.plugin import FRENET
from drivecal.highway.scenarios import HIGHWAY
from drivecal.highway.vehicle.plugin import SINGLE_TRACK
from drivecal.plugins.simulators import VERSIONS, sumo

FILE = Path(__file__).with_name("cells.json")
SETS: dict[str, list[float]] = {
    "calm": [11.0, 0.04, 174, 1692, 153, 0.67, 73, 195, 5.8, 9.9, 164],
    "middle": [-0.5, 1, 100, 1000, 750, 0.5, 100, 1000, 5, 10, 100],
    "hasty": [-14.5, 0.06, 182, 235, 132, 0.77, 124, 1486, 5.9, 8.3, 87],
}
TOLERANCE = 2e-6
METRICS = ("peak_lateral_jerk_mps3", "peak_longitudinal_acceleration_mps2", "offset_rms_m", "final_speed_error_mps")


def versions() -> dict[str, str]:
    """Returns what the results are promised for."""
    digests = {name: scenario.digest for name, scenario in HIGHWAY.scenarios.items()}
    plugins = {"driving function": FRENET.version, "vehicle": SINGLE_TRACK.version, "evaluator": REFERENCE.version}
    return plugins | {"sumo": sumo(), "closed loop": VERSIONS["highway"]} | digests


def results() -> dict[str, dict[str, Any]]:
    """Score, failure, and floats in hexadecimal, by cell."""
    outcome: dict[str, dict[str, Any]] = {}
    for name, scenario in HIGHWAY.scenarios.items():
        vehicle = SINGLE_TRACK.create({parameter.name: parameter.nominal for parameter in SINGLE_TRACK.parameters})
        runner = TaskRunner(scenario, FRENET, vehicle)
        for label, parameters in SETS.items():
            result = runner.run(parameters)
            rating = Rating(0.0, 0) if result.failure else REFERENCE.rate(scenario.rated_as, result.measures)
            floats = {"rating": rating.rating} | {metric: result.measures[metric] for metric in METRICS}
            outcome[f"{name} {label}"] = {
                "score": rating.score,
                "failure": result.failure,
                "floats": {metric: value.hex() for metric, value in floats.items()},
            }
    return outcome


def test_the_golden_cells_give_what_they_gave() -> None:
    golden = json.loads(FILE.read_text())
    promised = golden["versions"] == versions()
    remedy = (
        "no version changed: count up the one that belongs to the change, then write the file anew"
        if promised
        else "a version changed, so this may be on purpose: then write the file anew (python tests/golden/test_cells.py)"
    )
    result = results()
    assert set(result) == set(golden["cells"]), remedy
    for cell, was in golden["cells"].items():
        now = result[cell]
        assert (now["score"], now["failure"]) == (was["score"], was["failure"]), f"{cell}: {remedy}"
        for metric, value in was["floats"].items():
            expected = pytest.approx(float.fromhex(value), rel=TOLERANCE, abs=TOLERANCE)
            assert float.fromhex(now["floats"][metric]) == expected, f"{cell}, {metric}: {remedy}"


def test_the_golden_cells_show_good_and_bad_driving() -> None:
    scores = {cell: was["score"] for cell, was in json.loads(FILE.read_text())["cells"].items()}
    assert all(scores[f"{name} calm"] > scores[f"{name} hasty"] for name in ("S1", "S2", "S4", "S6"))


@pytest.mark.slow
def test_a_fresh_process_gives_the_same_bits_as_this_one() -> None:
    shown = subprocess.run([sys.executable, __file__, "--show"], capture_output=True, text=True, check=True).stdout
    assert shown == json.dumps(results())


if __name__ == "__main__":
    if "--show" in sys.argv:
        sys.stdout.write(json.dumps(results()))
    else:
        FILE.write_text(json.dumps({"versions": versions(), "cells": results()}, indent=1) + "\n")
