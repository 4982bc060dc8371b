import json

from drivecal.domain.evaluations import Breakdown
from drivecal.execution.measures import Measures


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
