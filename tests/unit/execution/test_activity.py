import json
from datetime import UTC, datetime

from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import WorkerInfo
from drivecal.execution.measures import Measures
from drivecal.execution.observing import Activity

WORKER = WorkerInfo(id="worker-1", node="here", pid=7, state="busy", cells=30)


def test_a_worker_does_the_first_of_what_it_was_sent_since_the_one_before_came_back() -> None:
    now = [0.0]
    activity = Activity(lambda: now[0])
    assert activity.describe([WORKER]) == [WORKER]
    activity.sent("worker-1", 1, "S1")
    now[0] = 60.0
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
