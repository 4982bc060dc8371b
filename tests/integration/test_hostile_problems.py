"""A problem attacks whatever it reaches, next to a harmless problem, on a real server with workers, as users have them."""

import os
import socket
from pathlib import Path
from typing import Any

import pytest
from tests.support.attacks import ATTACKS
from tests.support.hostile import (
    CAUSES,
    NEIGHBOUR,
    UNNOTICED,
    WORKING,
    WORKS,
    assert_costs,
    attack,
    attacker,
    ended,
    held_back,
    inside,
    is_pending,
    push,
    push_attacker,
)
from tests.support.serve import Server, alive, serving, until
from tests.support.simulators import running

from drivecal.client import Client
from drivecal.cluster.homes import remember

pytestmark = pytest.mark.slow
IDLE = 6
"""Most processes of simulators without a run: two workers, each with one for every scenario of both problems. Their keepers work
elsewhere."""


def reach(server: Server, mark: str) -> dict[str, Any]:
    """Returns what the attacks can try here."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    home, cache = server.folder / "home", server.folder / "cache"
    sockets = [str(server.folder / "socket"), "/tmp/drivecal-ray-*/r/session_2*/sockets/*"]
    places = {"home": str(home), "cache": str(cache), "secret": str(home / "push.secret"), "mark": mark, "sockets": sockets}
    places |= {"elsewhere": str(server.folder / "elsewhere"), "shared": f"/dev/shm/{mark}"}
    amounts = {"doublings": 9, "memory_mb": 1000, "disk_mb": 100}
    return {**places, **amounts, "server": server.process.pid, "url": server.url, "port": port, "others": [["127.0.0.1", 1]]}


def processes(server: Server) -> set[int]:
    """The processes of the server and its workers; keepers of simulators are no children of theirs."""
    return {process.pid for process in server.family() if alive(process)}


def test_every_attack_is_expected_to_cost_its_cell_or_nothing() -> None:
    assert CAUSES.keys() | UNNOTICED == ATTACKS.keys()


@pytest.mark.faults("processes")  # on Ray there is more to reach
@pytest.mark.parametrize("backend", ["processes", "ray"])
def test_an_attack_costs_its_cell_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, backend: str) -> None:
    mark, temporary = f"mark-of-{tmp_path.parent.name}-{backend}", tmp_path / "temporary"
    temporary.mkdir()
    listening, shared, elsewhere = socket.socket(socket.AF_UNIX), Path(f"/dev/shm/{mark}"), tmp_path / "elsewhere"
    listening.bind(os.path.relpath(tmp_path / "socket"))
    listening.listen()
    shared.write_text("1")
    elsewhere.mkdir()
    (elsewhere / "push.secret").write_text("another")
    monkeypatch.setenv("HOME", str(tmp_path))
    remember([elsewhere])
    monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))
    places = {"DRIVECAL_BUNDLE_CACHE": str(tmp_path / "cache"), "TMPDIR": str(temporary)}
    with serving(tmp_path, 2, 0, DRIVECAL_BACKEND=backend, **places) as server, Client(server.url) as client:
        push_attacker(client, tmp_path, attacker(reach(server, mark)))
        push(client, tmp_path, WORKING, WORKS)
        alone = client.wait(client.submit(NEIGHBOUR).id)  # now all workers have started
        assert (alone.state, alone.cells.failed) == ("succeeded", 0)
        workers, family = {worker.id for worker in client.workers().items}, processes(server)

        posted = {name: attack(client, name) for name in held_back(sorted(ATTACKS))}
        beside = client.wait(client.submit(NEIGHBOUR).id)
        assert any(is_pending(client, identifier) for identifier in posted.values()), "the campaign waited for all attacks"
        assert (beside.state, beside.cells, beside.best) == ("succeeded", alone.cells, alone.best)
        cells = {name: ended(client, identifier) for name, identifier in posted.items()}
        lost = assert_costs(cells, CAUSES)
        assert (tmp_path / "home" / "push.secret").read_text() not in str(lost)
        assert shared.read_text() == "1"
        shared.unlink()
        assert {worker.id for worker in client.workers().items} == workers
        assert processes(server) == family
        # forks have no mark, but the folder of their run
        until(lambda: running(mark) == [] and len(inside(temporary)) <= IDLE)
    until(lambda: running(mark) == [] and inside(temporary) == [] and list(temporary.rglob("drivecal-run-*")) == [])
