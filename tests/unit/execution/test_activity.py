import json

from tests.support.plant import cells
from tests.support.setups import bare as setup

from drivecal.contracts.work import Batch
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import Lost
from drivecal.execution.measures import MEASURES, Measures
from drivecal.execution.pool import Observer
from drivecal.execution.scheduling.in_flight import Dispatch


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
