"""Further promises of the backend whose workers are processes of this machine."""

import gc
import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest
from tests.contract.backend.test_backend import CRASH, HANG, WELL, batch, collect, send, wait_for_idle
from tests.support.values import present

from drivecal.campaigns.resolve.problem import trial
from drivecal.domain.evaluations import Breakdown
from drivecal.execution import supervised, worker_process
from drivecal.execution.backend import Finished, Lost
from drivecal.execution.processes.backend import ProcessBackend
from drivecal.execution.supervised import WorkerLimits

LARGE = 4_000
"""Cells of a batch that fits into no buffer of a connection."""


def test_a_lost_batch_tells_which_runs_had_begun(processes_backend: ProcessBackend) -> None:
    wait_for_idle(processes_backend)
    send(processes_backend, 1, batch(WELL, CRASH, WELL, first=11))
    lost = collect(processes_backend, 1)[1]
    assert isinstance(lost, Lost)
    assert lost.starts == {11: 1, 12: 1}


def test_what_waits_behind_a_run_that_takes_longer_than_expected_is_given_back(
    processes_backend: ProcessBackend, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (supervised, worker_process):
        monkeypatch.setattr(module, "LONGEST_QUEUED", 0.2)
    monkeypatch.setattr(processes_backend, "_limits", replace(processes_backend._limits, deadline_seconds=600.0))
    wait_for_idle(processes_backend)
    busy = send(processes_backend, 1, batch(HANG), 0.1)
    for number in (2, 3):  # the second time it is known already that the run takes long, which the pool may not have noticed
        processes_backend.submit(busy, number, batch(WELL), 0.1)
        back = collect(processes_backend, 1)[number]
        assert isinstance(back, Lost)
        assert (back.begun, back.breakdown) == (False, Breakdown.ERROR)
    assert [slot.worker for slot in processes_backend.slots()] == [w.id for w in processes_backend.workers() if w.id != busy]
    os.kill(next(present(worker.pid) for worker in processes_backend.workers() if worker.id == busy), signal.SIGKILL)
    ended = collect(processes_backend, 1)[1]
    assert isinstance(ended, Lost)
    assert ended.begun


@pytest.mark.parametrize("start", ["subprocess.Popen", "threading.Thread.start", "tempfile.TemporaryFile"])
def test_a_start_without_room_on_the_machine_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch, start: str) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise RuntimeError("can't start new thread") if "Thread" in start else OSError("no room")

    monkeypatch.setattr(start, refuse)
    before = set(Path("/proc/self/fd").iterdir())
    backend = ProcessBackend(WorkerLimits(workers=1), trial())
    gc.collect()
    assert set(Path("/proc/self/fd").iterdir()) <= before
    assert "1 of 1 workers do not start: worker-1 cannot be started" in (backend.trouble() or "")


@pytest.mark.slow
def test_a_stopped_process_keeps_nobody_waiting_and_is_replaced(processes_backend: ProcessBackend) -> None:
    wait_for_idle(processes_backend)
    stopped, other = processes_backend.workers()
    assert stopped.pid is not None
    os.kill(stopped.pid, signal.SIGSTOP)
    for number in (1, 2):
        processes_backend.submit(stopped.id, number, batch(*[WELL] * LARGE, first=number * LARGE), 0.1)
    assert send(processes_backend, 3, batch(WELL)) == other.id
    ends = collect(processes_backend, 3)
    assert isinstance(ends[3], Finished)
    lost = [end for end in (ends[1], ends[2]) if isinstance(end, Lost)]
    assert [end.breakdown for end in lost] == [Breakdown.HANG] * 2
    wait_for_idle(processes_backend)
    assert stopped.pid not in {worker.pid for worker in processes_backend.workers()}
