"""What the pool tells of its work: to the log, to the measures, and of each worker."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Collection, Mapping

from drivecal.contracts.work import BatchResult
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import Finished, Lost, WorkerInfo
from drivecal.execution.measures import MEASURES
from drivecal.execution.scheduling.activity import Activity
from drivecal.execution.scheduling.scheduler import Completed, Dispatch

FAILURES_TOLD = 20
"""Of a campaign, before only the 32nd, 64th, 128th ... are."""

log = logging.getLogger(__name__)


class Observer:
    """Sees every batch go and come back."""

    def __init__(self) -> None:
        self._activity = Activity()
        self._failures: Counter[str] = Counter()

    def describe(self, workers: Collection[WorkerInfo]) -> list[WorkerInfo]:
        """The workers with what they do."""
        return self._activity.describe(workers)

    def sent(self, dispatch: Dispatch) -> None:
        """A batch went to a worker."""
        self._activity.sent(dispatch.worker, dispatch.batch_id, dispatch.batch.setup.scenario)

    def came_back(self, dispatch: Dispatch, event: Finished | Lost, completed: Collection[Completed]) -> None:
        """A batch came back, with the final answers of those of its cells that are `completed`; the others are sent again."""
        broken = breakdowns(dispatch, event)
        if isinstance(event, Finished):
            result = event.result
            self._activity.finished(dispatch.worker, dispatch.batch_id, len(result.results), result.seconds, result.remembered)
            if result.refusal is None:
                MEASURES.observe("batch", result.seconds)
            for one in result.results:
                if one.breakdown is None:
                    MEASURES.observe("evaluation", one.milliseconds / 1000)
            for kind in broken.values():
                MEASURES.count("breakdowns", kind)
        else:
            self._activity.lost(dispatch.worker, dispatch.batch_id)
            MEASURES.count("breakdowns", event.breakdown)
        final = {completion.result.id for completion in completed}
        for cell, kind in broken.items():
            if cell not in final:
                MEASURES.count("retries", kind)
        for failed in completed:
            if failed.result.breakdown is not None:
                self._tell_failure(failed)

    def _tell_failure(self, one: Completed) -> None:
        """All of a campaign's first failures, then fewer and fewer: thousands may be alike."""
        self._failures[one.tag] += 1
        count = self._failures[one.tag]
        if count <= FAILURES_TOLD or count.bit_count() == 1:
            log.warning(
                "cell %d has no result after %d attempts (%s, at last on %s; failure %d of this campaign): %s",
                *(one.result.id, one.attempts, one.result.breakdown, one.worker, count, one.result.detail),
                extra={"campaign": one.tag},
            )


def breakdowns(dispatch: Dispatch, event: Finished | Lost) -> Mapping[int, str]:
    """How the cells of a batch broke down that gave no result, by id; a refusal is no breakdown."""
    if isinstance(event, Lost):
        return dict.fromkeys(dispatch.breakdowns, event.breakdown.value)
    result: BatchResult = event.result
    if result.refusal is not None:
        return {}
    answered = {one.id: one.breakdown for one in result.results}
    kinds = ((cell, answered.get(cell, Breakdown.ERROR.value)) for cell in dispatch.breakdowns)
    return {cell: kind for cell, kind in kinds if kind is not None}
