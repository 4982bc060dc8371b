"""How much of the machine a campaign turns into simulation: `run.py efficiency [--population N] [--iterations N] [--outside]`.

A coordinator as a user starts it carries out a campaign with reduction off. Efficiency = simulated cells x
single-process cost of a cell / (wall x cores). The cost is measured in the same run, in one process on the otherwise idle machine, over a
random sample of the campaign's own cells; a shared core or clock counts against the campaign. How much of that
no coordinator could avoid is told by as many bare processes as there are cores, which simulate the same sample at the same time. The share
of all processor time that simulations took does not depend on what else the machine does.

`--outside`: what drivecal adds for an outside optimizer that sends 50 requests a second, each with a set of one scenario, while another
client takes the answers: new sets, then the same ones again, which are stored. The floor is a bare FastAPI program that commits a row to
SQLite for each request.
"""

import argparse
import json
import os
import random
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from statistics import fmean, median
from typing import Any

import httpx
import psutil

from drivecal.cli.commands.demo import coordinator, fresh_folder
from drivecal.client.client import Client
from drivecal.contracts.campaign import Campaign
from drivecal.highway.drive.tasks import TaskRunner
from drivecal.plugins import registry

HOME = Path(".drivecal/bench/efficiency")
TARGET = Path(".drivecal/bench/efficiency.json")
AT_LEAST = 0.85
SAMPLE = 600
RATE, REQUESTS, MOST_ADDED = 50, 1_000, 20.0
"""Requests a second, their number, and the largest median (ms) that drivecal may add to a request."""
FLOOR = """
import sqlite3, sys, uvicorn
from fastapi import FastAPI
app = FastAPI()
@app.post("/sets", status_code=202)
def take(sets: dict) -> dict:
    with sqlite3.connect(sys.argv[1], timeout=30) as connection:
        connection.execute("INSERT INTO sets VALUES (?)", [str(sets)])
    return {"taken": True}
sqlite3.connect(sys.argv[1]).executescript("PRAGMA journal_mode = WAL; CREATE TABLE sets (document TEXT)")
uvicorn.run(app, port=int(sys.argv[2]), log_level="warning")
"""


class Memory(threading.Thread):
    """Watches the peak of the resident memory of this process's descendants, by role."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.peaks: dict[str, float] = {}
        self._stop_watching = threading.Event()

    def run(self) -> None:
        while not self._stop_watching.wait(1.0):
            now: dict[str, float] = {}
            for process in psutil.Process().children(recursive=True):
                try:
                    role = _role(process.cmdline())
                    now[role] = now.get(role, 0.0) + process.memory_info().rss / 2**20
                except psutil.Error:
                    continue
            for role, megabytes in now.items():
                self.peaks[role] = max(self.peaks.get(role, 0.0), megabytes)

    def stop(self) -> None:
        self._stop_watching.set()
        self.join()


def processor_seconds() -> dict[str, float]:
    """Returns what this process's descendants have used of the processor so far, by role."""
    used: dict[str, float] = {}
    for process in psutil.Process().children(recursive=True):
        try:
            role, times = _role(process.cmdline()), process.cpu_times()
        except psutil.Error:
            continue
        used[role] = used.get(role, 0.0) + times.user + times.system
    return used


def _role(command: list[str]) -> str:
    line = " ".join(command)
    for word, role in (("ray::", "workers"), ("drivecal.dispatch", "dispatcher"), ("drivecal.api", "api")):
        if word in line:
            return role
    return "ray" if "ray" in line else "supervisor"


def run_campaign(client: Client, population: int, iterations: int) -> Campaign:
    """A campaign with reduction off, from its start to its end."""
    specification = {
        "name": "efficiency",
        "sensitivity": None,
        "optimizer": {"kind": "genetic", "population": population, "iterations": iterations, "seed": 1},
        "reduction": {"mode": "off"},
    }
    campaign = client.wait(client.submit(specification).id, progress=False)
    if campaign.state != "succeeded":
        raise RuntimeError(f"the campaign ended as {campaign.state}: {campaign.error}")
    return campaign


def wait_for_workers(client: Client) -> None:
    """Returns when every worker is ready, so that compiling kernels for the first time is not measured."""
    while True:
        workers = client.workers().items
        if workers and all(worker.state == "idle" for worker in workers):
            return
        time.sleep(0.2)


def single_process_cost(cells: list[tuple[str, list[float]]]) -> float:
    """Seconds per cell in this process, scenario by scenario, each warmed up first."""
    driving_function, vehicle = registry.driving_function("frenet"), registry.vehicle("single_track")
    nominal = {parameter.name: parameter.nominal for parameter in vehicle.parameters}
    catalogue = registry.catalogue("highway")
    seconds = 0.0
    for scenario in sorted({scenario for scenario, _ in cells}):
        runner = TaskRunner(catalogue.scenarios[scenario], driving_function, vehicle.create(nominal))
        mine = [parameters for name, parameters in cells if name == scenario]
        runner.run(mine[0])
        begin = time.perf_counter()
        for parameters in mine:
            runner.run(parameters)
        seconds += time.perf_counter() - begin
    return seconds / len(cells)


def _beside_others(cells: list[tuple[str, list[float]]], start: Any, costs: Any) -> None:
    single_process_cost(cells[:: max(1, len(cells) // 50)])  # loads and compiles what it needs
    start.wait()
    costs.put(single_process_cost(cells))


def cost_beside_others(cells: list[tuple[str, list[float]]], processes: int) -> float:
    """Seconds per cell where this many processes simulate at a time."""
    context = get_context("spawn")
    start, costs = context.Barrier(processes), context.Queue()
    started = [context.Process(target=_beside_others, args=(cells, start, costs)) for _ in range(processes)]
    for item in started:
        item.start()
    result = [costs.get(timeout=300) for _ in started]
    for entry in started:
        entry.join()
    return fmean(result)


def sample_of(client: Client, campaign: Campaign) -> list[tuple[str, list[float]]]:
    """A random sample of the cells that were simulated."""
    rows = list(client.rows(campaign.id, "evaluations"))
    chosen = random.Random(1).sample(rows, min(SAMPLE, len(rows)))
    names = [name for name in chosen[0] if name == "x" or name[:1] == "P"]
    return [(row["scenario"], [row[name] for name in names]) for row in chosen]


def floor(folder: Path) -> dict[str, float]:
    """Returns the median time of a request to the bare program, and its processor time for one (ms)."""
    port = 20_000 + os.getpid() % 10_000
    url, waits = f"http://127.0.0.1:{port}/sets", httpx.HTTPTransport(retries=8)
    command = [sys.executable, "-c", FLOOR, str(folder / "floor.sqlite3"), str(port)]
    with subprocess.Popen(command) as process, httpx.Client(transport=waits) as bare:
        bare.post(url, json={})
        requests = paced(lambda number: bare.post(url, json={"key": str(number), "parameters": {"P1": 0.5, "P6": 0.5}}))
        used = sum(psutil.Process(process.pid).cpu_times()[:2])
        process.terminate()
    return {"request": median(requests), "cpu api": 1000 * used / REQUESTS}


def paced(send: Callable[[int], Any]) -> list[float]:
    """Calls `send` with the number of each request at its time; returns the times of the requests (ms)."""

    def timed(number: int) -> float:
        began = time.perf_counter()
        send(number)
        return 1000 * (time.perf_counter() - began)

    with ThreadPoolExecutor(16) as senders:
        begin, pending = time.perf_counter(), []
        for number in range(REQUESTS):
            time.sleep(max(0.0, begin + number / RATE - time.perf_counter()))
            pending.append(senders.submit(timed, number))
        return [each.result() for each in pending]


def fed(client: Client) -> dict[str, float]:
    """Returns median times of requests and answers, the longest of an answer, and processor times for a set by role (ms)."""
    space = [{"name": name, "lower": 0, "upper": 1, "step": 0.001} for name in ("P1", "P6")]
    spec = {"catalogue": ["S3"], "parameters": space, "fixed": {f"P{place}": 0.5 for place in (2, 3, 4, 5, *range(7, 12))}}
    campaign = client.ask_tell(spec | {"reduction": {"mode": "exact"}}).campaign.id
    sent, came = dict[str, float](), dict[str, float]()

    def send(number: int) -> None:
        chance, key = random.Random(number), str(number)
        sent[key] = time.perf_counter()
        client.propose(campaign, [{"key": key, "parameters": {"P1": chance.random(), "P6": chance.random()}}])

    def listen(after: int = 0) -> None:
        while len(came) < REQUESTS + 1:
            page = client.answers(campaign, after=after, wait=5)
            came.update({cell.key: time.perf_counter() for cell in page.items})
            after = page.last

    send(-1)  # resolves the problem, once in a process
    before, listener = processor_seconds(), threading.Thread(target=listen, daemon=True)
    listener.start()
    requests = paced(send)
    listener.join(timeout=600)
    used = processor_seconds()
    client.act(campaign, "cancel")
    answers = [1000 * (came[key] - sent[key]) for key in came if key != "-1"]
    spent = {f"cpu {role}": 1000 * (used[role] - before[role]) / REQUESTS for role in ("api", "dispatcher", "workers")}
    return {"request": median(requests), "answer": median(answers), "last answer": max(answers)} | spent


def outside() -> int:
    """Measures and prints what drivecal adds for an outside optimizer; returns 0 if the median of a request is small enough."""
    with fresh_folder(HOME), coordinator(HOME) as client:
        wait_for_workers(client)
        figures = {"floor": floor(HOME), "new sets": fed(client), "stored sets": fed(client)}
    for name, found in figures.items():
        print(f"{name:12}", *(f"{what}: {value:.1f}" for what, value in found.items()), sep="  ")
    added = figures["new sets"]["request"] - figures["floor"]["request"]
    print(f"added to a request: {added:.1f} ms (at most {MOST_ADDED:g}); load of the machine: {os.getloadavg()[0]:.1f}")
    TARGET.with_stem("outside").write_text(json.dumps(figures))
    return 0 if added <= MOST_ADDED else 1


def main() -> int:
    """Measures, prints, writes; returns 0 if the campaign was efficient enough."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--population", type=int, default=1000)
    parser.add_argument("--iterations", type=int, default=6)
    parser.add_argument("--outside", action="store_true", help="measure requests of an outside optimizer instead")
    chosen = parser.parse_args()
    if chosen.outside:
        return outside()
    cores = os.cpu_count() or 1
    memory = Memory()
    memory.start()
    with fresh_folder(HOME), coordinator(HOME) as client:
        wait_for_workers(client)
        before = processor_seconds()
        campaign = run_campaign(client, chosen.population, chosen.iterations)
        used = {role: seconds - before.get(role, 0.0) for role, seconds in processor_seconds().items()}
        cells = sample_of(client, campaign)
    memory.stop()
    cost = single_process_cost(cells)
    beside_others = cost_beside_others(cells, cores)
    wall, simulated = campaign.seconds.wall, campaign.cells.simulated
    efficiency = simulated * cost / (wall * cores)
    simulating = campaign.seconds.simulating
    share = simulating / sum(used.values())
    figures = {
        "cores": cores,
        "population": chosen.population,
        "iterations": chosen.iterations,
        "simulated": simulated,
        "wall_seconds": wall,
        "single_process_milliseconds_per_cell": 1000 * cost,
        "milliseconds_per_cell_of_a_process_per_core": 1000 * beside_others,
        "worker_milliseconds_per_cell": 1000 * campaign.seconds.simulating / simulated,
        "cells_per_second": simulated / wall,
        "efficiency": efficiency,
        "share_of_processor_time": share,
        "processor_seconds": used,
        "peak_megabytes": memory.peaks,
    }
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(figures, indent=2) + "\n")
    print(f"{simulated:,} cells in {wall:.1f} s on {cores} cores: {simulated / wall:.0f} cells/s")
    print(f"one cell: {1000 * cost:.2f} ms in one process alone, {figures['worker_milliseconds_per_cell']:.2f} ms in a worker")
    print(f"efficiency {efficiency:.3f} (target {AT_LEAST})")
    print(f"simulations took {share:.3f} of all processor time")
    bare = cost / beside_others
    alike = f"{cores} bare processes at a time: {1000 * beside_others:.2f} ms"
    print(f"{alike}, efficiency {bare:.3f}; the campaign's is {efficiency / bare:.3f} of that")
    print("processor time, s: " + ", ".join(f"{role} {seconds:.1f}" for role, seconds in sorted(used.items())))
    print("peak memory, MB: " + ", ".join(f"{role} {megabytes:.0f}" for role, megabytes in sorted(memory.peaks.items())))
    return 0 if efficiency >= AT_LEAST else 1


if __name__ == "__main__":
    sys.exit(main())
