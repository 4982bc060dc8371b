"""Tools outside of bundles: the pool asks a worker for their versions. It notices if no worker has a campaign's versions, or if no worker
can run a problem at all."""

from dataclasses import replace
from typing import Any

import pytest
from tests.support.fake_backend import FakeBackend
from tests.support.pooled import MemoryLeases

from drivecal.contracts.work import Cell, SetupRequest
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import Lost
from drivecal.execution.pool import WorkPool
from drivecal.execution.scheduling.in_flight import Work
from drivecal.execution.scheduling.refusals import PATIENCE_WITH_ANSWERS, PATIENCE_WITH_REFUSALS


def setup(tools: str | None = None) -> SetupRequest:
    simulator = {"kind": "process", "timeout": 60.0, "probe": ["mysim", "--version"]}
    names = (("x",), (), ("y",), (), ())
    return SetupRequest("digest", "mine", "city", {}, simulator, *names, f"fingerprint {tools}", tools=tools)


def pool_on(backend: FakeBackend) -> WorkPool:
    return WorkPool(backend, MemoryLeases(), clock=lambda: backend.now)


def answer(pool: WorkPool, rounds: int = 100) -> str | None:
    for _ in range(rounds):
        result = pool.probe(setup(), "a")
        if result is not None:
            return result
        pool.poll(1.0)
    return None


def submit(pool: WorkPool, tools: str, cells: int = 20) -> None:
    pool.submit(Work(setup(tools), [Cell(number, {"value": float(number)}) for number in range(1, cells + 1)]), tag="a")


def test_one_worker_answers() -> None:
    backend = FakeBackend(tools={1: "2.1", 2: "2.1"})
    assert answer(pool_on(backend)) == "2.1"
    assert backend.sizes == [(0.0, "city", 0)]


def test_a_campaign_says_that_no_worker_is_ready_to_answer() -> None:
    backend = FakeBackend(1)
    pool = pool_on(backend)
    backend.kill(0)
    assert pool.probe(setup(), "a") is None
    assert "no worker is ready" in (pool.waits("a") or "")
    assert answer(pool) is not None
    assert pool.waits("a") is None


def test_another_worker_is_asked_if_the_first_cannot_say() -> None:
    pool = pool_on(FakeBackend(refusing={1: "mysim is not on PATH"}, tools={2: "2.1"}))
    assert answer(pool) == "2.1"


def test_a_worker_that_dies_of_the_question_is_not_asked_twice() -> None:
    backend = FakeBackend(tools={1: "2.1", 2: "2.1"})
    pool = pool_on(backend)
    assert pool.probe(setup(), "a") is None
    pool._fill()
    backend.kill(0)
    assert answer(pool) == "2.1"


def test_a_question_that_is_taken_back_is_no_refusal() -> None:
    pool = pool_on(FakeBackend(1, tools={1: "2.1"}))
    assert pool.probe(setup(), "a") is None
    pool._fill()
    pool._take_in(Lost(-1, "worker-1", Breakdown.ERROR, "taken back", 0.0, begun=False))
    assert pool.trouble() is None
    assert answer(pool) == "2.1"


def test_a_campaign_that_no_worker_can_answer_says_why_and_waits() -> None:
    backend = FakeBackend(refusing={1: "mysim is not on PATH", 2: "mysim is not on PATH"})
    pool = pool_on(backend)
    assert answer(pool, rounds=50) is None
    assert "mysim is not on PATH" in (pool.trouble() or "")
    assert len(backend.sizes) < 20, "it asks now and then"
    backend.refusing.clear()
    assert answer(pool) == "1.0"
    assert pool.trouble() is None


@pytest.mark.parametrize("workers", [1, 3])
def test_workers_that_cannot_answer_are_replaced_after_a_while(workers: int) -> None:
    backend = FakeBackend(workers, refusing=dict.fromkeys(range(1, workers + 1), "the files are not on this machine"))
    pool = pool_on(backend)
    while backend.now < 0.9 * PATIENCE_WITH_REFUSALS:
        pool.probe(setup(), "a")
        pool.poll(1.0)
    assert backend.replaced == []
    while backend.now < 1.5 * PATIENCE_WITH_REFUSALS:
        pool.probe(setup(), "a")
        pool.poll(1.0)
    assert sorted(backend.replaced) == [(f"worker-{place}", None) for place in range(1, workers + 1)]
    backend.refusing.clear()
    assert answer(pool) == "1.0"


def test_a_withdrawn_question_is_not_answered() -> None:
    backend = FakeBackend()
    pool = pool_on(backend)
    assert pool.probe(setup(), "a") is None
    pool.withdraw("a")
    pool.poll(1.0)
    assert backend.sizes == []


@pytest.mark.parametrize("odd", [1, 2])
def test_cells_go_to_the_workers_that_agree(odd: int) -> None:
    backend = FakeBackend(tools={odd: "2.0"})
    pool = pool_on(backend)
    submit(pool, "1.0", cells=400)
    workers, troubles = set(), set()
    while pool.held("a"):
        workers |= {completed.worker for completed in pool.poll(1.0)}
        troubles.add(pool.trouble())
        assert pool.hopeless("a") is None
    assert workers == {f"worker-{3 - odd}"}
    assert any("2.0" in (trouble or "") and "1.0" in (trouble or "") for trouble in troubles)


def hopeless_in_time(backend: FakeBackend, pool: WorkPool) -> str:
    """Works until campaign a is hopeless; returns the reason."""
    while (reason := pool.hopeless("a")) is None:
        assert backend.now < 3 * PATIENCE_WITH_ANSWERS
        pool.poll(1.0)
    assert backend.now >= PATIENCE_WITH_ANSWERS
    return reason


def test_a_campaign_without_an_agreeing_worker_is_hopeless_after_a_while() -> None:
    backend = FakeBackend(tools={1: "2.0", 2: "2.0"})
    pool = pool_on(backend)
    submit(pool, "1.0")
    reason = hopeless_in_time(backend, pool)
    assert "1.0" in reason
    assert "2.0" in reason
    assert any(fault is None for _, fault in backend.replaced), "a new process may see another version"
    pool.withdraw("a")
    assert pool.hopeless("a") is None


def test_workers_whose_probe_breaks_do_not_agree() -> None:
    backend = FakeBackend(tools={1: "2.0"}, refusing={2: "the probe ended with exit code 3"})
    pool = pool_on(backend)
    submit(pool, "1.0")
    reason = hopeless_in_time(backend, pool)
    assert "2.0" in reason
    assert "exit code 3" in reason


def test_a_running_campaign_waits_for_probes_that_break_at_all_workers_and_says_so() -> None:
    backend = FakeBackend(refusing={1: "the licence server is away", 2: "the licence server is away"})
    pool = pool_on(backend)
    submit(pool, "1.0")
    while backend.now < 3 * PATIENCE_WITH_ANSWERS:
        pool.poll(1.0)
        assert pool.hopeless("a") is None
    assert "the licence server is away" in (pool.trouble() or "")
    assert backend.replaced
    backend.refusing.clear()
    completed = []
    while pool.held("a"):
        completed += pool.poll(1.0)
    assert len(completed) == 20
    assert pool.trouble() is None


@pytest.mark.parametrize(("workers", "nodes"), [(1, 1), (2, 1), (8, 1), (2, 2), (8, 3)])
def test_a_problem_that_no_worker_can_run_is_hopeless_at_once(workers: int, nodes: int) -> None:
    places = range(1, workers + 1)
    backend = FakeBackend(workers, refusing=dict.fromkeys(places, "there is no lane e9_0"), blaming={*places})
    backend.nodes = {place: f"node {place % nodes}" for place in places}
    pool = pool_on(backend)
    pool.submit(Work(setup(), [Cell(number, {"value": float(number)}) for number in range(1, 100)]), tag="a")
    pool.submit(Work(replace(setup("1.0"), scenario="road"), [Cell(200, {"value": 1.0})]), tag="b")
    while (reason := pool.hopeless("a")) is None:
        pool.poll(0.1)
        assert backend.now < 1.0
    assert "there is no lane e9_0" in reason
    assert "city" in reason
    pool.withdraw("a")
    assert pool.hopeless("a") is None


@pytest.mark.parametrize(
    ("refusing", "blaming", "nodes"),
    [
        ({1: "there is no lane e9_0", 2: "no libsumo"}, {1}, {}),
        (dict.fromkeys((1, 2), "FMPy cannot read its description"), {1, 2}, {3: "there"}),
    ],
    ids=["worker", "machine"],
)
def test_one_of_several_that_blames_is_not_believed(refusing: dict[int, str], blaming: set[int], nodes: dict[int, str]) -> None:
    backend = FakeBackend(3, refusing=refusing, blaming=blaming, nodes=nodes)
    pool = pool_on(backend)
    pool.submit(Work(setup(), [Cell(number, {"value": float(number)}) for number in range(1, 500)]), tag="a")
    workers = set()
    while pool.held("a"):
        workers |= {completed.worker for completed in pool.poll(1.0)}
        assert pool.hopeless("a") is None
    assert workers == {"worker-3"}


def test_a_worker_whose_machine_cannot_say_does_not_keep_a_campaign_waiting_that_another_blames() -> None:
    backend = FakeBackend(2, refusing={1: "there is no lane e9_0", 2: "no libsumo"}, blaming={1})
    pool = pool_on(backend)
    pool.submit(Work(setup(), [Cell(1, {"value": 1.0})]), tag="a")
    while (reason := pool.hopeless("a")) is None:
        pool.poll(1.0)
        assert backend.now < 3 * PATIENCE_WITH_REFUSALS
    assert reason.count("e9_0") == 1


class Staggered(FakeBackend):
    """Each worker takes 0.1 s longer than the one before."""

    def _begin(self, worker: Any) -> None:
        self.overhead_seconds = 0.1 * worker.index
        super()._begin(worker)


@pytest.mark.parametrize("at_once", [True, False])
def test_late_refusals_of_a_campaign_do_not_count_against_the_next(at_once: bool) -> None:
    places = range(1, 9)
    backend = Staggered(8, refusing=dict.fromkeys(places, "there is no lane e9_0"), blaming={*places})
    pool = pool_on(backend)
    work = [Cell(number, {"value": float(number)}) for number in range(1, 100)]
    pool.submit(Work(setup(), work), tag="a")
    while pool.hopeless("a") is None:
        pool.poll(0.1)
    assert pool.withdraw("a") > 4
    backend.refusing.clear()  # mended
    while pool.held("a") and not at_once:
        pool.poll(0.1)
    pool.submit(Work(setup(), [replace(cell, id=1000 + cell.id) for cell in work]), tag="b")
    completed = 0
    while pool.held("b"):
        assert pool.hopeless("b") is None
        completed += sum(entry.tag == "b" for entry in pool.poll(0.1))
        assert backend.now < 3 * PATIENCE_WITH_REFUSALS
    assert completed == len(work)


def test_a_campaign_that_ends_leaves_the_blame_of_files_to_another_of_the_same_scenario() -> None:
    backend = Staggered(8, refusing=dict.fromkeys(range(1, 9), "there is no lane e9_0"), blaming=set(range(1, 9)))
    pool = pool_on(backend)
    for index, tag in enumerate("ab"):
        cells = [Cell(1000 * index + number, {"value": float(1000 * index + number)}) for number in range(100)]
        pool.submit(Work(setup(), cells), tag=tag)
    while pool.hopeless("a") is None:
        pool.poll(0.1)
    pool.withdraw("a")
    assert pool.hopeless("b") is not None
