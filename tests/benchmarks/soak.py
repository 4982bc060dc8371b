"""Does anything grow for hours? `python tests/benchmarks/run.py soak [--minutes 20] [--backend processes|ray]`.

Runs a server with many small campaigns and comparisons. Clients and a page's event stream follow them, and the benchmark kills workers now
and then. Every few seconds it notes memory, handles, threads and number of the server's processes by role, the largest process of each
role, temporary files, and Ray's store. It prints each slope per hour (Theil-Sen; the first part, while caches fill, does not count)
and a verdict: flat, if the slope adds less than a tenth, or than a floor, in the measured time. Writes `.drivecal/bench/soak.json`
every ten minutes and at the end, which Ctrl+C brings forward; 0 if all is flat and no campaign failed.
"""

import argparse
import json
import os
import sys
import tempfile
import threading
import time
from collections import defaultdict
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from statistics import median
from unittest import mock

import psutil
from scipy.stats import theilslopes

from drivecal.cli.commands.demo import coordinator
from drivecal.client import Client
from drivecal.domain.errors import DrivecalError

TARGET = Path(".drivecal/bench/soak.json")
EVERY = 5.0
"""Seconds between two measurements."""
SETTLING = 0.3
"""Share of the time that does not count, because caches still fill."""
KILL_EVERY = 60.0
SHARE = 0.1
FLOORS = {"MB": 8.0, "handles": 4.0, "threads": 2.0, "processes": 1.0, "files": 20.0}
"""Growth that is no growth, by unit."""
WRITE_EVERY = 600.0
ROLES = {
    "drivecal.server.guardian": "guardians",  # first: its command line ends with its child's
    "drivecal.api": "API",
    "drivecal.dispatch": "dispatcher",
    "drivecal.execution.processes.child": "workers",
    "ray::": "Ray's workers",
    "raylet": "raylet",
    "gcs_server": "Ray's head",
    "drivecal.cli": "supervisor",
}
SPACE = [{"name": f"P{number}", "lower": 0, "upper": 1, "step": 0.25} for number in range(1, 12)]


@dataclass
class Course:
    """Measured values by what they are of and their unit, each with its time; what was done, and what failed."""

    values: dict[tuple[str, str], list[tuple[float, float]]] = field(default_factory=lambda: defaultdict(list))
    done: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    faults: list[str] = field(default_factory=list)


def main() -> int:
    """Measures, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--backend", choices=["processes", "ray"], default="processes")
    chosen = parser.parse_args()
    course = Course()
    with tempfile.TemporaryDirectory(prefix="drivecal-soak-") as folder, _settings(folder, chosen.backend):
        home, temporary = Path(folder) / "home", Path(folder) / "tmp"
        home.mkdir()
        with coordinator(home) as client:
            over = threading.Event()
            busy = [threading.Thread(target=work, args=(client.url, over, course, number)) for number in range(2)]
            busy.append(threading.Thread(target=page, args=(client.url, over, course)))
            for thread in busy:
                thread.start()
            passed = followed(course, 60 * chosen.minutes, temporary)
            over.set()
            for thread in busy:
                thread.join()
    rows = write(course, passed)
    print(", ".join(f"{number:,} {what}" for what, number in course.done.items()))
    for row in rows:
        print(f"{row['of']:24} {row['unit']:10} {row['median']:10,.1f} {row['per_hour']:+10,.1f} per hour  {row['verdict']}")
    print("\n".join(course.faults))
    return int(bool(course.faults) or any(row["verdict"] != "flat" for row in rows))


def followed(course: Course, seconds: float, temporary: Path) -> float:
    """Looks, writes and kills workers for `seconds`, or until it is interrupted (Ctrl+C). Returns the seconds that it took."""
    began = killed = written = time.monotonic()
    with suppress(KeyboardInterrupt):
        while (passed := time.monotonic() - began) < seconds:
            look(course, passed, temporary)
            if time.monotonic() - written >= WRITE_EVERY:
                written = time.monotonic()
                write(course, passed)
            if time.monotonic() - killed >= KILL_EVERY:
                killed = time.monotonic()
                course.done["workers killed"] += kill_a_worker()
            time.sleep(EVERY)
    return time.monotonic() - began


def write(course: Course, seconds: float) -> list[dict[str, float | str]]:
    """Stores and returns what was measured so far."""
    rows = verdicts(course, seconds)
    document = {"minutes": seconds / 60, "done": course.done, "faults": course.faults, "slopes": rows}
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(document, indent=2))
    return rows


def _settings(folder: str, backend: str) -> AbstractContextManager[object]:
    """Has the server keep its temporary files where they can be counted."""
    temporary = Path(folder) / "tmp"
    temporary.mkdir()
    return mock.patch.dict(os.environ, {"TMPDIR": str(temporary), "DRIVECAL_BACKEND": backend})


def work(url: str, over: threading.Event, course: Course, number: int) -> None:
    """Submits one thing after the other and follows each to its end, as users do, until `over`."""
    with Client(url, token="") as client:
        for turn in count():
            if over.is_set():
                return
            try:
                one_turn(client, course, 1 + number + 2 * turn)
            except DrivecalError as error:
                course.faults.append(f"{type(error).__name__}: {error}")


def one_turn(client: Client, course: Course, seed: int) -> None:
    """A campaign, at times a comparison or a single evaluation, with the questions of a page."""
    search = {"kind": "genetic", "population": 12, "iterations": 2, "seed": seed}
    common = {"parameters": SPACE, "catalogue": ["S1", "S2"]}
    if seed % 7 == 0:
        optimizers = [{"kind": "genetic"}, {"kind": "swarm"}]
        chosen = {"optimizers": optimizers, "populations": [6], "seeds": [seed, seed + 1, seed + 2], "iterations": 2}
        document = {"name": "soak", **chosen, **common}
        ended = [client.wait(run.campaign, progress=False) for run in client.compare(document).runs][-1]
        course.done["comparisons"] += 1
    else:
        ended = client.wait(client.submit({"name": "soak", "optimizer": search, **common}).id, progress=False)
        course.done["campaigns"] += 1
        for _ in client.events(ended.id):
            pass
        client.solutions(ended.id)
        first = next(client.rows(ended.id, "evaluations"))
        client.explanation(str(first["id"]))
        client.results(ended.id)
    if ended.state != "succeeded":
        course.faults.append(f"{ended.id} {ended.state}: {ended.error}")
    client.workers()


def page(url: str, over: threading.Event, course: Course) -> None:
    """Keeps one page open, as a user does for days: an event stream, which follows the newest campaign until its end."""
    with Client(url, token="") as client:
        while not over.wait(1.0):
            try:
                for newest in client.campaigns(limit=1).items:
                    for _ in client.events(newest.id):
                        course.done["messages to the page"] += 1
            except DrivecalError as error:
                course.faults.append(f"the page: {type(error).__name__}: {error}")
                return


def look(course: Course, passed: float, temporary: Path) -> None:
    """Notes the size of every role, of temporary files and of Ray's store."""
    sums: dict[tuple[str, str], float] = defaultdict(float)
    largest: dict[tuple[str, str], float] = defaultdict(float)
    for process in psutil.Process().children(recursive=True):
        try:
            command = " ".join(process.cmdline())
            role = next((name for part, name in ROLES.items() if part in command), None)
            if role is not None:
                own = process.memory_full_info().uss / 2**20
                sums[role, "MB"] += own
                largest[f"{role}, largest", "MB"] = max(own, largest[f"{role}, largest", "MB"])
                sums[role, "handles"] += process.num_fds()
                sums[role, "threads"] += process.num_threads()
                sums[role, "processes"] += 1
                if role == "raylet":
                    sums["Ray's store", "MB"] += process.memory_info().shared / 2**20
        except psutil.Error:  # it ended meanwhile
            continue
    files = [path for path in temporary.rglob("*") if path.is_file()]
    sums["temporary", "files"] = len(files)
    sums["temporary", "MB"] = sum(_size(path) for path in files) / 2**20
    for key, value in (sums | largest).items():
        course.values[key].append((passed, value))


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def kill_a_worker() -> int:
    """Kills the first worker; returns how many were there."""
    for process in psutil.Process().children(recursive=True):
        try:
            command = " ".join(process.cmdline())
            if "drivecal.execution.processes.child" in command or "ray::" in command:
                process.kill()
                return 1
        except psutil.Error:
            continue
    return 0


def verdicts(course: Course, seconds: float) -> list[dict[str, float | str]]:
    """Returns the median, the slope per hour (Theil and Sen: single peaks do not move it) and the verdict of every value."""
    rows: list[dict[str, float | str]] = []
    for (of, unit), points in sorted(course.values.items()):
        later = [(moment, value) for moment, value in points if moment >= SETTLING * seconds]
        if len(later) < 2:
            continue
        moments, values = zip(*later[:: max(1, len(later) // 300)], strict=True)
        usual, slope = median(value for _, value in later), float(theilslopes(values, moments).slope)
        grown = slope * (1 - SETTLING) * seconds
        flat = grown <= max(SHARE * usual, FLOORS[unit])
        rows.append({"of": of, "unit": unit, "median": usual, "per_hour": 3600 * slope, "verdict": "flat" if flat else "grows"})
    return rows


if __name__ == "__main__":
    sys.exit(main())
