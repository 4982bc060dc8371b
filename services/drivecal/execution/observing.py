"""Reports of the pool's work in the log and in the measures."""

import logging
from collections import Counter
from collections.abc import Collection, Mapping

from drivecal.contracts.work import BatchResult
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import Finished, Lost
from drivecal.execution.measures import DEPARTED, MEASURES
from drivecal.execution.scheduling.in_flight import Completed, Dispatch

FAILURES_TOLD = 20
"""Failures of a campaign logged in full; then only the 32nd, 64th, 128th and so on."""

log = logging.getLogger(__name__)


class Observer:
    """Reports every returned batch."""

    def __init__(self) -> None:
        self._failures: Counter[str] = Counter()

    def came_back(self, dispatch: Dispatch, event: Finished | Lost, completed: Collection[Completed]) -> None:
        """Notes a returned batch; its cells that are not `completed` are sent again."""
        broken = breakdowns(dispatch, event)
        if isinstance(event, Finished):
            result = event.result
            if result.refusal is None and dispatch.batch.cells:
                MEASURES.batch.observe(result.seconds)
            if result.busy is not None:
                MEASURES.busy_answers.inc()
            for answer in result.results:
                if answer.breakdown is None:
                    MEASURES.evaluation.observe(answer.milliseconds / 1000)
        elif event.departed and event.begun:
            MEASURES.breakdowns.labels(DEPARTED).inc()
        for kind in broken.values():
            MEASURES.breakdowns.labels(kind).inc()
        final = {completion.result.id for completion in completed}
        for cell, kind in broken.items():
            if cell not in final:
                MEASURES.retries.labels(kind).inc()
        for failed in completed:
            if failed.result.breakdown is not None:
                self._tell_failure(failed)

    def _tell_failure(self, completed: Completed) -> None:
        """Logs the first failures of a campaign, then fewer and fewer: thousands may be alike."""
        self._failures[completed.tag] += 1
        count = self._failures[completed.tag]
        if count <= FAILURES_TOLD or count.bit_count() == 1:
            result = completed.result
            log.warning(
                "cell %d has no result after %d attempts (%s, at last on %s; failure %d of this campaign): %s",
                *(result.id, completed.attempts, result.breakdown, completed.worker, count, result.detail),
                extra={"campaign": completed.tag},
            )


def breakdowns(dispatch: Dispatch, event: Finished | Lost) -> Mapping[int, str]:
    """Returns the kind of breakdown by cell id. Cells have none that a refusal or a busy simulator leaves, whose worker left,
    or that it had not begun."""
    if isinstance(event, Lost):
        return {} if event.departed else dict.fromkeys(event.blamed(dispatch.breakdowns), event.breakdown.value)
    result: BatchResult = event.result
    answered = {answer.id: answer.breakdown for answer in result.results}
    missing = None if result.refusal is not None or result.busy is not None else Breakdown.ERROR.value
    kinds = ((cell, answered.get(cell, missing)) for cell in dispatch.breakdowns)
    return {cell: kind for cell, kind in kinds if kind is not None}
