"""Do small campaigns end in time next to a huge one? `python tests/benchmarks/run.py overload [--runs 10]`.

On a real server with two workers, without Ray, small campaigns of 10 generations and 148 cells of 10 ms run alone, then next to a
campaign of a million such cells, one after the other and all at once. Then a campaign of 30 generations runs alone, and beside one of cells
that take 600 s, which comes while it runs. Nothing is reused.
Printed: seconds of each from its submission to its end, and the ratio to the median alone.

Good: those that do not run at once end in three times the median alone.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

from tests.support.hostile import push

from drivecal.cli.commands.demo import coordinator, fresh_folder
from drivecal.client import Client
from drivecal.domain.errors import DrivecalError

HOME = Path(".drivecal/bench/overload").absolute()
TARGET = Path(".drivecal/bench/overload.json")
GENERATIONS = 10
TIMES = 3.0
QUICK = 0.01
"""Seconds of a cell."""
SLOW = 600
"""Seconds of a slow cell."""
CODE = f"""import time
def evaluate(parameters, data):
    end = time.process_time() + {QUICK}
    while time.process_time() < end:
        pass
    return {{"y": parameters["x1"]}}
"""
MANIFEST: dict[str, Any] = {
    "problem": "quick",
    "parameters": {f"x{number}": {"lower": 0, "upper": 1} for number in range(1, 7)},  # enough that no set comes twice
    "simulator": {"kind": "python", "file": "cell.py", "timeout": 60, "memory_mb": 300, "deterministic": True},
    "scenarios": {"one": {}, "two": {}},
    "measures": {"y": "1"},
    "scores": {"cost": {"formula": "y", "direction": "minimise", "range": [0, 1]}},
}
SLOW_CODE = f"""import time
def evaluate(parameters, data):
    time.sleep({SLOW})
    return {{"y": parameters["x1"]}}
"""
SLOW_MANIFEST = MANIFEST | {"problem": "slow", "simulator": MANIFEST["simulator"] | {"timeout": 2 * SLOW}}


def document(population: int, iterations: int, seed: int, problem: str = "quick") -> dict[str, Any]:
    """Returns a campaign of two cells for each individual, of which a random search renews three of ten in each iteration."""
    search = {"kind": "random", "population": population, "iterations": iterations, "seed": seed}
    return {"problem": problem, "sensitivity": None, "reduction": {"mode": "off"}, "optimizer": search}


def one(client: Client, seed: int, generations: int = GENERATIONS, slow: bool = False) -> float:
    """Returns the seconds of a small campaign. `slow`: slow cells are submitted while it runs. Raises RuntimeError if it fails."""
    began = time.perf_counter()
    identifier = client.submit(document(20, generations, seed)).id
    other = None
    if slow:
        while not client.campaign(identifier).cells.simulated:
            time.sleep(0.1)
        other = client.submit(document(20, 1, seed, "slow")).id
    ended = client.wait(identifier, progress=False)
    if other is not None:
        if (state := client.campaign(other).state) != "running":
            raise RuntimeError(f"the campaign of slow cells is {state}")
        client.act(other, "cancel")
    if ended.state != "succeeded" or ended.cells.simulated != ended.cells.requested:
        raise RuntimeError(f"{ended.state}, {ended.cells.simulated} simulations: {ended.error}")
    return time.perf_counter() - began


def one_by_one(client: Client, seeds: Sequence[int]) -> list[float]:
    """Returns the seconds of small campaigns, each submitted when the one before has ended."""
    return [one(client, seed) for seed in seeds]


def at_once(client: Client, seeds: Sequence[int]) -> list[float]:
    """Returns the seconds of small campaigns that are submitted at the same time."""

    def alone(seed: int) -> float:
        with Client(client.url, token="") as own:
            return one(own, seed)

    with ThreadPoolExecutor(len(seeds)) as pool:
        return list(pool.map(alone, seeds))


@contextmanager
def beside(client: Client, large: dict[str, Any]) -> Iterator[None]:
    """Keeps a campaign running as long as the block lasts. Raises RuntimeError if it ended by itself."""
    identifier = client.submit(large).id
    while client.campaign(identifier).state != "running" or not client.campaign(identifier).cells.simulated:
        time.sleep(0.2)
    time.sleep(5.0)  # workers hold as much of it as they ever do
    yield
    if client.campaign(identifier).state != "running":
        raise RuntimeError(f"the other campaign is {client.campaign(identifier).state}")
    client.act(identifier, "cancel")
    client.wait(identifier, progress=False)


def main() -> int:
    """Measures, prints, writes; 0 if each small campaign ends in time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=10, help="small campaigns of each kind")
    runs: int = parser.parse_args().runs
    seconds: dict[str, list[float]] = {}
    # the secret in its home lets this client push
    os.environ |= {"DRIVECAL_HOME": str(HOME), "DRIVECAL_BACKEND": "processes", "DRIVECAL_WORKERS": "2"}
    with fresh_folder(HOME), coordinator(HOME) as client:
        push(client, HOME, MANIFEST, CODE)
        push(client, HOME, SLOW_MANIFEST, SLOW_CODE)
        one(client, 1)  # starts the simulators
        seconds["alone"] = one_by_one(client, range(100, 100 + runs))
        seconds["at once"] = at_once(client, range(200, 200 + runs))
        with beside(client, document(4000, 420, 2)):
            seconds["beside a million cells"] = one_by_one(client, range(300, 300 + runs))
            seconds["beside a million cells, at once"] = at_once(client, range(400, 400 + runs))
        seconds["30 generations, alone"] = [one(client, seed, 30) for seed in range(500, 503)]
        seconds["30 generations, beside slow cells"] = [one(client, 600, 30, slow=True)]  # its running cells go on
    alone = {name: median(seconds["30 generations, alone" if name.startswith("30") else "alone"]) for name in seconds}
    for name, took in seconds.items():
        middle, longest = median(took), max(took)
        times = f"{middle / alone[name]:5.2f} and {longest / alone[name]:5.2f} times alone"
        print(f"{name:33} {middle:6.1f} s, longest {longest:6.1f} s: {times}")
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(seconds, indent=2) + "\n")
    late = [name for name, took in seconds.items() if "at once" not in name and max(took) > TIMES * alone[name]]
    print(f"wanted, but for those at once: {TIMES:.0f} times alone{'; missed: ' + ', '.join(late) if late else ''}")
    return int(bool(late))


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (DrivecalError, RuntimeError) as error:
        sys.exit(str(error))
