"""A problem that attacks whatever it reaches, beside one that works: on a real server with workers, as users have them."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support import attacks
from tests.support.attacks import ATTACKS
from tests.support.serve import Server, alive, serving, until
from tests.support.simulators import eventually, running

from drivecal.adapters import confinement
from drivecal.client import Client
from drivecal.contracts.evaluation import EvaluatedCell

WORKING: dict[str, Any] = {
    "problem": "neighbour",
    "parameters": {"x": {"lower": 0, "upper": 100, "step": 1}},
    "simulator": {"kind": "python", "file": "works.py", "timeout": 30, "memory_mb": 300, "deterministic": True},
    "scenarios": {"one": {}, "two": {}},
    "measures": {"y": "m"},
    "scores": {"cost": {"formula": "abs(y - 37)", "direction": "minimise", "range": [0, 100]}},
}
NEIGHBOUR = {
    "problem": "neighbour",
    "sensitivity": None,
    "reduction": {"mode": "off"},
    "optimizer": {"kind": "genetic", "population": 16, "iterations": 3, "seed": 1},
}
"""All of its cells are simulated, however often it is submitted."""
CAUSES = {
    "fork_bomb": "processes, more than",
    "memory_of_one": "MemoryError",
    "memory_of_many": "MB of memory",
    "memory_that_is_shared": "MB of memory",
    "hang": "no answer",
    "flood": "no answer",
    "fills_the_disk_with_small_files": "no answer",
    "answers_for_others": "the answer's id is 0",
    "null_pointer": "SIGSEGV",
    "leaves_at_once": "exit code 0",
    "unprintable_error": "exit code 1",
    "pushes_a_problem": "HTTP Error 403",
    "overwrites_the_database": "PermissionError",
    "holds_up_the_database": "PermissionError",
    "reads_the_secret": "PermissionError",
    "reads_the_environment": "PermissionError",
    "writes_to_the_cache": "PermissionError",
    "kills_the_server": "PermissionError",
    "kills_everything": "PermissionError",
}
"""A part of what is said of each attack that gets no answer."""
UNNOTICED = {"daemon", "ends_with_a_crash", "crashes_when_collected", "listens"}
"""Attacks that answer first, and gain nothing."""
LANDLOCK = {
    "overwrites_the_database": 1,
    "holds_up_the_database": 1,
    "reads_the_secret": 1,
    "reads_the_environment": 1,
    "writes_to_the_cache": 1,
    "kills_the_server": confinement.SIGNALS_SINCE,
    "kills_everything": confinement.SIGNALS_SINCE,
}
"""The version of Landlock that holds an attack back. Without it the attack is left out, because it would succeed."""

pytestmark = pytest.mark.slow


def push(client: Client, folder: Path, manifest: dict[str, Any], name: str, code: str) -> None:
    """Pushes a problem with one file of code."""
    bundle = folder / manifest["problem"]
    bundle.mkdir()
    (bundle / "problem.yaml").write_text(yaml.safe_dump(manifest))
    (bundle / name).write_text(code)
    client.push_problem(bundle)


def attacker(server: Server, mark: str) -> dict[str, Any]:
    """A problem whose parameter `attack` names what it does."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    home, cache = str(server.folder / "home"), str(server.folder / "cache")
    data = {"home": home, "cache": cache, "mark": mark, "server": server.process.pid, "url": server.url, "port": port}
    return {
        "problem": "attacker",
        "parameters": {"attack": {"choices": sorted(ATTACKS)}},
        "simulator": {"kind": "python", "file": "attacks.py", "timeout": 15, "memory_mb": 300},
        "scenarios": {"only": data},
        "measures": {"y": "m"},
        "scores": {"cost": {"formula": "y", "direction": "minimise", "range": [0, 1]}},
    }


def processes(server: Server) -> set[int]:
    """The processes of the server and its workers; keepers of simulators are no children of theirs."""
    return {process.pid for process in server.family() if alive(process)}


def is_pending(client: Client, identifier: str) -> bool:
    return client.evaluation(identifier).state in {"queued", "running"}


def ended(client: Client, identifier: str) -> EvaluatedCell:
    """The cell of a single evaluation, once it has ended."""
    until(lambda: not is_pending(client, identifier), identifier, 300)
    return client.evaluation(identifier).items[0]


def test_an_attack_costs_its_cell_and_nothing_of_a_campaign_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mark, temporary = f"mark-of-{tmp_path.parent.name}", tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))
    places = {"DRIVECAL_BUNDLE_CACHE": str(tmp_path / "cache"), "TMPDIR": str(temporary)}
    with serving(tmp_path, 2, 0, DRIVECAL_BACKEND="processes", **places) as server, Client(server.url) as client:
        push(client, tmp_path, attacker(server, mark), "attacks.py", Path(attacks.__file__).read_text())
        push(client, tmp_path, WORKING, "works.py", "def evaluate(parameters, data):\n    return {'y': parameters['x']}\n")
        alone = client.wait(client.submit(NEIGHBOUR).id)  # now all workers have started
        assert (alone.state, alone.cells.failed) == ("succeeded", 0)
        workers, family = {worker.id for worker in client.workers().items}, processes(server)

        tried = [name for name in ATTACKS if confinement.version() >= LANDLOCK.get(name, 0)]
        attack: dict[str, Any] = {"problem": "attacker", "evaluator": "cost"}
        posted = {name: client.evaluate(attack | {"parameters": {"attack": name}}).id for name in tried}
        beside = client.wait(client.submit(NEIGHBOUR).id)
        assert any(is_pending(client, identifier) for identifier in posted.values()), "the attacks did not outlast the campaign"
        assert (beside.state, beside.cells, beside.best) == ("succeeded", alone.cells, alone.best)
        cells = {name: ended(client, identifier) for name, identifier in posted.items()}
        lost = {name: cell.detail or "" for name, cell in cells.items() if cell.outcome == "failed"}
        assert lost.keys() == CAUSES.keys() & set(tried)
        assert {name: text for name, text in lost.items() if CAUSES[name] not in text} == {}
        assert all(text.isprintable() for text in lost.values())
        assert {cells[name].score for name in UNNOTICED} == {1.0}
        assert (tmp_path / "home" / "push.secret").read_text() not in str(lost)
        assert {worker.id for worker in client.workers().items} == workers
        assert processes(server) == family
    eventually(lambda: running(mark) == [] and list(temporary.glob("drivecal-run-*")) == [])
