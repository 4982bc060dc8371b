"""A simulator of kind `process` that computes for as long as a run of `highway` takes: a C++ program, calibrated on this machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import yaml
from tests.support.simulators import compiled, cpp_server, opened

from drivecal.bundles.manifest import Manifest
from drivecal.plugins.simulators import Declared

WANTED_MILLISECONDS = 7.0
NAME = "spinning"
SCENARIOS = [f"S{number}" for number in range(1, 7)]
BODY = r"""
        const double x = number(line, "\"x\": ");
        const long rounds = long(number(line, "\"rounds\": "));
        double y = x;
        for (long round = 0; round < rounds; round++) y = std::sin(y) + x;
"""
"""Computes `y` from the line of a request."""


def write_problem(folder: Path) -> float:
    """Writes the problem into a new folder; returns the CPU time of a run, ms, whatever else the machine does."""
    folder.mkdir(parents=True)
    (folder / "sim.cpp").write_text(cpp_server(BODY))
    compiled("g++", folder / "sim.cpp", folder / "sim", "-static")
    rounds = 100_000
    for _ in range(3):
        seconds = _seconds(folder, rounds, 100)[1]
        rounds = max(1000, round(rounds * WANTED_MILLISECONDS / (1000 * seconds)))
    document = {
        "problem": NAME,
        "parameters": {"x": {"lower": 0, "upper": 1}},
        "simulator": {"kind": "process", "command": ["./sim"], "deterministic": True},
        "scenarios": {name: {"rounds": rounds} for name in SCENARIOS},
        "measures": {"y": "1"},
        "scores": {"cost": {"formula": "y", "direction": "minimise", "range": [-2, 2]}},
    }
    Manifest.model_validate(document)
    (folder / "problem.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    return 1000 * _seconds(folder, rounds, 100)[1]


def cost(folder: Path, cells: list[tuple[str, Any]]) -> float:
    """Seconds per cell in one session, after a warm-up."""
    rounds = yaml.safe_load((folder / "problem.yaml").read_text())["scenarios"][SCENARIOS[0]]["rounds"]
    return _seconds(folder, rounds, len(cells))[0]


def _seconds(folder: Path, rounds: int, runs: int) -> tuple[float, float]:
    """Returns wall-clock and CPU time of a run."""
    with ExitStack() as stack:
        evaluate: Callable[[Mapping[str, float | str]], Any] = stack.enter_context(
            opened("process", folder, Declared(NAME, ("y",)), {"rounds": rounds}, command=["./sim"])
        ).evaluate
        for _ in range(5):
            evaluate({"x": 0.5})
        begin = time.perf_counter()
        used = sum(evaluate({"x": run / runs}).cpu_seconds for run in range(runs))
        return (time.perf_counter() - begin) / runs, used / runs
