"""The pace of a stage, and its remaining time."""

from collections.abc import Callable, Mapping

from drivecal.contracts.campaign import Progress
from drivecal.domain.evaluations import Outcome

SECONDS_TO_JUDGE = 3.0
"""The pace is unknown while workers start."""
SHARE_TO_JUDGE = 0.01


def worked(cells: Mapping[str, int]) -> int:
    """Returns how many of a stage's cells workers have answered, with or without a result."""
    return sum(cells.get(outcome, 0) for outcome in (Outcome.SIMULATED, Outcome.FAILED))


class EtaEstimate:
    """Estimates a stage's remaining time, since this process resumed it with `done` cells, `worked` of them by workers; `clock` returns
    seconds."""

    def __init__(self, clock: Callable[[], float], done: int, worked: int) -> None:
        self._clock = clock
        self._started, self._done_before, self._worked_before = clock(), done, worked

    def progress(self, done: int, total: int, worked: int) -> Progress:
        """`done` of `total` cells, with the remaining time once there is enough data: copies alone say nothing while workers start."""
        seconds, gained = self._clock() - self._started, done - self._done_before
        judged = gained > 0 and seconds >= SECONDS_TO_JUDGE and gained >= SHARE_TO_JUDGE * (total - self._done_before)
        judged = judged and worked > self._worked_before
        return Progress(done=done, total=total, eta_seconds=seconds / gained * (total - done) if judged else None)
