"""A problem that attacks whatever it reaches, beside one that works: on a real server with workers, as users have them."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support import attacks
from tests.support.attacks import ATTACKS
from tests.support.serve import Server, serving, until
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
OPTIMIZER = {"kind": "genetic", "population": 16, "iterations": 3, "seed": 1}
CAUSES = {
    "fork_bomb": "processes, more than",
    "memory_of_one": "MemoryError",
    "memory_of_many": "MB of memory",
    "memory_that_is_shared": "MB of memory",
    "hang": "no answer",
    "flood": "no answer",
    "answers_for_others": "the answer's id is 0",
    "null_pointer": "SIGSEGV",
    "leaves_at_once": "exit code 0",
    "unprintable_error": "exit code 1",
    "pushes_a_problem": "HTTP Error 403",
    "overwrites_the_database": "PermissionError",
    "reads_the_secret": "PermissionError",
    "reads_the_environment": "PermissionError",
    "writes_to_the_cache": "PermissionError",
    "kills_the_server": "PermissionError",
    "kills_everything": "PermissionError",
}
"""A part of what is said of each attack that gets no answer."""
UNNOTICED = {"daemon", "ends_with_a_crash", "crashes_when_collected", "listens"}
"""Attacks that answer first, and gain nothing."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        confinement.version() < confinement.SIGNALS_SINCE,
        reason="before Linux 6.12 a program of the same user may signal the server",
    ),
]


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


def ended(client: Client, identifier: str) -> EvaluatedCell:
    """The cell of a single evaluation, once it has ended."""
    until(lambda: client.evaluation(identifier).state not in {"queued", "running"}, identifier, 300)
    return client.evaluation(identifier).items[0]


def test_an_attack_costs_its_cell_and_nothing_of_a_campaign_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mark, temporary = f"mark-of-{tmp_path.parent.name}", tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))
    places = {"DRIVECAL_BUNDLE_CACHE": str(tmp_path / "cache"), "TMPDIR": str(temporary)}
    with serving(tmp_path, 2, 0, DRIVECAL_BACKEND="processes", **places) as server, Client(server.url) as client:
        push(client, tmp_path, attacker(server, mark), "attacks.py", Path(attacks.__file__).read_text())
        push(client, tmp_path, WORKING, "works.py", "def evaluate(parameters, data):\n    return {'y': parameters['x']}\n")
        neighbour = {"problem": "neighbour", "sensitivity": None, "reduction": {"mode": "exact"}, "optimizer": OPTIMIZER}
        begun = client.submit(neighbour | {"optimizer": OPTIMIZER | {"iterations": 1}}).id
        assert client.wait(begun).state == "succeeded"  # now all workers have started
        workers = {worker.id for worker in client.workers().items}

        attack: dict[str, Any] = {"problem": "attacker", "evaluator": "cost"}
        posted = {name: client.evaluate(attack | {"parameters": {"attack": name}}).id for name in ATTACKS}
        beside = client.wait(client.submit(neighbour).id)
        assert (beside.state, beside.cells.failed) == ("succeeded", 0)
        cells = {name: ended(client, identifier) for name, identifier in posted.items()}
        lost = {name: cell.detail or "" for name, cell in cells.items() if cell.outcome == "failed"}
        assert lost.keys() == CAUSES.keys()
        assert {name: cause for name, cause in CAUSES.items() if cause not in lost[name]} == {}
        assert all(text.isprintable() for text in lost.values())
        assert {cells[name].score for name in UNNOTICED} == {1.0}
        assert (tmp_path / "home" / "push.secret").read_text() not in str(lost)
        assert {worker.id for worker in client.workers().items} == workers
    eventually(lambda: running(mark) == [] and list(temporary.glob("drivecal-run-*")) == [])
