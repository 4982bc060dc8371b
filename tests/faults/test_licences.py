"""A day of eight users on two real backends: licences are never exceeded while processes are killed; the licensed tool asserts it.

Three users need a command with two licences, two a program that holds one for as long as it runs, three none. Two of them have optimizers
of their own, which propose sets over HTTP. A nightly check of a set runs meanwhile.
"""

import json
import random
import shutil
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
import yaml
from tests.support.serve import Server, environment, serving

from drivecal.client import Client

TOOL = Path(__file__).parents[1] / "support" / "licensed" / "tool.py"
LICENCES = {"carmaker": 2, "vtd": 1}
SECONDS, CELLS = 0.1, 50
OUTSIDE = ("cleo", "hans")
"""Users whose optimizers propose sets over HTTP."""
USERS = {"command": ("anna", "bert", "cleo"), "program": ("dora", "emil"), "free": ("fred", "gina", "hans")}
WORKERS = 4
KILLED_EVERY = 2.5


def problem(name: str, folder: Path) -> Path:
    """Returns a folder with the tool, and licences enough for users without resources."""
    pool = {"command": "carmaker", "program": "vtd", "free": "free"}[name]
    words = [sys.executable, "./tool.py", "./tool.py"]
    command = [*words, "--serve", pool] if name == "program" else [*words, pool, "{parameters}", "{scenario}", "{results}"]
    simulator: dict[str, Any] = {
        "kind": "process" if name == "program" else "command",
        "command": command,
        "deterministic": True,
    }
    city: dict[str, Any] = {"seconds": SECONDS}
    if name == "command":
        simulator["resources"] = {"carmaker": 1}
    elif name == "program":
        city["resources"] = {"vtd": 1}
    manifest = {
        "problem": name,
        "parameters": {"x": {"lower": 0, "upper": 1}},
        "simulator": simulator,
        "scenarios": {"city": city},
        "measures": {"value": "1", "taken": "1", "begin": "s", "end": "s"},
        "scores": {"best": {"formula": "value", "direction": "minimise", "range": [0, 1]}},
    }
    own = folder / name
    own.mkdir()
    shutil.copy(TOOL, own)
    (own / "problem.yaml").write_text(yaml.safe_dump(manifest))
    for number in range(LICENCES.get(pool, 2 * WORKERS)):
        (own / f"{pool}-{number}.licence").write_text("")
    return own


def is_worker(process: psutil.Process) -> bool:
    with suppress(psutil.Error):
        words = process.cmdline()
        return "drivecal.execution.processes.child" in words or words[:1] == ["ray::Worker"] or "ray::Worker" in process.name()
    return False


def dispatchers(server: Server) -> list[psutil.Process]:
    listed = []
    for process in server.family():
        with suppress(psutil.Error):
            if "drivecal.dispatch" in process.cmdline():
                listed.append(process)
    return listed


def feed(url: str, campaign: str, answered: dict[str, list[float]]) -> None:
    """Is an outside optimizer: proposes half of its sets, and when these are answered the others. Keeps every answer by key."""
    with Client(url) as client:
        proposed = after = 0
        while len(answered) < CELLS:
            if len(answered) == proposed:
                sets = [{"key": f"k{n}", "parameters": {"x": n / CELLS}} for n in range(proposed, proposed + CELLS // 2)]
                client.propose(campaign, sets)
                proposed += len(sets)
            page = client.answers(campaign, after=after, wait=5)
            for cell in page.items:
                assert cell.score is not None
                answered.setdefault(cell.key, []).append(cell.score)
            after = page.last
        client.act(campaign, "finish")


def nightly_check(server: Server, folder: Path) -> subprocess.Popen[str]:
    (folder / "released.json").write_text('{"x": 0.123}')
    (folder / "limits.yaml").write_text("limits:\n  - {score: best, at_most: 0.2}\n")
    words = ["check", "released.json", "--problem", "free", "--limits", "limits.yaml", "--url", server.url, "--json"]
    command = [sys.executable, "-m", "drivecal.cli", *words]
    return subprocess.Popen(command, cwd=folder, env=environment(folder), stdout=subprocess.PIPE, text=True)


@pytest.mark.faults
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("backend", ["processes", "ray"])
def test_licences_are_never_exceeded_and_nothing_is_lost_on_a_day_of_kills(backend: str, tmp_path: Path) -> None:
    chance = random.Random(7)
    settings: dict[str, Any] = {
        "DRIVECAL_BACKEND": backend,
        "DRIVECAL_RESOURCES": ",".join(f"{name}={count}" for name, count in LICENCES.items()),
        "DRIVECAL_BUNDLE_CACHE": str(tmp_path / "cache"),
    }
    with pytest.MonkeyPatch.context() as patch, serving(tmp_path, WORKERS, **settings) as server:
        patch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))
        with Client(server.url) as client:
            for name in USERS:
                client.push_problem(problem(name, tmp_path))
            running = {
                user: client.submit(
                    {
                        "name": user,
                        "problem": name,
                        "sensitivity": None,
                        "reduction": {"mode": "off"},
                        "optimizer": {"kind": "external"}
                        if user in OUTSIDE
                        else {"kind": "random", "population": CELLS, "iterations": 1, "seed": seed},
                    }
                ).id
                for name, users in USERS.items()
                for seed, user in enumerate(users, start=1)
            }
            answered: dict[str, dict[str, list[float]]] = {user: {} for user in OUTSIDE}
            feeders = [threading.Thread(target=feed, args=(server.url, running[user], answered[user])) for user in OUTSIDE]
            for feeder in feeders:
                feeder.start()
            night = nightly_check(server, tmp_path)
            next_kill, kills, waits, shares = time.monotonic() + KILLED_EVERY, 0, set[str](), dict[str, int]()
            while True:
                now = {user: client.campaign(identifier) for user, identifier in running.items()}
                waits |= {campaign.waiting or "" for campaign in now.values()}
                if not shares and any(now[user].ended_at for user in USERS["free"]):
                    shares = {user: now[user].progress.done for user in USERS["free"]}
                if all(campaign.ended_at for campaign in now.values()):
                    break
                if time.monotonic() >= next_kill and kills < 8:
                    kills += 1
                    targets = dispatchers(server) if kills == 5 else list(filter(is_worker, server.family()))
                    if targets:
                        with suppress(psutil.NoSuchProcess):
                            chance.choice(targets).kill()
                    next_kill = time.monotonic() + KILLED_EVERY
                time.sleep(0.2)
            for feeder in feeders:
                feeder.join()
            checked, _ = night.communicate()
            assert (night.returncode, json.loads(checked)["passed"]) == (0, True)
            for user in OUTSIDE:
                assert sorted(map(len, answered[user].values())) == [1] * CELLS, "each answer came once"
            assert {(campaign.state, campaign.cells.failed) for campaign in now.values()} == {("succeeded", 0)}
            tables = {user: client.evaluations(identifier, measures="true").to_pandas() for user, identifier in running.items()}
            assert {user: len(table) for user, table in tables.items()} == {user: now[user].cells.requested for user in tables}
            assert {user: float(table["measure_taken"].min()) for user, table in tables.items()} == dict.fromkeys(tables, 1.0)
            assert any("carmaker" in reason for reason in waits)
            assert kills >= 6
            assert min(shares.values()) >= 0.9 * max(shares.values()) - 5, shares
            assert {use.name: use.total for use in client.workers().resources} == LICENCES
