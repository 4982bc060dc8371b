"""Versions of tools outside of bundles: a worker runs the probe, and refuses a campaign that began with another answer."""

from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from tests.unit.runtime.test_bundles import ScriptedSimulator

from drivecal.contracts.work import Batch, BatchResult, Cell, SetupRequest
from drivecal.domain.errors import UnavailableError
from drivecal.runtime.bundles import ASK_AGAIN_SECONDS, BundleSessions, Tools
from drivecal.runtime.cache import BundleCache
from drivecal.runtime.worker import Worker


@dataclass
class Machine:
    """A worker on a machine with a tool of some version."""

    worker: Worker
    setup: SetupRequest
    simulator: ScriptedSimulator
    version: str | None = "1.0"
    now: float = 0.0
    asked: int = 0

    def run(self, tools: str | None, cells: int = 1) -> BatchResult:
        numbers = tuple(Cell(number, {"x": 1.0}) for number in range(cells))
        return self.worker.run(Batch(replace(self.setup, tools=tools), numbers))

    def answer(self) -> str:
        self.asked += 1
        if self.version is None:
            raise UnavailableError("it is not installed")
        return self.version


@pytest.fixture
def machine(tmp_path: Path, request_: SetupRequest, archive: bytes) -> Machine:
    tools = Tools(lambda *_: made.answer(), lambda: made.now)
    simulator = ScriptedSimulator()
    worker = Worker("w", bundles=BundleSessions(BundleCache(tmp_path / "cache"), lambda _: simulator, tools))
    worker.store(request_.bundle, archive)
    section = {"kind": "process", "timeout": 10.0, "probe": ["mysim", "--version"]}
    made = Machine(worker, replace(request_, simulator=section), simulator)
    return made


def test_a_batch_without_cells_runs_the_probe(machine: Machine) -> None:
    assert machine.run(None, cells=0).tools == "1.0"
    machine.version = "2.0"
    assert machine.run(None, cells=0).tools == "2.0", "a new campaign must not get an old answer"


def test_a_worker_that_cannot_run_the_probe_refuses(machine: Machine) -> None:
    machine.version = None
    result = machine.run(None, cells=0)
    assert (result.refusal, result.tools) == ("it is not installed", None)


def test_the_probe_runs_once_for_many_batches(machine: Machine) -> None:
    for _ in range(5):
        assert machine.run("1.0").refusal is None
    assert machine.asked == 1


def test_other_tools_are_refused_with_both_answers(machine: Machine) -> None:
    result = machine.run("2.0")
    assert (result.results, result.tools) == ((), "1.0")
    assert "'1.0'" in (result.refusal or "")
    assert "'2.0'" in (result.refusal or "")


def test_an_upgrade_is_noticed_before_a_new_campaign_s_first_batch(machine: Machine) -> None:
    assert machine.run("1.0").refusal is None
    machine.version = "2.0"
    assert machine.run("2.0").refusal is None


def test_inputs_are_looked_at_again_after_a_start_that_may_have_read_them(machine: Machine) -> None:
    machine.setup = replace(machine.setup, simulator={**machine.setup.simulator, "inputs": ["/data"]})
    answers = iter(["1.0", "1.1", "1.0", "1.0"])  # another file for a moment, while the simulator starts
    machine.answer = lambda: next(answers)  # type: ignore[method-assign]  # a machine of this test
    assert machine.run("1.0").tools == "1.1"
    assert machine.simulator.closed == ["city"]
    assert machine.run("1.0").refusal is None


def test_an_upgrade_during_a_campaign_is_noticed_after_a_while(machine: Machine) -> None:
    assert machine.run("1.0").refusal is None
    machine.version = "2.0"
    machine.now = ASK_AGAIN_SECONDS
    assert machine.run("1.0").tools == "2.0"
