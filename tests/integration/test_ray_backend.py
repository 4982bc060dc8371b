import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import psutil
import pytest
from tests.support.fake_backend import Behaviour
from tests.support.pooled import MemoryLeases, drain
from tests.support.pooled import cells as behaving
from tests.support.setups import changed, misbehaving_setup

from drivecal.contracts.work import Batch, Cell
from drivecal.execution.backend import Finished, Lost
from drivecal.execution.pool import WorkPool
from drivecal.execution.ray.backend import RayBackend
from drivecal.execution.scheduling.in_flight import Completed, Work


@pytest.fixture
def pool(ray_backend: RayBackend) -> Iterator[WorkPool]:
    pool = WorkPool(ray_backend, MemoryLeases())
    yield pool
    pool.withdraw("test")
    drain(pool)


def test_two_workers_share_the_cells_and_agree(pool: WorkPool) -> None:
    cells = behaving([Behaviour.WELL] * 200)
    pool.submit(Work(misbehaving_setup(), cells), tag="test")
    completed = drain(pool)
    assert sorted(entry.result.id for entry in completed) == [cell.id for cell in cells]
    assert len({element.worker for element in completed}) == 2
    assert len({tuple(member.result.metrics.items()) for member in completed}) == 1
    assert all(item.result.milliseconds > 0 for item in completed)


def test_workers_killed_from_outside_cost_no_cell(pool: WorkPool) -> None:
    pool.submit(Work(misbehaving_setup(), behaving([Behaviour.WELL] * 400)), tag="test")
    completed = pool.poll(30.0)
    victim = next(worker for worker in pool.workers() if worker.pid is not None)
    assert victim.pid is not None
    os.kill(victim.pid, signal.SIGKILL)
    completed += drain(pool)
    assert sorted(cell.result.id for cell in completed) == list(range(1, 401))
    assert all(cell.result.breakdown is None for cell in completed)
    assert victim.pid not in {worker.pid for worker in pool.workers()}


@pytest.mark.slow
def test_workers_have_the_priority_of_their_dispatcher(ray_backend: RayBackend) -> None:
    while None in (numbers := [worker.pid for worker in ray_backend.workers()]):
        ray_backend.wait(0.5)
    assert [psutil.Process(number).nice() for number in numbers] == [psutil.Process().nice()] * 2


def test_an_answer_that_cannot_be_read_is_an_error_of_its_batch_only(ray_backend: RayBackend) -> None:
    while len(ray_backend.slots()) < 2:
        ray_backend.wait(0.5)
    setup = misbehaving_setup()
    one, other = (worker.id for worker in ray_backend.workers())
    ray_backend.submit(one, 1, Batch(setup, "no cells"), None)  # type: ignore[arg-type]  # the worker cannot read it
    ray_backend.submit(other, 2, Batch(setup, (Cell(1, {"behaviour": 0.0, "value": 0.0}),)), 10.0)
    events: list[Finished | Lost] = []
    while len(events) < 2:
        events += ray_backend.wait(1.0)
    by_id = {event.batch_id: type(event).__name__ for event in events}
    assert by_id == {1: "Lost", 2: "Finished"}


def test_another_version_at_the_coordinator_costs_no_cell_and_names_both_versions(pool: WorkPool) -> None:
    good = misbehaving_setup()
    other = changed(good, controller="misbehaving 0.9")
    pool.submit(Work(other, behaving([Behaviour.WELL] * 20)), tag="test")
    completed: list[Completed] = []
    for _ in range(1200):
        completed += pool.poll(0.1)
        if "2 workers refuse S1" in (pool.trouble() or ""):
            break
    assert "is misbehaving 0.9 at the coordinator and misbehaving 1 at the worker" in (pool.trouble() or "")
    pool.submit(Work(good, behaving([Behaviour.WELL] * 20, first=101)), tag="others")
    while pool.held("others"):
        completed += pool.poll(0.5)
    assert sorted(cell.result.id for cell in completed) == list(range(101, 121))
    assert pool.held("test") == 20
    pool.withdraw("test")
    assert not pool.held("test")
    assert pool.trouble() is None


@pytest.mark.usefixtures("ray_backend")
def test_a_local_ray_listens_on_loopback_only() -> None:
    ours = {child.pid for child in psutil.Process().children(recursive=True)} | {os.getpid()}
    sockets = [
        connection
        for connection in psutil.net_connections("inet")
        if connection.status == psutil.CONN_LISTEN and connection.pid in ours
    ]
    assert len(sockets) >= 4  # the store of cluster state, the node's daemon, two workers
    assert {socket.laddr.ip.removeprefix("::ffff:") for socket in sockets if socket.laddr} == {"127.0.0.1"}


JOIN = "import sys, ray; ray.init(address=sys.argv[1], log_to_driver=False); print(ray.nodes())"


@pytest.mark.usefixtures("ray_backend")
@pytest.mark.slow
@pytest.mark.parametrize("token", ["", "0" * 64], ids=["none", "other"])
def test_a_process_without_the_token_cannot_join_a_local_ray(token: str) -> None:
    import ray

    address = ray.get_runtime_context().gcs_address
    given = {name: value for name, value in os.environ.items() if not name.startswith("RAY_AUTH_")}
    given |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": token} if token else {"RAY_AUTH_MODE": "disabled"}
    command = [sys.executable, "-c", JOIN, address]
    ended = subprocess.run(command, env=given, capture_output=True, text=True, check=False, timeout=1800)
    assert ended.returncode != 0
    assert ended.stdout == ""
    assert "token" in ended.stderr.lower(), ended.stderr


@pytest.mark.usefixtures("ray_backend")
def test_ray_leaves_the_signal_handlers_alone() -> None:
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
