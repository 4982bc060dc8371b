"""What following a campaign costs it: `python tests/benchmarks/run.py polling [--seconds N] [--rounds N]`.

A coordinator as a user starts it carries out one long campaign on real SUMO workers. In turn, nobody looks (A), and 100 clients poll it
every 5 s with If-None-Match while 10 event streams are open (B): A B A B ... A. Each B is compared with the mean of the two A beside it,
so that drift cancels. The clients are one process of raw sockets; what it takes of the same machine is printed, and counts against the
campaign.

On a machine that does other things meanwhile, cells per second say little. There, the CPU time that API and clients take is judged: with
all cores at work, what they take the workers do not get.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import psutil

from drivecal.cli.commands.demo.coordinator import coordinator, fresh_folder
from drivecal.client.client import Client
from drivecal.storage import campaigns
from drivecal.storage.engine.database import Database

HOME = Path(".drivecal/bench/polling").absolute()
TARGET = Path(".drivecal/bench/polling.json")
MOST_LOSS = 0.05
FOREIGN = 0.05
"""Share of the machine that others may use before cells per second are not trusted."""
POLLERS, STREAMS = 100, 10
SECONDS_BETWEEN_POLLS = 5.0


@dataclass
class Seen:
    """What the clients met."""

    statuses: dict[str, int] = field(default_factory=dict)
    milliseconds: list[float] = field(default_factory=list)
    events: int = 0
    progress: int = 0
    open_streams: int = 0


async def poll(url: str, path: str, delay: float, seen: Seen) -> None:
    """One client that asks again and again on one connection."""
    parts = urlsplit(url)
    await asyncio.sleep(delay)
    reader, writer = await asyncio.open_connection(parts.hostname, parts.port)
    etag = b""
    while True:
        begun = time.perf_counter()
        writer.write(b"GET %s HTTP/1.1\r\nHost: %s\r\n%s\r\n" % (path.encode(), parts.netloc.encode(), etag))
        head = await reader.readuntil(b"\r\n\r\n")
        status, *lines = head.split(b"\r\n")
        headers = dict(line.lower().split(b": ", 1) for line in lines if b": " in line)
        await reader.readexactly(int(headers.get(b"content-length", b"0")))
        if b"etag" in headers:
            etag = b"If-None-Match: W" + headers[b"etag"][1:] + b"\r\n"
        code = status.split()[1].decode()
        seen.statuses[code] = seen.statuses.get(code, 0) + 1
        seen.milliseconds.append(1000 * (time.perf_counter() - begun))
        await asyncio.sleep(SECONDS_BETWEEN_POLLS - (time.perf_counter() - begun))


async def listen(url: str, path: str, seen: Seen) -> None:
    """One event stream."""
    parts = urlsplit(url)
    reader, writer = await asyncio.open_connection(parts.hostname, parts.port)
    writer.write(b"GET %s/events HTTP/1.1\r\nHost: %s\r\n\r\n" % (path.encode(), parts.netloc.encode()))
    if b" 200 " in await reader.readline():
        seen.open_streams += 1
    while line := await reader.readline():
        seen.events += line.startswith(b"id: ")
        seen.progress += line.startswith(b"event: progress")


async def follow(url: str, path: str) -> None:
    """All clients, from the line `ready` until standard input ends; then prints what they met."""
    seen = Seen()
    delays = [SECONDS_BETWEEN_POLLS * number / POLLERS for number in range(POLLERS)]
    tasks = [asyncio.create_task(poll(url, path, delay, seen)) for delay in delays]
    tasks += [asyncio.create_task(listen(url, path, seen)) for _ in range(STREAMS)]
    await asyncio.sleep(SECONDS_BETWEEN_POLLS + 1)  # until each has asked once
    met, seen.milliseconds, seen.statuses = seen.statuses, [], {}
    print("ready", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    broken = [repr(task.exception()) for task in tasks if task.done() and task.exception()]
    document = {
        "first": met,
        "statuses": seen.statuses,
        "open_streams": seen.open_streams,
        "events": seen.events,
        "progress": seen.progress,
        "p50_milliseconds": statistics.median(seen.milliseconds),
        "p99_milliseconds": statistics.quantiles(seen.milliseconds, n=100)[98],
        "broken": broken,
    }
    print(json.dumps(document), flush=True)
    for task in tasks:
        task.cancel()


class Clients:
    """The process of all clients."""

    def __init__(self, url: str, path: str) -> None:
        command = [sys.executable, __file__, "--follow", url, path]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n", "the clients did not start"
        self.watched = psutil.Process(self._process.pid)

    def stop(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self._process.communicate("")[0])
        return found


@dataclass(frozen=True)
class Window:
    """Some seconds of the campaign."""

    cells: int
    seconds: float
    cpu: dict[str, float]
    """Seconds of CPU by process; `all`: of the server with its workers, and of the clients."""
    foreign: float
    """Share of the machine that others used."""

    @property
    def rate(self) -> float:
        """Cells per second."""
        return self.cells / self.seconds


def simulated(database: Database, identifier: str) -> int:
    with database.read() as connection:
        stored = campaigns.get(connection, identifier)
    if stored.state.ended:
        raise RuntimeError(f"the campaign is over ({stored.state}: {stored.error}); give a larger --population")
    return stored.cells.simulated


def edge(database: Database, identifier: str) -> tuple[float, int]:
    """The moment at which results are written down, and how many there are then: cells come in batches."""
    before = simulated(database, identifier)
    while (count := simulated(database, identifier)) == before:
        time.sleep(0.005)
    return time.perf_counter(), count


def window(database: Database, identifier: str, seconds: float, watched: dict[str, psutil.Process]) -> Window:
    """Measures for about so many seconds."""
    family = [one for one in psutil.Process().children(recursive=True) if one.status() != psutil.STATUS_ZOMBIE]
    begun, first = edge(database, identifier)
    before, busy = _used(watched, family), _busy()
    time.sleep(seconds)
    ended, last = edge(database, identifier)
    after = _used(watched, family)
    used = {name: after[name] - before[name] for name in after}
    foreign = (_busy() - busy - used["all"]) / ((ended - begun) * (os.cpu_count() or 1))
    return Window(last - first, ended - begun, used, foreign)


def _used(watched: dict[str, psutil.Process], family: list[psutil.Process]) -> dict[str, float]:
    return {name: _cpu(one) for name, one in watched.items()} | {"all": sum(_cpu(one) for one in family)}


def _cpu(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _busy() -> float:
    """Seconds of CPU that all of the machine has used."""
    times = psutil.cpu_times()
    return float(times.user + times.system + times.nice + times.irq + times.softirq)


def processes_of_server() -> dict[str, psutil.Process]:
    found: dict[str, psutil.Process] = {}
    for one in psutil.Process().children(recursive=True):
        command = one.cmdline()
        for module, name in (("drivecal.api", "API"), ("drivecal.dispatch", "dispatcher")):
            if module in command and "drivecal.server.guardian" not in command:
                found[name] = one
    return found


def wait_until_it_runs(client: Client, identifier: str) -> None:
    while client.campaign(identifier).cells.simulated < 500:
        time.sleep(0.5)


def measured(seconds: float, rounds: int, population: int) -> tuple[list[Window], list[Window], list[dict[str, Any]]]:
    """Windows without and with clients, and what the clients met."""
    alone: list[Window] = []
    followed: list[Window] = []
    met: list[dict[str, Any]] = []
    specification = {
        "name": "polling",
        "catalogue": ["S1"],
        "sensitivity": None,
        "optimizer": {"kind": "random", "population": population, "iterations": 100, "seed": 1},
        "reduction": {"mode": "off"},
    }
    with fresh_folder(HOME), coordinator(HOME) as client:
        database = Database.open(f"sqlite:///{HOME / 'drivecal.db'}")
        identifier = client.submit(specification).id
        wait_until_it_runs(client, identifier)
        server = processes_of_server()
        path = f"/api/v1/campaigns/{identifier}"
        alone.append(window(database, identifier, seconds, server))
        for number in range(rounds):
            clients = Clients(client.url, path)
            followed.append(window(database, identifier, seconds, server | {"clients": clients.watched}))
            met.append(clients.stop())
            alone.append(window(database, identifier, seconds, server))
            three = alone[-2], followed[-1], alone[-1]
            rates = " | ".join(f"{one.rate:.1f}" for one in three)
            print(f"round {number + 1}: {rates} cells/s, others use {followed[-1].foreign:.0%}", flush=True)
        database.dispose()
    return alone, followed, met


def compared(alone: list[Window], followed: list[Window]) -> list[float]:
    """Each window with clients, as a share of the mean of the two beside it."""
    return [
        2 * middle.rate / (before.rate + after.rate) for before, middle, after in zip(alone, followed, alone[1:], strict=False)
    ]


def evaluated(alone: list[Window], followed: list[Window]) -> dict[str, Any]:
    """What the windows come to."""
    ratios = compared(alone, followed)
    cores = os.cpu_count() or 1

    def share(windows: list[Window], name: str) -> float:
        return sum(one.cpu.get(name, 0.0) for one in windows) / sum(one.seconds for one in windows) / cores

    before = {name: share(alone, name) for name in ("API", "dispatcher")}
    during = {name: share(followed, name) for name in ("API", "dispatcher", "clients")}
    return {
        "cores": cores,
        "pollers": POLLERS,
        "streams": STREAMS,
        "cells_per_second_alone": [one.rate for one in alone],
        "cells_per_second_followed": [one.rate for one in followed],
        "ratios": ratios,
        "ratio": statistics.median(ratios),
        "cpu_cost": during["API"] - before["API"] + during["clients"],
        "cpu_share_alone": before,
        "cpu_share_followed": during,
        "foreign_share": statistics.mean(one.foreign for one in alone + followed),
    }


def show(figures: dict[str, Any]) -> None:
    """Prints them."""
    a, b = (statistics.median(figures[f"cells_per_second_{one}"]) for one in ("alone", "followed"))
    print(f"nobody looks: {a:.1f} cells/s; {POLLERS} clients poll and {STREAMS} streams are open: {b:.1f} cells/s")
    ratio, ratios = figures["ratio"], figures["ratios"]
    print(f"ratio {ratio:.4f} (median of {len(ratios)}, {min(ratios):.3f} to {max(ratios):.3f}): {1 - ratio:.1%} lost")
    shares = [
        ", ".join(f"{name} {one:.2%}" for name, one in figures[f"cpu_share_{which}"].items()) for which in ("followed", "alone")
    ]
    print(f"of the machine's {figures['cores']} cores: {shares[0]}; when nobody looks: {shares[1]}")
    print(f"API and clients take {figures['cpu_cost']:.2%} of the machine more than before")
    met = figures["clients"]
    statuses: Counter[str] = sum((Counter(one["statuses"]) for one in met), Counter())
    answers = ", ".join(f"{count} x {code}" for code, count in sorted(statuses.items()))
    latency = statistics.median(one["p50_milliseconds"] for one in met), max(one["p99_milliseconds"] for one in met)
    print(f"answers {answers}; {latency[0]:.1f} ms in the median, {latency[1]:.0f} ms at most for 99 %")
    sent = sum(one["events"] for one in met), sum(one["progress"] for one in met)
    print(f"streams sent {sent[0]} events and {sent[1]} times the progress")


def main() -> int:
    """Measures, prints, writes; 0 where following costs little enough."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each window")
    parser.add_argument("--rounds", type=int, default=5, help="windows with clients")
    parser.add_argument("--population", type=int, default=20_000, help="cells between two breaths of the optimizer")
    parser.add_argument("--follow", nargs=2, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.follow:
        asyncio.run(follow(*chosen.follow))
        return 0
    alone, followed, met = measured(chosen.seconds, chosen.rounds, chosen.population)
    figures = evaluated(alone, followed) | {"clients": met}
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(figures, indent=2) + "\n")
    show(figures)
    unwell = [one for one in met if one["broken"] or one["open_streams"] != STREAMS or set(one["statuses"]) - {"200", "304"}]
    if unwell:
        print(f"clients were not served: {json.dumps(unwell)}")
    by_rate = figures["foreign_share"] <= FOREIGN
    print(
        f"others used {figures['foreign_share']:.1%} of it: judged by {'cells/s' if by_rate else 'what API and clients take'}"
    )
    good = (1 - figures["ratio"] if by_rate else figures["cpu_cost"]) <= MOST_LOSS and not unwell
    print(f"{'good' if good else 'not good enough'}: at most {MOST_LOSS:.0%} may be lost")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
