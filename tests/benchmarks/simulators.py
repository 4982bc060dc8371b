"""What does a simulator in a child process cost? `python tests/benchmarks/run.py simulators [--runs 10000]`.

The same function runs in this process and behind the adapters `process` and `python`, and a C++ program answers beside it, in turns: the
overhead of an adapter is the difference of the medians of one run. A `process` run may cost at most 0.3 ms more than a direct call.
Then one session of `python` runs 10,000 parameter sets: the memory of this process, of the child and of its keeper must stay flat. Also
shown: the time of opening a session and of a run of `command`. Writes `.drivecal/bench/simulators.json`.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from typing import Any

import psutil
from tests.support.simulators import DATA, compiled, cpp_server, opened, write_script

from drivecal.plugins.simulators import SimulatorSession

TARGET = Path(".drivecal/bench/simulators.json")
MOST_MILLISECONDS = 0.3
MOST_GROWTH = 4 << 20
"""Bytes that 10,000 runs may add to the memory of a process."""
ROUNDS = 20
RUNS_PER_ROUND = 100

FUNCTION = """
def evaluate(parameters, scenario):
    x, y = parameters["x"], 0.0
    for step in range(200):
        y += 0.1 * (scenario["k"] * x - y)
    return {"y": y}
"""
SERVER = """
import json, sys
for line in sys.stdin:
    request = json.loads(line)
    if "quit" in request:
        break
    if "drivecal" in request:
        answer = {"ready": True}
    else:
        answer = {"id": request["id"], "measures": evaluate(request["parameters"], request["data"])}
    sys.stdout.write(json.dumps(answer) + "\\n")
    sys.stdout.flush()
"""
BODY = r"""
        const double x = number(line, "\"x\": "), k = number(line, "\"k\": ");
        double y = 0;
        for (int step = 0; step < 200; step++) y += 0.1 * (k * x - y);
"""
"""Computes `y` from the line of a request."""
COMMAND = '#!/bin/sh\necho \'{"measures": {"y": 1}}\' > "$1"\n'


def direct() -> Callable[[float], float]:
    """The function in this process."""
    names: dict[str, Callable[..., dict[str, float]]] = {}
    exec(FUNCTION, names)  # the same text as the simulators'
    return lambda x: names["evaluate"]({"x": x}, DATA)["y"]


def through(session: SimulatorSession) -> Callable[[float], float]:
    """The function behind an adapter."""
    return lambda x: session.evaluate({"x": x}).measures["y"]


def milliseconds(functions: dict[str, Callable[[float], float]]) -> dict[str, float]:
    """Median wall-clock time of a run of each function, in turns."""
    times: dict[str, list[float]] = {name: [] for name in functions}
    for number in range(ROUNDS):
        for name, function in functions.items():
            for run in range(RUNS_PER_ROUND):
                x = float(number * RUNS_PER_ROUND + run)
                start = time.perf_counter()
                function(x)
                times[name].append(1000 * (time.perf_counter() - start))
    return {name: median(values) for name, values in times.items()}


def growth(session: Any, runs: int) -> dict[str, int]:
    """Bytes that a number of runs add to the resident memory of this process, of the child and of its keeper."""
    children = session._children
    processes = {"worker": psutil.Process(), "child": psutil.Process(children._pid), "keeper": psutil.Process(children._keeper)}
    for number in range(1000):  # what is allocated once
        session.evaluate({"x": float(number)})
    before = {name: process.memory_info().rss for name, process in processes.items()}
    for number in range(runs):
        session.evaluate({"x": float(number)})
    return {name: process.memory_info().rss - before[name] for name, process in processes.items()}


def main(arguments: Sequence[str]) -> int:
    """Measures, prints and writes; 0 if the overhead is small enough and the memory flat."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=10_000)
    runs = parser.parse_args(arguments).runs
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        (folder / "model.py").write_text(FUNCTION)
        (folder / "server.py").write_text(FUNCTION + SERVER)
        (folder / "sim.cpp").write_text(cpp_server(BODY))
        compiled("g++", folder / "sim.cpp", folder / "sim")
        write_script(folder / "run.sh", COMMAND)
        opening: dict[str, float] = {}
        sessions: dict[str, SimulatorSession] = {}
        for label, kind, section in (
            ("process (Python)", "process", {"command": [sys.executable, "server.py"]}),
            ("process (C++)", "process", {"command": ["./sim"]}),
            ("python", "python", {"file": "model.py"}),
            ("command (sh)", "command", {"command": ["./run.sh", "{results}"]}),
        ):
            start = time.perf_counter()
            sessions[label] = stack.enter_context(opened(kind, folder, **section))
            opening[label] = 1000 * (time.perf_counter() - start)
        command = sessions.pop("command (sh)")
        medians = milliseconds({"direct": direct()} | {label: through(session) for label, session in sessions.items()})
        start = time.perf_counter()
        for _ in range(50):
            command.evaluate({"x": 1.0})
        medians["command (sh)"] = 1000 * (time.perf_counter() - start) / 50
        added = growth(sessions["python"], runs)
    overhead = medians["process (Python)"] - medians["direct"]
    print(f"{'':18} {'run':>9} {'opening':>9}")
    for label, value in medians.items():
        print(f"{label:18} {value:6.3f} ms {opening.get(label, 0.0):6.1f} ms")
    print(f"overhead of `process` over a direct call: {overhead:.3f} ms (at most {MOST_MILLISECONDS})")
    print(f"{runs:,} runs added {', '.join(f'{size / 2**20:.2f} MB to the {label}' for label, size in added.items())}")
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    figures = {"milliseconds": medians, "opening": opening, "overhead": overhead, "runs": runs, "growth_bytes": added}
    TARGET.write_text(json.dumps(figures, indent=1))
    return int(overhead > MOST_MILLISECONDS or max(added.values()) > MOST_GROWTH)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
