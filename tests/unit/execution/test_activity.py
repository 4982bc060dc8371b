import json
from datetime import UTC, datetime

from tests.support.plant import cells
from tests.support.setups import bare as setup

from drivecal.contracts.work import Batch
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import Lost, WorkerInfo
from drivecal.execution.measures import MEASURES, Measures
from drivecal.execution.observing import Activity, Observer
from drivecal.execution.scheduling.in_flight import Dispatch

WORKER = WorkerInfo(id="worker-1", node="here", pid=7, state="busy", cells=30)


def test_a_worker_does_the_first_of_what_it_was_sent_since_the_one_before_came_back() -> None:
    now = [0.0]
    activity = Activity(lambda: now[0])
    assert activity.describe([WORKER]) == [WORKER]
    activity.sent("worker-1", 1, "S1")
    now[0] = 60.0
    activity.sent("worker-1", 3, "S3")
    activity.came_back("worker-1", 3, 0, 0.0)  # it was taken back
    activity.sent("worker-1", 2, "S2")
    (first,) = activity.describe([WORKER])
    assert (first.scenario, first.since, first.cells_per_second) == ("S1", datetime(1970, 1, 1, 0, 0, tzinfo=UTC), None)
    activity.came_back("worker-1", 1, 30, 15.0)
    (second,) = activity.describe([WORKER])
    assert (second.scenario, second.since, second.cells_per_second) == ("S2", datetime(1970, 1, 1, 0, 1, tzinfo=UTC), 2.0)
    activity.came_back("worker-1", 2, 0, 0.0)
    (idle,) = activity.describe([WORKER])
    assert (idle.scenario, idle.since, idle.cells_per_second) == (None, None, 2.0)


def test_late_and_unknown_batches_and_workers_change_nothing() -> None:
    activity = Activity()
    activity.sent("worker-1", 1, "S1")
    activity.came_back("ghost", 1, 1, 1.0)
    activity.came_back("worker-1", 9, 1, 1.0)
    activity.came_back("worker-1", 9, 0, 0.0)
    assert activity.describe([WORKER])[0].scenario == "S1"
    activity.describe([])
    assert activity.describe([WORKER]) == [WORKER]


def test_a_snapshot_is_a_document_that_later_events_leave_alone() -> None:
    measures = Measures()
    measures.breakdowns.labels("crash").inc()
    before = measures.snapshot()
    measures.breakdowns.labels("crash").inc()
    measures.batch.observe(1.0)
    assert json.loads(json.dumps(before)) == before
    samples = {name: each for name, _, _, each in before}
    assert samples["drivecal_breakdowns"] == [
        ["_total", {"kind": kind}, float(kind == "crash")] for kind in (*Breakdown, "departed")
    ]
    assert samples["drivecal_batch_seconds"][-1] == ["_sum", {}, 0.0]


def test_a_breakdown_is_counted_for_each_started_cell_of_a_lost_batch() -> None:
    def dispatch(batch: int, count: int) -> Dispatch:
        sent = tuple(cells(count))
        return Dispatch("w", batch, Batch(setup(), sent), 1.0, alone=False, breakdowns={cell.id: 0 for cell in sent})

    def counted() -> dict[str, float]:
        samples = {name: each for name, _, _, each in MEASURES.snapshot()}["drivecal_breakdowns"]
        return {labels["kind"]: value for _, labels, value in samples}

    observer, before, lost = Observer(), counted(), Breakdown.CRASH
    observer.came_back(dispatch(1, 3), Lost(1, "w", lost, "died"), [])
    observer.came_back(dispatch(2, 2), Lost(2, "w", lost, "died", begun=False), [])
    observer.came_back(dispatch(3, 2), Lost(3, "w", lost, "died", departed=True), [])
    observer.came_back(dispatch(4, 1), Lost(4, "w", lost, "died", begun=False, departed=True), [])
    assert (counted()["crash"] - before["crash"], counted()["departed"] - before["departed"]) == (3, 1)
