"""Budgets on a real server: a counter inside the program and `runs` agree while the program crashes and hangs and processes are killed."""

import random
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
import yaml
from tests.support.effort import LONG, tries
from tests.support.serve import Server, serving

from drivecal.client import Client

PROGRAM = """
import json, os, random, sys, time

for line in sys.stdin:
    request = json.loads(line)
    if "quit" in request:
        break
    if "id" not in request:
        print(json.dumps({"ready": True}), flush=True)
        continue
    data = request["data"]
    counter = os.open(data["counter"], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(counter, b"start\\n")
    os.close(counter)
    time.sleep(0.02)
    chance = random.random()
    if chance < data["crashes"]:
        os._exit(7)
    if chance < data["crashes"] + data["hangs"]:
        time.sleep(600)
    value = sum((x - data["at"]) ** 2 for x in request["parameters"].values())
    print(json.dumps({"id": request["id"], "measures": {"value": value}}), flush=True)
"""
AT_ONCE, WORKERS, KILLS = tries(2, 5), 2, 4
WORKER, DISPATCHER = "drivecal.execution.processes.child", "drivecal.dispatch"


def problem(name: str, folder: Path, chance: random.Random) -> Path:
    """Returns a folder with the program, whose runs crash and hang with small probabilities."""
    own = folder / name
    own.mkdir()
    (own / "program.py").write_text(PROGRAM)
    data = {"counter": str(counter(folder, name)), "crashes": chance.choice([0.0, 0.05]), "hangs": chance.choice([0.0, 0.01])}
    simulator: dict[str, Any] = {"kind": "process", "command": [sys.executable, "./program.py"], "timeout": 1.5}
    simulator |= chance.choice([{}, {"deterministic": True}])
    manifest = {
        "problem": name,
        "parameters": {place: {"lower": 0, "upper": 1} for place in "xyz"},
        "simulator": simulator,
        "scenarios": {f"S{number}": data | {"at": number / 4} for number in range(1, 4)},
        "measures": {"value": "1"},
        "scores": {"best": {"formula": "value", "direction": "minimise", "range": [0, 3]}},
    }
    (own / "problem.yaml").write_text(yaml.safe_dump(manifest))
    return own


def counter(folder: Path, name: str) -> Path:
    """Returns the file with a line for each start."""
    return folder / "counters" / name


def kill_one(server: Server, part: str, chance: random.Random) -> bool:
    """Kills a process of the server; returns whether there was one."""
    listed = []
    for process in server.family():
        with suppress(psutil.Error):
            words = process.cmdline()
            if part in words and "drivecal.server.guardian" not in words:
                listed.append(process)
    with suppress(psutil.NoSuchProcess, IndexError):
        chance.choice(listed).kill()
        return True
    return False


@pytest.mark.slow
@pytest.mark.faults
@pytest.mark.timeout(5400)
@pytest.mark.parametrize("killed", [[], [WORKER], [WORKER, WORKER, DISPATCHER]], ids=["none", "workers", "all"])
def test_runs_are_the_starts_that_a_program_counts(killed: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))
    chance = random.Random(None if LONG else 5)
    (tmp_path / "counters").mkdir()
    settings = {
        "DRIVECAL_BACKEND": "processes",
        "DRIVECAL_BUNDLE_CACHE": str(tmp_path / "cache"),
        "DRIVECAL_SIMULATOR_FOLDERS": str(tmp_path / "counters"),
    }
    with serving(tmp_path, WORKERS, 0, **settings) as server, Client(server.url) as client:
        for first in range(0, tries(2, 25), AT_ONCE):
            budgets = {f"p{first + number}": chance.randint(30, 90) for number in range(AT_ONCE)}
            running = {}
            for name, budget in budgets.items():
                client.push_problem(problem(name, tmp_path, chance))
                optimizer = chance.choice([{"kind": "surrogate"}, {"kind": "genetic", "population": 10}])
                spec = {"name": name, "problem": name, "budget": {"simulations": budget}, "optimizer": optimizer}
                running[name] = client.submit(spec | {"reduction": {"mode": "exact"}}).id
            left, next_kill = KILLS * bool(killed), time.monotonic() + chance.uniform(0.5, 3.0)
            while not all(client.campaign(identifier).ended_at for identifier in running.values()):
                if left and time.monotonic() >= next_kill:
                    left -= kill_one(server, chance.choice(killed), chance)
                    next_kill = time.monotonic() + chance.uniform(0.5, 3.0)
                time.sleep(0.1)
            for name, identifier in running.items():
                ended = client.campaign(identifier)
                cells, starts = ended.cells, len(counter(tmp_path, name).read_text().splitlines())
                print(f"{name}: {starts} starts, {cells.runs} runs, {cells.lost} lost, budget {budgets[name]}")
                assert ended.state == "succeeded", ended.error
                assert cells.runs - cells.lost <= min(starts, budgets[name])
                assert starts <= cells.runs
                assert killed or (starts, cells.lost) == (cells.runs, 0)
                assert DISPATCHER in killed or cells.runs - starts <= KILLS, "a killed worker may have been about to start one"
